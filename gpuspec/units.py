"""Factors between the units of keys and the millimetres in which everything is worked out."""

from __future__ import annotations

MICRO = 1e-3  # mm per um
