"""Lists of pixels of many sub-rays, whose footprints are added up once for all designs.

See `kernels/footprints.cl` and `kernels/lookup.cl`.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from gpuspec.light.constants import EXPOSURES, NO_PIXEL, SUB_RAYS, TABLE_STEPS
from gpuspec.light.float64_noise import Moments
from gpuspec.light.levels import levels_per_dn
from gpuspec.light.light_map import PLANES, LightMap, without_noise
from gpuspec.light.lists import Lists, SetCounter, SetLevels, Sets, alike
from gpuspec.light.opencl_levels import device_noise
from gpuspec.light.records import design_block
from gpuspec.station.station import Station

BOUND = 0.0025
"""Of what a cubic of a table may be off, see `measure_footprints`: so bounded, of 255 grey levels
rms 0.001 and hardly ever above 0.02, measured over hard designs; at 0.01 it is rms 0.015."""

ALIKE = 8
"""Sub-rays on a side, or slices, beyond which the bound falls as their number grows: neighbours are
more and more alike, and what one is off the next does not put right."""

_NODES_MAX = 1 << 30  # their floats are counted in 32 bits
_NODE_BYTES = 8
_STRETCH = 1024  # pixels of a set that one work-item counts
# What a pixel costs, in units of one image in the mean: a lookup, and what an exposure adds to it,
# without noise and with; laying its table.
_LOOKUP, _EXPOSURE, _NOISY, _LAID = 1.5, 0.05, 0.5, 4.0

Ints = NDArray[np.int64]


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
        At least one.
    """

    def __init__(self, parts: Sequence[LightMap]) -> None:
        super().__init__(parts)
        self._known: Tables | None = None

    def release(self) -> None:
        """See :meth:`Lists.release`."""
        self._known = None

    def tables(self, station: Station) -> Tables:
        """Return the tables, laid when first asked for.

        Parameters
        ----------
        station : Station
            A design of the geometry.
        """
        first = self.parts[0]
        first.lit_by(first.under(station))
        known = self._known
        if known is None:
            known = self._known = Tables(self.parts)
        return known

    def means_of_exposures(
        self, station: Station, exposures: Sequence[float]
    ) -> NDArray[np.float32]:
        """See :meth:`Lists.means_of_exposures`."""
        with self.parts[0].failures():
            tables, quiet = self.tables(station), without_noise(station)
            found = [
                tables.planes("aspects_of_refined", quiet, exposures[i : i + EXPOSURES])
                for i in range(0, len(exposures), EXPOSURES)
            ]
        return np.concatenate(found)

    def one_draw(self, station: Station) -> NDArray[np.float32]:
        """See :meth:`Lists.one_draw`."""
        with self.parts[0].failures():
            own = [station.sensor.exposure]
            return self.tables(station).planes("aspects_of_refined", station, own).ravel()

    def moments(self, station: Station) -> Moments:
        """See :meth:`Lists.moments`."""
        with self.parts[0].failures():
            own = [station.sensor.exposure]
            return Moments(*self.tables(station).planes("moments_of_refined", station, own, 2))

    def counter(self, sets: Sets) -> SetCounter:
        """See :meth:`Lists.counter`."""
        return _Counter(self, sets)


@dataclass(frozen=True)
class _Batch:
    """Pixels that a kernel looks at in the same way: in tables, or by the sub-rays of a light map.

    Attributes
    ----------
    name : str
        Under which the device remembers how much it does at once.
    given : tuple
        What a kernel takes of them.
    places : ndarray of int64, shape (n,)
        Of the pixels in the lists, as they lie side by side on the device; ``NO_PIXEL``: of none.
    cost : float
        Of an image, see `OpenCLDevice.launches`.
    """

    name: str
    given: tuple[Any, ...]
    places: Ints
    cost: float


