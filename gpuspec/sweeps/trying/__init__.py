"""Trying designs: light maps of random parts, levels counted, scores at every threshold, rows.

`parts` are traced; to screen them `listing` says which pixels stand for all, `flawless` bounds the
others, `screening` tells how sure a sample is. `curves` are P1, P2 and hits,
`bench` leads from designs to `rows` of the table. Imports `sweeps.plan` and what stands below it.
"""
