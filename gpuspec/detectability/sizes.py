"""What may be called the size of a defect: diameter, width, depth or slope."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from gpuspec.errors import StationError
from gpuspec.station.defects import Population, ScratchPopulation
from gpuspec.station.station import Station

Floats = NDArray[np.float64]
KINDS = ("dent", "bump", "scratch")
STEEPEST = 4 * math.exp(-0.5)
"""Greatest slope of a Gaussian of sigma = width / 4, over depth / width."""


@dataclass(frozen=True)
class Size:
    """A size.

    Attributes
    ----------
    name, unit : str
    kinds : tuple of str
        Of the defects that have it.
    """

    name: str
    unit: str
    kinds: tuple[str, ...]

    def of(self, size_mm: Floats, depth_um: Floats) -> Floats:
        """Return it of defects of some diameters or widths and depths.

        Parameters
        ----------
        size_mm, depth_um : ndarray, shape (n,)

        Examples
        --------
        >>> from gpuspec.detectability.sizes import SIZES
        >>> SIZES["slope"].of(np.array([0.5]), np.array([2.0])).round(2).tolist()  # mrad
        [9.7]
        """
        if self.name == "depth":
            return depth_um
        return STEEPEST * depth_um / size_mm if self.name == "slope" else size_mm

    @property
    def label(self) -> str:
        """Name and unit."""
        return f"{self.name}, {self.unit}"


SIZES = {
    size.name: size
    for size in (
        Size("diameter", "mm", ("dent", "bump")),
        Size("width", "mm", ("scratch",)),
        Size("depth", "um", KINDS),
        Size("slope", "mrad", KINDS),  # um over mm
    )
}
"""By name."""


def chosen(
    station: Station, size: str = "slope", kinds: Sequence[str] = ()
) -> tuple[Size, tuple[str, ...]]:
    """Return the size to fit over, and the kinds of the defects that are trials.

    Parameters
    ----------
    station : Station
    size : str
        A name of ``SIZES``.
    kinds : sequence of str, optional
        Only these; none given: all that the size is of.

    Raises
    ------
    StationError
        If the name is not known, no population has the size, or it is the same of all.

    Examples
    --------
    >>> from gpuspec.detectability.sizes import chosen
    >>> found, kinds = chosen(gpuspec.example("trim"), "diameter")
    >>> found.label, kinds
    ('diameter, mm', ('dent', 'bump'))
    """
    there = tuple(dict.fromkeys(population.kind for population in station.populations))
    if not there:
        raise StationError(
            f"{station.file}: no random defects, so there are no trials; add [[populations]], "
            f'e.g. kind = "dent", count = 20, diameter_mm = [0.1, 1.0], depth_um = [1.0, 8.0].'
        )
    for name, known in ((size, SIZES), *((kind, KINDS) for kind in kinds)):
        if name not in known:
            raise StationError(f"{name!r} is not known here; choose one of {', '.join(known)}.")
    found = SIZES[size]
    wanted = tuple(k for k in there if k in found.kinds and (not kinds or k in kinds))
    if not wanted:
        raise StationError(
            f"{station.file}: its populations are of kind {', '.join(there)}, and none of "
            f"{', '.join(kinds or found.kinds)} has a {found.name}; choose another size or kind."
        )
    ends = {end for p in station.populations if p.kind in wanted for end in _ends(found, p)}
    if len(ends) == 1:
        raise StationError(
            f"{station.file}: the {found.name} of every {' and '.join(wanted)} is "
            f"{ends.pop():g} {found.unit}, so no curve over it can be told; give the populations "
            f"a range, e.g. [0.1, 1.0]."
        )
    return found, wanted


def both(
    station: Station, size: str, over: str, kinds: Sequence[str] = ()
) -> tuple[Size, Size, tuple[str, ...]]:
    """Return the two sizes of a map, and the kinds of the defects that have both.

    Parameters
    ----------
    station : Station
    size, over : str
        Names of ``SIZES``.
    kinds : sequence of str, optional
        As of :func:`chosen`.

    Raises
    ------
    StationError
        As of :func:`chosen`, and if both are the same.
    """
    if size == over:
        raise StationError(f"a map of the {size} over itself tells nothing; name two sizes.")
    _, some = chosen(station, size, kinds)
    _, some = chosen(station, over, some)
    return chosen(station, size, some)[0], chosen(station, over, some)[0], some


def _ends(size: Size, population: Population) -> tuple[float, float]:
    """Return least and greatest size that a population may have."""
    across = (
        population.width_mm if isinstance(population, ScratchPopulation) else population.diameter_mm
    )
    depth = population.depth_um
    low, high = (
        size.of(np.array([a]), np.array([d]))
        for a, d in ((across.high, depth.low), (across.low, depth.high))
    )
    return (across.low, across.high) if size.name in ("diameter", "width") else (
        float(low[0]), float(high[0])
    )  # fmt: skip
