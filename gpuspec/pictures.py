"""Figures of arrays, for a person to look at; they take what they draw, not a result.

`page` and `place` lay out, the other files draw one picture each, `all` lists them.
Imports `light`, `detection`, `part` and what stands below them.
"""
