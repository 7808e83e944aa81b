"""A sweep's folder and the rows in it: written whole or not at all, read and checked.

Imports `sweeps.trying` and what stands below it.
"""
