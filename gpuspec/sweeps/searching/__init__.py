"""Searching between bounds, without a grid. Imports `sweeps.choosing` and what stands below it."""
