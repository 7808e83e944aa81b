"""Frames of a real camera: files read, added up and judged, as functions of arrays.

`series` finds the files that are meant, `readers` reads them, `accumulator` adds them up.
`silhouette` compares outlines. Imports `station`, `part`, `detection` and what stands below them;
knows no result and no picture.
"""
