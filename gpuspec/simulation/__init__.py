"""The way through, in one place: from a station to blobs, classes and score.

`simulate` goes it, `result` is what comes out, `light_map` scores other designs of one trace,
`seen` counts a part's hits and false blobs, `kept` reads a result back from its folder. Imports
everything that makes, detects, draws or writes: `light`, `detection`, `part`, `pictures`, `report`.
"""
