"""Lists of pixels of many sub-rays, whose footprints are added up once for all designs.

See `kernels/footprints.cl`.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from gpuspec.light.constants import (
    EXPOSURES,
    NO_PIXEL,
    SUB_RAYS,
    TABLE_STEPS,
)
from gpuspec.light.float64_noise import Moments
from gpuspec.light.levels import levels_per_dn
from gpuspec.light.light_map import PLANES, LightMap
from gpuspec.light.lists import Lists, SetLevels, Sets, alike
from gpuspec.light.opencl_levels import device_noise
from gpuspec.light.records import design_block
from gpuspec.station.station import Station

BOUND = 0.0025
"""Of what a cubic of a table may be off, see `measure_footprints`: so bounded, of 255 grey levels
rms 0.001 and hardly ever above 0.02, measured over hard designs; at 0.01 it is rms 0.015."""


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
        self._known: _Tables | None = None
        self._counted: _Counted | None = None

    def means_of_exposures(
        self, station: Station, exposures: Sequence[float]
    ) -> NDArray[np.float32]:
        """See :meth:`Lists.means_of_exposures`; the tables are laid when first asked for."""
        with self.parts[0].failures():
            return self._tables(station).means(station, exposures)

    def one_draw(self, station: Station) -> NDArray[np.float32]:
        """See :meth:`Lists.one_draw`: by its moments."""
        with self.parts[0].failures():
            return self._tables(station).draw(station)

    def moments(self, station: Station) -> Moments:
        """See :meth:`Lists.moments`."""
        with self.parts[0].failures():
            return self._tables(station).moments(station)

    def count(self, stations: Sequence[Station], sets: Sets) -> SetLevels:
        """See :meth:`Lists.count`."""
        with self.parts[0].failures():
            tables = self._tables(stations[0])
            if self._counted is None or self._counted.sets is not sets:
                self._counted = _Counted(tables, sets)
            return self._counted.under(stations)

    def _tables(self, station: Station) -> _Tables:
        first = self.parts[0]
        first.lit_by(first.under(station))
        if self._known is None:
            self._known = _Tables(self.parts)
        return self._known


def _group(width: int) -> tuple[int, ...] | None:
    """Return how many work-items a group has: a CPU's driver gives each a stack of its own."""
    return (1,) if width > 1 else None


