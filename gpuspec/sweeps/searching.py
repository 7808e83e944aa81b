"""Searching between bounds, without a grid. Imports `sweeps.keeping` and what stands below it."""
