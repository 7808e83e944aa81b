"""The way through, in one place: from a station to blobs, classes and score.

Imports everything that makes, detects or draws: `light`, `detection`, `part`, `pictures`.
"""
