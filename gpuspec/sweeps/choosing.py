"""Choosing from a sweep: the front, the rule's choice, and the pictures that show both.

Imports `sweeps.keeping` and what stands below it.
"""