class _Tables:
    """The tables of lists, in one buffer, and the light maps of the pixels that none holds."""

    def __init__(self, parts: Sequence[Any]) -> None:
        self.backend = b = parts[0].backend
        width = b.widths["footprints.cl"]
        tiles = [next(part.bands())[0] for part in parts]
        sizes = [part.stride * part.grid[0] for part in parts]
        begins = np.cumsum([0, *sizes])
        begin, step, steps, whole = (b.empty(4 * int(begins[-1])) for _ in range(4))
        for part, tile, own, size in zip(parts, tiles, begins, sizes, strict=False):
            b.start(
                "footprints.cl", "measure_footprints", (size // width,), begin, step, steps, whole,
                *tile.planes, np.int32(part.station.camera.sub_rays), np.uint32(own),
                np.float32(BOUND),
            )  # fmt: skip
        needed = np.empty(begins[-1], np.float32)
        b.copy_home(needed, steps)
        taken = needed.clip(0, TABLE_STEPS + 1).astype(np.uint16)
        first = np.zeros(len(taken) + 1, np.uint32)
        np.cumsum(np.where(taken <= TABLE_STEPS, taken + 1, 0), out=first[1:])
        self.nodes = b.empty(8 * max(int(first[-1]), 1))
        firsts = b.constant(first)
        for part, tile, own, size in zip(parts, tiles, begins, sizes, strict=False):
            b.start(
                "footprints.cl", "lay_footprints", (size // width,), self.nodes, *tile.planes,
                firsts, begin, step, whole, np.int32(part.station.camera.sub_rays), np.uint32(own),
                group=_group(width),
            )  # fmt: skip
        ends = np.cumsum([0, *(part.shape[1] for part in parts)])
        self.pixels = int(ends[-1])
        own = np.concatenate(
            [np.arange(n) + at for n, at in zip(np.diff(ends), begins, strict=False)]
        )
        # Pixels whose footprints take as many steps are neighbours: they meet as many edges.
        taken = taken[own]
        order = np.argsort(taken, kind="stable")
        held = int(np.count_nonzero(taken <= TABLE_STEPS))
        filling = np.repeat(order[max(held - 1, 0) : held], -held % b.widths["lookup.cl"])
        order = np.concatenate([order[:held], filling])
        numbers = np.concatenate([part.pixels for part in parts])
        nothing = b.empty(4)
        tables = (
            self.nodes,
            *(b.constant(a.astype(np.uint32)) for a in (first[own[order]], own[order])),
        )
        columns = np.uint32(parts[0].station.shape[1])
        self.batches = [
            _Batch(
                (*tables, begin, step, steps, whole, *[nothing] * PLANES, np.int32(0), np.uint32(0),
                 b.constant(numbers[order]), columns),
                order, 1.0,
            )
        ]  # fmt: skip
        for part, start, end in zip(parts, ends, ends[1:], strict=False):
            far = np.flatnonzero(taken[start:end] > TABLE_STEPS)
            if len(far):
                own_map = part.again(part.station, part.pixels[far])
                ((tile, _),) = own_map.bands()
                places = np.full(own_map.listed().size, NO_PIXEL, np.int64)
                places[: len(far)] = start + far
                rays = np.int32(part.station.camera.sub_rays)
                self.batches.append(
                    _Batch(
                        (*[nothing] * 7, *tile.planes, rays, np.uint32(len(places)),
                         b.constant(own_map.listed()), columns),
                        places, float(rays),
                    )
                )  # fmt: skip
        self._to = self.at(np.arange(self.pixels))

    def at(self, places: NDArray[np.int64]) -> list[Any]:
        """Return, on the device, where the lists' pixels are wanted.

        Parameters
        ----------
        places : ndarray of int64, shape (n,)
            Of the lists' pixels, one after another; ``NO_PIXEL`` where they are not.
        """
        known = np.append(places, NO_PIXEL).astype(np.uint32)
        return [
            self.backend.constant(known[np.minimum(batch.places, self.pixels)])
            for batch in self.batches
        ]

    def start(
        self, kernel: str, out: Any, station: Station, exposures: Sequence[float],
        to: Sequence[Any], places: int, *more: Any,
    ) -> None:  # fmt: skip
        """Start a kernel that looks at all of them.

        Parameters
        ----------
        kernel : str
        out : Buffer
        station : Station
        exposures : sequence of float
            ``EXPOSURES`` at most.
        to : sequence of Buffer
            See `at`.
        places : int
            Of a plane of `out`.
        *more
            What else the kernel takes.
        """
        b, width = self.backend, self.backend.widths["lookup.cl"]
        design = b.constant(design_block(station))
        gains, count = b.constant(np.array(exposures, np.float32)), np.int32(len(exposures))
        table = device_noise(station.sensor, b)[:2]
        for batch, own in zip(self.batches, to, strict=True):
            images = width * station.sequence.images * batch.cost
            for some in b.launches(batch.name, np.full(len(batch.places) // width, images)):
                b.start(
                    "lookup.cl", kernel, (some.stop - some.start,), out, np.uint32(places),
                    *batch.given, own, *table, design, gains, count, *more,
                    offset=(some.start,), group=_group(width),
                )  # fmt: skip

    def means(self, station: Station, exposures: Sequence[float]) -> NDArray[np.float32]:
        """See :meth:`Lists.means_of_exposures`."""
        quiet = station.sensor.model_copy(update={"noise": False})
        station = station.model_copy(update={"sensor": quiet})
        found = [
            self._seen("means_of_refined", station, exposures[i : i + EXPOSURES])
            for i in range(0, len(exposures), EXPOSURES)
        ]
        return np.concatenate(found)

    def draw(self, station: Station) -> NDArray[np.float32]:
        """See :meth:`Lists.one_draw`."""
        return self._seen("means_of_refined", station, [station.sensor.exposure]).ravel()

    def moments(self, station: Station) -> Moments:
        """See :meth:`Lists.moments`."""
        return Moments(*self._seen("moments_of_refined", station, [station.sensor.exposure], 2))

    def _seen(
        self, kernel: str, station: Station, exposures: Sequence[float], planes: int | None = None
    ) -> NDArray[np.float32]:
        """Return what a kernel finds of every pixel, shape (planes, n); None: one per exposure."""
        seen = np.empty((planes or len(exposures), self.pixels), np.float32)
        grey = self.backend.empty(seen.nbytes)
        self.start(kernel, grey, station, exposures, self._to, self.pixels)
        self.backend.copy_home(seen, grey)
        return seen


@dataclass(frozen=True)
class _Batch:
    """Pixels that a kernel looks at in one launch: those in tables, or those of one light map.

    Attributes
    ----------
    given : tuple
        What it takes of them.
    places : ndarray of int64, shape (n,)
        Of the pixels in the lists, as they lie side by side on the device; ``NO_PIXEL``: of none.
    cost : float
        Of an image, see `OpenCLDevice.launches`.
    """

    given: tuple[Any, ...]
    places: NDArray[np.int64]
    cost: float

    @property
    def name(self) -> str:
        """Under which the device remembers how much it does at once."""
        return "tables" if self.cost == 1 else "sub-rays"


class _Counted:
    """Sets of pixels whose levels the device counts."""

    def __init__(self, tables: _Tables, sets: Sets) -> None:
        self._tables, self.sets = tables, sets
        self._backend = b = tables.backend
        self._pixels = len(sets.order)
        to = np.full(tables.pixels, NO_PIXEL, np.int64)
        to[sets.order] = np.arange(self._pixels)
        self._to = tables.at(to)
        self._sets = tuple(b.constant(a.astype(np.uint32)) for a in (sets.first, sets.kinds))

    def under(self, stations: Sequence[Station]) -> SetLevels:
        """See :meth:`Lists.count`."""
        b, sets = self._backend, len(self.sets.kinds)
        found = SetLevels.empty(len(stations), sets)
        if not sets:
            return found
        levels = b.empty(EXPOSURES * self._pixels)
        counts, highest = (np.zeros(a.shape, np.uint32) for a in (found.counts, found.highest))
        counters, peaks = b.counters(*counts.shape), b.counters(*highest.shape)
        done: list[int] = []
        for group in alike(stations):
            for some in np.split(group, range(EXPOSURES, len(group), EXPOSURES)):
                own = [stations[i] for i in some]
                self._tables.start(
                    "levels_of_refined", levels, own[0], [s.sensor.exposure for s in own],
                    self._to, self._pixels, levels_per_dn(own[0].sensor.full_scale_dn),
                )  # fmt: skip
                b.start(
                    "lookup.cl", "count_refined", (len(some), sets), counters, peaks, levels,
                    *self._sets, np.uint32(self._pixels), np.uint32(len(done)),
                )  # fmt: skip
                done += some.tolist()
        b.copy_home(counts, counters, wait=False)
        b.copy_home(highest, peaks)
        found.counts[done], found.highest[done] = counts, highest
        return found
