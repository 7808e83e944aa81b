"""gpuspec: simulate, test and optimise an inspection station for specular parts."""

from __future__ import annotations

__version__ = "0.1.0"
