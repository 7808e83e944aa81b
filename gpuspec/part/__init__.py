"""The part itself, in float64: where its surface and its defects are, and which pixel sees them.

`shapes` is the surface without relief, `grooves` and `maps` are what stands out of it, `edges`
where its outline is broken, `relief` is all of that; `placement` draws random defects, `view`
leads from pixels to points, `truth` to zones. Imports `station`, `topographies` and what stands
below them; no device.
"""
