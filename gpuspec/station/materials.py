"""Materials of a part: their optical constants over the wavelength."""

from __future__ import annotations

from bisect import bisect_right
from functools import cache

WAVELENGTH_NM = 550.0
"""Of the light where a station says nothing."""

# Refractive index n and extinction k at 550 nm, rounded: of the metals as the tables below, of
# aluminium after Smith, Shiles, Inokuti in Palik's handbook (1985); the lacquer is a clear coat of
# index 1.5 at every wavelength (what clear polymers disperse, some 0.02 from 400 to 1,000 nm, is
# left out).
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

# Wavelength in nm, n, k, from 400 to 1,000 nm and one more on either side. Noble metals: P. B.
# Johnson and R. W. Christy, Phys. Rev. B 6, 4370 (1972); chromium, nickel, iron: the same, Phys.
# Rev. B 9, 5056 (1974); aluminium: A. D. Rakic, Appl. Opt. 34, 4755 (1995). As tabulated in the
# refractiveindex.info database (CC0). Their rows at 548.6 or 549 nm are those at 550 above.
TABLES = {
    "aluminium": """
        364.66 0.39877 4.3957   413.28 0.52135 5.0008   442.80 0.60790 5.3676
        476.87 0.72780 5.7781   516.60 0.87340 6.2418   563.57 1.0728 6.7839
        619.93 1.3660 7.4052    652.25 1.5724 7.7354    688.81 1.8301 8.0601
        729.32 2.1606 8.3565    774.91 2.6154 8.4914    794.78 2.7675 8.3866
        815.69 2.7668 8.2573    837.74 2.6945 8.1878    885.61 2.2802 8.1134
        911.66 1.9739 8.3058    939.28 1.6784 8.5970    968.63 1.4867 9.0655
        999.88 1.4359 9.4939    1033.2 1.3998 9.8914
    """,
    "silver": """
        397.4 0.05 2.070   413.3 0.05 2.275   430.5 0.04 2.462   450.9 0.04 2.657
        471.4 0.05 2.869   495.9 0.05 3.093   520.9 0.05 3.324   582.1 0.05 3.858
        616.8 0.06 4.152   659.5 0.05 4.483   704.5 0.04 4.838   756.0 0.03 5.242
        821.1 0.04 5.727   892.0 0.04 6.312   984.0 0.04 6.992   1088.0 0.04 7.795
    """,
    "gold": """
        397.4 1.47 1.952   413.3 1.46 1.958   430.5 1.45 1.948   450.9 1.38 1.914
        471.4 1.31 1.849   495.9 1.04 1.833   520.9 0.62 2.081   582.1 0.29 2.863
        616.8 0.21 3.272   659.5 0.14 3.697   704.5 0.13 4.103   756.0 0.14 4.542
        821.1 0.16 5.083   892.0 0.17 5.663   984.0 0.22 6.350   1088.0 0.27 7.150
    """,
    "copper": """
        397.4 1.32 2.116   413.3 1.28 2.207   430.5 1.25 2.305   450.9 1.24 2.397
        471.4 1.25 2.483   495.9 1.22 2.564   520.9 1.18 2.608   582.1 0.70 2.704
        616.8 0.30 3.205   659.5 0.22 3.747   704.5 0.21 4.205   756.0 0.24 4.665
        821.1 0.26 5.180   892.0 0.30 5.768   984.0 0.32 6.421   1088.0 0.36 7.217
    """,
    "chromium": """
        397 2.00 2.83   413 2.08 2.93   431 2.19 3.04   451 2.33 3.14   471 2.51 3.24
        496 2.75 3.30   521 2.94 3.33   582 3.22 3.30   617 3.17 3.30   659 3.09 3.34
        704 3.05 3.39   756 3.08 3.42   821 3.20 3.48   892 3.30 3.52   984 3.41 3.57
        1088 3.58 3.58
    """,
    "nickel": """
        397 1.72 2.57   413 1.70 2.69   431 1.71 2.82   451 1.73 2.95   471 1.78 3.09
        496 1.82 3.25   521 1.85 3.42   582 1.96 3.80   617 1.99 4.02   659 1.99 4.26
        704 2.06 4.50   756 2.13 4.73   821 2.26 4.97   892 2.40 5.23   984 2.48 5.55
        1088 2.65 5.93
    """,
    "iron": """
        397 2.24 2.58   413 2.35 2.65   431 2.48 2.71   451 2.59 2.77   471 2.67 2.82
        496 2.74 2.88   521 2.86 2.91   582 2.94 2.99   617 2.88 3.05   659 2.92 3.10
        704 2.86 3.19   756 2.87 3.28   821 2.94 3.39   892 2.96 3.56   984 2.92 3.79
        1088 2.97 4.06
    """,
}


@cache
def optical_constants(material: str, wavelength_nm: float = WAVELENGTH_NM) -> tuple[float, float]:
    """Return refractive index n and extinction k, linear between the rows of a table.

    Parameters
    ----------
    material : str
        One of ``MATERIALS``.
    wavelength_nm : float
        From 400 to 1,000.

    Returns
    -------
    tuple of float
        Both 0 of an ideal mirror.

    Examples
    --------
    >>> from gpuspec.station.materials import optical_constants
    >>> optical_constants("gold")
    (0.43, 2.5)
    >>> n, k = optical_constants("gold", 450.9)
    >>> n, k
    (1.38, 1.914)
    """
    if wavelength_nm == WAVELENGTH_NM or material not in TABLES:
        return MATERIALS[material]
    numbers = [float(word) for word in TABLES[material].split()]
    rows = [*zip(numbers[::3], numbers[1::3], numbers[2::3], strict=True)]
    rows = sorted([*rows, (WAVELENGTH_NM, *MATERIALS[material])])
    at = bisect_right(rows, (wavelength_nm,))
    (low, n, k), (high, next_n, next_k) = rows[at - 1], rows[at]
    share = float((wavelength_nm - low) / (high - low))  # kept for equal numbers of NumPy's, too
    return n + share * (next_n - n), k + share * (next_k - k)


def reflectance(material: str, wavelength_nm: float = WAVELENGTH_NM) -> float:
    """Return the share of light that a material reflects as a mirror, looked at straight.

    ((n - 1)^2 + k^2) / ((n + 1)^2 + k^2); M. Born, E. Wolf, Principles of Optics, 14.2.

    Parameters
    ----------
    material : str
    wavelength_nm : float

    Examples
    --------
    >>> from gpuspec.station.materials import reflectance
    >>> [round(reflectance("copper", nm), 2) for nm in (450, 550, 650)]
    [0.54, 0.63, 0.94]
    """
    if material == "ideal":
        return 1.0
    n, k = optical_constants(material, wavelength_nm)
    return ((n - 1) ** 2 + k**2) / ((n + 1) ** 2 + k**2)
