"""Lists of pixels of many sub-rays, whose footprints are added up once for all designs.

See `kernels/footprints.cl`.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np
from numpy.typing import NDArray

from gpuspec.light.constants import EXPOSURES, SUB_RAYS, TABLE_STEPS
from gpuspec.light.light_map import LightMap
from gpuspec.light.lists import Lists
from gpuspec.light.records import design_block
from gpuspec.station.station import Station

BOUND = 0.004
"""Of what a cubic of a table may be off, see `measure_footprints`: so bounded, of 255 grey levels
rms 0.003, of 1 pixel in 200 more than 0.02, on hard designs. At 0.01 it is rms 0.015."""

_GROUP = 64


def can_be_tables(parts: Sequence[Any]) -> bool:
    """Whether a device holds lists whole, of few enough sub-rays for their footprints' tables.

    Parameters
    ----------
    parts : sequence of OpenCLLightMap
    """
    return all(part.tiles == 1 and part.station.camera.sub_rays <= SUB_RAYS for part in parts)


class FootprintLists(Lists[LightMap]):
    """Lists that an OpenCL device holds, each in one tile.

    Parameters
    ----------
    parts : sequence of OpenCLLightMap
    """

    def __init__(self, parts: Sequence[LightMap]) -> None:
        super().__init__(parts)
        self._tables: _Tables | None = None

    def means_of_exposures(
        self, station: Station, exposures: Sequence[float]
    ) -> NDArray[np.float32]:
        """See :meth:`Lists.means_of_exposures`; the tables are laid when first asked for."""
        first: Any = self.parts[0]
        with first.failures():
            if self._tables is None:
                self._tables = _Tables(self.parts)
            return self._tables.means(first.lit_by(first.under(station)), exposures)


class _Tables:
    """The tables of lists, in one buffer, and the light maps of the pixels that none holds."""

    def __init__(self, parts: Sequence[Any]) -> None:
        self._backend = b = parts[0].backend
        tiles = [next(part.bands())[0] for part in parts]
        counts = [part.stride * part.grid[0] for part in parts]
        begins = np.concatenate([[0], np.cumsum(counts)])
        self._count = int(begins[-1])
        begin, step, steps, whole = (b.empty(4 * self._count) for _ in range(4))
        for part, tile, at, count in zip(parts, tiles, begins, counts, strict=False):
            b.start(
                "footprints.cl", "measure_footprints",
                (count // b.widths["footprints.cl"],), begin, step, steps, whole,
                *tile.planes, np.int32(part.station.camera.sub_rays), np.uint32(at),
                np.float32(BOUND),
            )  # fmt: skip
        needed = np.empty(self._count, np.float32)
        b.copy_home(needed, steps)
        first = np.zeros(self._count + 1, np.uint32)
        np.cumsum(np.where(needed <= TABLE_STEPS, needed + (needed > 0), 0), out=first[1:])
        self._first, self._measures = b.constant(first), (begin, step, whole)
        self._nodes = b.empty(max(8 * int(first[-1]), 8))
        for part, tile, at, count in zip(parts, tiles, begins, counts, strict=False):
            b.start(
                "footprints.cl", "lay_footprints", (count // b.widths["footprints.cl"],),
                self._nodes, *tile.planes, self._first, *self._measures,
                np.int32(part.station.camera.sub_rays), np.uint32(at), group=(1,),
            )  # fmt: skip
        self._own = [slice(at, at + part.shape[1]) for part, at in zip(parts, begins, strict=False)]
        self._beyond = []
        total = 0
        for part, own in zip(parts, self._own, strict=True):
            far = np.flatnonzero(needed[own] > TABLE_STEPS)
            if len(far):
                listed = part.again(part.station, part.pixels[far])
                self._beyond.append((total + far, listed))
            total += part.shape[1]

    def means(self, station: Station, exposures: Sequence[float]) -> NDArray[np.float32]:
        """See :meth:`Lists.means_of_exposures`."""
        b = self._backend
        design = b.constant(design_block(station))
        found = []
        grey = b.empty(4 * min(len(exposures), EXPOSURES) * self._count)
        for first in range(0, len(exposures), EXPOSURES):
            some = np.array(exposures[first : first + EXPOSURES], np.float32)
            b.start(
                "footprints.cl", "means_of_footprints", (self._count,), grey, self._nodes,
                self._first, *self._measures, design, b.constant(some), np.int32(len(some)),
                group=(_GROUP,),
            )  # fmt: skip
            means = np.empty((len(some), self._count), np.float32)
            b.copy_home(means, grey)
            found.append(np.concatenate([means[:, own] for own in self._own], axis=1))
        seen = np.concatenate(found)
        for places, light_map in self._beyond:
            own = light_map.means_of_exposures(light_map.under(station), exposures)
            seen[:, places] = own[:, 0]
        return seen