class Tables:
    """The tables of lists, in one buffer, and the light maps of the pixels that none holds.

    Parameters
    ----------
    parts : sequence of OpenCLLightMap
        The lists.
    """

    def __init__(self, parts: Sequence[Any]) -> None:
        self.backend = b = parts[0].backend
        tiles = [next(part.bands())[0] for part in parts]
        sizes = [part.stride * part.grid[0] for part in parts]
        begins = np.cumsum([0, *sizes])
        measures = tuple(b.empty(4 * int(begins[-1])) for _ in range(4))
        begin, step, steps, whole = measures
        lists = list(zip(parts, tiles, begins.tolist(), strict=False))
        for part, tile, at in lists:
            bound = BOUND * min(ALIKE / part.station.camera.side, 1)
            self._start_once("measure_footprints", part, tile, at, measures, bound)
        needed, long = (np.empty(begins[-1], np.float32) for _ in range(2))
        b.copy_home(needed, steps, wait=False)
        b.copy_home(long, step)
        long *= needed
        taken = needed.clip(0, TABLE_STEPS + 1).astype(np.int64)
        room = min(b.memory_bytes, b.device.max_mem_alloc_size) // _NODE_BYTES
        kept = np.where(taken <= TABLE_STEPS, taken + 1, 0)
        taken[np.cumsum(kept) > min(room, _NODES_MAX)] = TABLE_STEPS + 1
        kept[taken > TABLE_STEPS] = 0
        first = np.concatenate([[0], np.cumsum(kept)])
        nodes = b.empty(_NODE_BYTES * max(int(first[-1]), 1))
        firsts = b.constant(first.astype(np.uint32))
        for part, tile, at in lists:
            self._start_once("lay_footprints", part, tile, at, (nodes, firsts, begin, step, whole))
        ends = np.cumsum([0, *(part.shape[1] for part in parts)])
        self.pixels = int(ends[-1])
        own = np.concatenate(
            [at + np.arange(part.shape[1]) for part, _, at in lists], dtype=np.int64
        )
        taken = taken[own]
        # Pixels whose footprints are as long, to 1 %, are neighbours: as many edges cut them.
        tabled = taken <= TABLE_STEPS
        length = long[own].view(np.uint32) >> 15
        order = np.argsort(np.where(tabled, length, 0xFFFF).astype(np.uint16), kind="stable")
        held = int(np.count_nonzero(tabled))
        filling = np.repeat(order[max(held - 1, 0) : held], -held % b.widths["lookup.cl"])
        order = np.concatenate([order[:held], filling])
        numbers = np.concatenate([part.pixels for part in parts])
        columns, nothing = np.uint32(parts[0].station.shape[1]), b.empty(4)
        laid = (first[own[order]], own[order], numbers[order])
        at_first, of, number = (b.constant(values.astype(np.uint32)) for values in laid)
        self.batches = [
            _Batch(
                "tables",
                (nodes, at_first, of, *measures, *[nothing] * PLANES, np.int32(0), np.uint32(0),
                 number, columns),
                order, _LOOKUP,
            )
        ]  # fmt: skip
        for part, start, end in zip(parts, ends, ends[1:], strict=False):
            far = np.flatnonzero(taken[start:end] > TABLE_STEPS)
            for tile, numbers, places in _by_rays(part, far) if len(far) else ():
                rays = np.int32(part.station.camera.sub_rays)
                self.batches.append(
                    _Batch(
                        "sub-rays",
                        (*[nothing] * 7, *tile.planes, rays, np.uint32(numbers.size),
                         b.constant(numbers), columns),
                        np.where(places == NO_PIXEL, NO_PIXEL, start + places), float(rays),
                    )
                )  # fmt: skip
        self._to = self.at(np.arange(self.pixels))

    def _start_once(
        self, kernel: str, part: Any, tile: Any, at: int, buffers: tuple[Any, ...], *more: float
    ) -> None:
        """Start a kernel that makes the tables of a list whose pixels are numbered from `at` on."""
        b, width = self.backend, self.backend.widths["footprints.cl"]
        size, rays = part.stride * part.grid[0], part.station.camera.sub_rays
        for some in b.launches(kernel, np.full(size // width, _LAID * width * rays)):
            b.start(
                "footprints.cl", kernel, (some.stop - some.start,), *buffers, *tile.planes,
                np.int32(rays), np.uint32(size), np.uint32(at), *map(np.float32, more),
                offset=(some.start,),
            )  # fmt: skip

    def at(self, places: Ints) -> list[Any]:
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
        more_each = (_NOISY if station.sensor.noise else _EXPOSURE) * len(exposures)
        for batch, own in zip(self.batches, to, strict=True):
            work = width * station.sequence.images * (batch.cost + more_each)
            for some in b.launches(batch.name, np.full(len(batch.places) // width, work)):
                b.start(
                    "lookup.cl", kernel, (some.stop - some.start,), out, np.uint32(places),
                    *batch.given, own, *table, design, gains, count, *more,
                    offset=(some.start,),
                )  # fmt: skip

    def planes(
        self, kernel: str, station: Station, exposures: Sequence[float], count: int | None = None
    ) -> NDArray[np.float32]:
        """Return what a kernel finds of every pixel.

        Parameters
        ----------
        kernel, station, exposures
            See `start`.
        count : int, optional
            Of its planes; None: one for each exposure.

        Returns
        -------
        ndarray of float32, shape (planes, n)
        """
        seen = np.empty((count or len(exposures), self.pixels), np.float32)
        grey = self.backend.empty(seen.nbytes)
        self.start(kernel, grey, station, exposures, self._to, self.pixels)
        self.backend.copy_home(seen, grey)
        return seen


class _Counter:
    """Counts the levels of sets of pixels on the device, some pixels a work-item."""

    def __init__(self, lists: FootprintLists, sets: Sets) -> None:
        self._lists, self._sets = lists, sets
        self._ready: tuple[Tables, list[Any], tuple[Any, ...]] | None = None
        first, end = sets.first[:-1], sets.first[1:]
        pieces = -(-(end - first) // _STRETCH)
        self._begin = np.cumsum(pieces) - pieces  # of a set, among the stretches
        into = np.arange(pieces.sum()) - np.repeat(self._begin, pieces)
        self._stretches = np.append(np.repeat(first, pieces) + _STRETCH * into, sets.first[-1])
        self._kinds = np.repeat(sets.kinds, pieces)

    def __call__(self, stations: Sequence[Station]) -> SetLevels:
        """See :meth:`Lists.counter`."""
        found = SetLevels.empty(len(stations), len(self._sets.kinds))
        if not stations or not len(self._sets.kinds):
            return found
        with self._lists.parts[0].failures():
            tables = self._lists.tables(stations[0])
            if self._ready is None or self._ready[0] is not tables:
                self._ready = tables, *self._on_device(tables)
            return self._counted(stations, found, *self._ready)

    def _on_device(self, tables: Tables) -> tuple[list[Any], tuple[Any, ...]]:
        """Return where the pixels' levels are wanted, and the stretches with their kinds."""
        to = np.full(tables.pixels, NO_PIXEL, np.int64)
        to[self._sets.order] = np.arange(len(self._sets.order))
        constants = self._stretches, self._kinds
        return tables.at(to), tuple(
            tables.backend.constant(values.astype(np.uint32)) for values in constants
        )

    def _counted(
        self, stations: Sequence[Station], found: SetLevels, tables: Tables, to: Sequence[Any],
        stretches: tuple[Any, ...],
    ) -> SetLevels:  # fmt: skip
        b, pixels, pieces = tables.backend, len(self._sets.order), len(self._kinds)
        levels = b.empty(EXPOSURES * pixels)
        counts = np.zeros(found.counts.shape, np.uint32)
        highest = np.zeros((len(stations), pieces), np.uint32)
        counters, peaks = b.counters(*counts.shape), b.counters(*highest.shape)
        done: list[int] = []
        for group in alike(stations):
            for some in np.split(group, range(EXPOSURES, len(group), EXPOSURES)):
                own = [stations[i] for i in some]
                tables.start(
                    "levels_of_refined", levels, own[0], [s.sensor.exposure for s in own], to,
                    pixels, levels_per_dn(own[0].sensor.full_scale_dn),
                )  # fmt: skip
                b.start(
                    "lookup.cl", "count_refined", (len(some), pieces), counters, peaks, levels,
                    *stretches, np.uint32(pixels), np.uint32(len(done)),
                )  # fmt: skip
                done += some.tolist()
        b.copy_home(counts, counters, wait=False)
        b.copy_home(highest, peaks)
        found.counts[done] = counts
        found.highest[done] = np.maximum.reduceat(highest, self._begin, axis=1)
        return found


def _by_rays(part: Any, far: Ints) -> Iterator[tuple[Any, NDArray[np.uint32], Ints]]:
    """Yield tiles of some pixels of a list, the numbers of theirs and their places in the list."""
    light_map = part.again(part.station, part.pixels[far])
    numbers = light_map.listed()
    places = np.full(numbers.shape, NO_PIXEL, np.int64)
    places.flat[: len(far)] = far
    for tile, rows in light_map.bands():
        yield tile, numbers[rows].ravel(), places[rows].ravel()
