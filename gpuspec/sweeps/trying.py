"""Trying designs: light maps of random parts, levels counted, scores at every threshold, rows.

`parts` are traced, `screening` draws the pixels that stand for all, `curves` are P1, P2 and hits,
`bench` leads from designs to `rows` of the table. Imports `sweeps.plan` and what stands below it.
"""
