"""From an aspect image to blobs, classes and score, whoever took it: no light in here.

`segmentation` labels, `measures` measures, `classes` names, `score` compares with the known zones;
`inspection` is the way through. Imports `station` and what stands below it.
"""
