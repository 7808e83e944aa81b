"""Materials of a part: their optical constants."""

from __future__ import annotations

# Refractive index n and extinction k near 550 nm, rounded: Johnson and Christy, Phys. Rev. B 6
# (1972) and 9 (1974); aluminium after Smith, Shiles, Inokuti in Palik's handbook (1985); the
# lacquer is a clear coat of index 1.5.
MATERIALS = {
    "ideal": (0.0, 0.0),
    "aluminium": (0.96, 6.7),
    "silver": (0.06, 3.6),
    "gold": (0.43, 2.5),
    "copper": (1.0, 2.6),
    "chromium": (3.2, 3.3),
    "nickel": (1.9, 3.6),
    "iron": (2.9, 3.0),
    "lacquer": (1.5, 0.0),
}
