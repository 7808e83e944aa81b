"""Sweeps: many stations at once, scored at every threshold, stored, compared and chosen from."""
