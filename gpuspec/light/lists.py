"""Lists of pixels of one light map, each with its own number of sub-rays, seen side by side."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from typing import Any, Generic, Protocol, TypeVar

import numpy as np
from numpy.typing import NDArray

from gpuspec.station.station import Station


class Listed(Protocol):
    """What is asked of the light map of a list, see :class:`gpuspec.light.light_map.LightMap`."""

    def under(self, station: Station) -> Station: ...

    def means_of_exposures(
        self, station: Station, exposures: Sequence[float]
    ) -> NDArray[np.float32]: ...


Part = TypeVar("Part", bound=Listed)


class Lists(Generic[Part]):
    """Light maps of lists of pixels of one station, one after another.

    Parameters
    ----------
    parts : sequence of LightMap
    """

    def __init__(self, parts: Sequence[Part]) -> None:
        self.parts = tuple(parts)

    def each(self, of: Callable[[Part], NDArray[Any]]) -> NDArray[Any]:
        """Return what a function says of their pixels, shape (n,).

        Parameters
        ----------
        of : callable
            Returns the image of a list, shape (1, pixels).
        """
        return np.concatenate([of(part)[0] for part in self.parts])

    def means_of_exposures(
        self, station: Station, exposures: Sequence[float]
    ) -> NDArray[np.float32]:
        """Return noise-free means of their pixels, shape (exposures, n).

        Parameters and errors as :meth:`LightMap.means_of_exposures`.
        """
        means = [part.means_of_exposures(part.under(station), exposures) for part in self.parts]
        return np.concatenate([own[:, 0] for own in means], axis=1)
