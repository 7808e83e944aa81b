"""Levels on an OpenCL device: `kernels/sweep.cl` on a traced part."""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from gpuspec.light.constants import LEVELS, NO_PIXEL
from gpuspec.light.levels import Levels, Pixels, Sample, Zones, levels_of, levels_per_dn
from gpuspec.light.light_map import has_closed_form
from gpuspec.light.records import design_block
from gpuspec.station.station import Station

_STRETCH = 16_384
_GROUP = 256
_DESIGNS_MAX = 4096
_AT_ONCE = 1 << 28  # designs times pixels of what no launch parts: a stretch, a zone
_BYTES = 1 << 26  # of peaks, or of ceilings, on the device
_COST = 3  # of a pixel under a design, see `OpenCLDevice.launches`
# A level's share by which float32 may round a bound down: a hundred times what the closed form is
# off against float64.
_ROUNDING = 0.02


@dataclass(frozen=True)
class _PixelSet:
    """Pixels of a light map side by side on the device, a whole number of vectors."""

    light: Any
    footprint: Any
    irradiance: Any
    count: int


class OpenCLCounter:
    """Counts levels on the device; images without a closed form are brought home and counted there.

    Parameters
    ----------
    light_map : OpenCLLightMap
    zones : Zones
    sample : Sample, optional
        Pixels that stand for all others; None: all are counted.
    """

    def __init__(self, light_map: Any, zones: Zones, sample: Sample | None = None) -> None:
        self._map = light_map
        self._backend = light_map.backend
        self._zones = zones
        self._sample: tuple[_PixelSet, _PixelSet] | None = None
        width = self._backend.widths["sweep.cl"]
        with self._backend.failures():
            ends, places = _whole_vectors(zones, width)
            self._first = self._backend.constant(ends.astype(np.uint32))
            self._sizes = np.diff(ends)
            self._inside = self._gathered(places)
            if sample is not None:
                near, chosen = (_padded(p, width) for p in (sample.near, sample.chosen))
                self._sample = self._gathered(near), self._gathered(chosen)
                fill = -len(sample.footprint_mm) % width
                self._regions = tuple(
                    self._backend.constant(np.pad(bound, (0, fill), mode="edge"))
                    for bound in (sample.footprint_mm, sample.irradiance)
                )
                self._region_vectors = -(-len(sample.footprint_mm) // width)

    def count(self, stations: Sequence[Station]) -> Levels:
        """See :meth:`gpuspec.light.levels.LevelCounter.count`."""
        found = Levels.empty(len(stations), len(self._zones.sizes))
        scales = np.array([station.sensor.full_scale_dn for station in stations])
        closed = np.array([has_closed_form(s) for s in stations])
        for i in np.flatnonzero(~closed):
            image = self._map.aspect(self._map.under(stations[int(i)]))
            found.put(np.array([i]), levels_of(image, self._zones, scales[i]))
        whole = max(_STRETCH, self._sizes.max(initial=0))
        at_once = min(max(_AT_ONCE // whole, 1), _DESIGNS_MAX)
        for scale in np.unique(scales[closed]):
            same = np.flatnonzero(closed & (scales == scale))
            for some in np.split(same, range(at_once, len(same), at_once)):
                blocks = np.stack([design_block(stations[i]) for i in some])
                found.put(some, self._counted(blocks, levels_per_dn(scale)))
        return found

    def _counted(self, blocks: NDArray[np.float32], per_dn: np.float32) -> Levels:
        with self._backend.failures():
            designs, count = self._backend.constant(blocks), len(blocks)
            sets: list[Iterable[_PixelSet]] = [[self._inside]]
            sets += [[part] for part in self._sample] if self._sample else [self._whole()]
            inside, outside, *sampled = (self._counts(s, designs, count, per_dn) for s in sets)
            peaks = self._peaks(designs, count, per_dn)
            ceiling = self._ceiling(designs, count, per_dn)
        if not sampled:  # the whole image was counted, zones included
            outside -= inside
            sampled = [np.zeros_like(inside)]
        return Levels(inside, outside, sampled[0], peaks, ceiling)

    def _counts(
        self, parts: Iterable[_PixelSet], designs: Any, count: int, per_dn: np.float32
    ) -> NDArray[np.int64]:
        """Return how often each level comes under each design."""
        b = self._backend
        counters = b.counters(count, LEVELS)
        items = 1
        if b.widths["sweep.cl"] == 1:
            items = b.group("sweep.cl", "count_levels", _GROUP)
        for part in parts:
            stretches = np.full(-(-part.count // _STRETCH), _COST * count * _STRETCH)
            for some in b.launches("count_levels", stretches):
                b.start(
                    "sweep.cl", "count_levels", (count, (some.stop - some.start) * items),
                    counters, part.light, part.footprint, part.irradiance, designs, per_dn,
                    np.uint32(part.count), np.uint32(_STRETCH),
                    offset=(0, some.start * items), group=(1, items),
                )  # fmt: skip
        counts = np.empty((count, LEVELS), np.uint32)
        b.copy_home(counts, counters)
        return counts.astype(np.int64)

    def _peaks(self, designs: Any, count: int, per_dn: np.float32) -> NDArray[np.int64]:
        """Return the highest level in each zone under each design."""
        inside = self._inside
        highest = self._by_zone(
            "zone_peaks", count, _COST * count * (self._sizes + 1),
            inside.light, inside.footprint, inside.irradiance, designs, per_dn, self._first,
        )  # fmt: skip
        return np.concatenate([np.empty((count, 0)), *highest], axis=1).astype(np.int64)

    def _ceiling(self, designs: Any, count: int, per_dn: np.float32) -> NDArray[np.int64]:
        """Return the level that no pixel of the strata is above."""
        if self._sample is None:
            return np.zeros(count, np.int64)
        vectors = np.full(self._region_vectors, _COST * count * self._backend.widths["sweep.cl"])
        highest = np.max(
            [
                some.max(axis=1)
                for some in self._by_zone(
                    "ceilings", count, vectors, *self._regions, designs, per_dn
                )
            ],
            axis=0,
        )
        bounded: NDArray[np.int64] = np.ceil(highest + _ROUNDING).astype(np.int64)
        return np.clip(bounded, 1, LEVELS - 1)

    def _by_zone(
        self, kernel: str, count: int, work: NDArray[Any], *arguments: Any
    ) -> Iterator[NDArray[np.float32]]:
        """Yield what a kernel finds highest under each design, (designs, zones), some zones a time.

        Parameters
        ----------
        kernel : str
            One work-item for a design and a zone, or for a design and a vector of regions.
        count : int
            Number of designs.
        work : ndarray, shape (zones,)
            See `OpenCLDevice.launches`.
        *arguments
            Of the kernel, after the buffer of what it finds.
        """
        b = self._backend
        width = b.widths["sweep.cl"]
        most = max(_BYTES // (4 * count * width), 1)
        buffer = b.empty(4 * count * width * min(most, max(len(work), 1)))
        for some in b.launches(kernel, work, most):
            zones = some.stop - some.start
            b.start("sweep.cl", kernel, (count, zones), buffer, *arguments, offset=(0, some.start))
            lanes = np.empty((count, zones, width), np.float32)
            b.copy_home(lanes, buffer)
            yield lanes.max(axis=2)

    def _whole(self) -> Iterator[_PixelSet]:
        """Yield the whole light map, tile by tile; what pads a row sees no light."""
        for tile, _ in self._map.bands():
            size = tile.rows * self._map.stride
            yield _PixelSet(tile.light, tile.footprint, tile.irradiance, size)

    def _gathered(self, pixels: Pixels) -> _PixelSet:
        """Put pixels of the light map, by flat index into the image, side by side."""
        b, columns = self._backend, self._map.station.shape[1]
        parts = [b.empty(max(4 * len(pixels), 4)) for _ in range(3)]
        for tile, rows in self._map.bands():
            row, column = np.divmod(pixels.astype(np.int64), columns)
            here = (row >= rows.start) & (row < rows.stop) & (pixels != NO_PIXEL)
            at = np.where(here, (row - rows.start) * self._map.stride + column, NO_PIXEL)
            if len(pixels):
                b.start(
                    "sweep.cl", "gather_pixels", (len(pixels),), *parts,
                    tile.light, tile.footprint, tile.irradiance, b.constant(at.astype(np.uint32)),
                    np.int32(rows.start == 0),
                )  # fmt: skip
        return _PixelSet(parts[0], parts[1], parts[2], len(pixels))


def _padded(pixels: Pixels, width: int) -> Pixels:
    """Return pixels with as many of none behind them as make whole vectors."""
    return np.pad(pixels, (0, -len(pixels) % width), constant_values=NO_PIXEL)


def _whole_vectors(zones: Zones, width: int) -> tuple[NDArray[np.int64], Pixels]:
    """Return where zones begin and their pixels, each zone padded to whole vectors."""
    parts = [
        _padded(zones.pixels[a:b], width)
        for a, b in zip(zones.first[:-1], zones.first[1:], strict=True)
    ]
    ends = np.cumsum([0, *map(len, parts)])
    return ends, np.concatenate([np.empty(0, np.uint32), *parts])
