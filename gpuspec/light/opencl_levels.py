"""Levels on an OpenCL device: `kernels/sweep.cl` on a traced part."""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from gpuspec.light.levels import LEVELS, Levels, Pixels, Sample, Zones, levels_of, levels_per_dn
from gpuspec.light.light_map import has_closed_form
from gpuspec.light.records import design_block
from gpuspec.station.station import Station

_NO_PIXEL = 0xFFFFFFFF
_STRETCH = 16_384
_GROUP = 256
# Pixels times designs of one launch: a second on two slow cores, so that Ctrl-C is answered.
_AT_ONCE = 400_000_000
_DESIGNS_MAX = 4096
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

    @property
    def pixels(self) -> int:
        """Pixels worked out for a design in closed form."""
        if self._sample is None:
            rows, columns = self._map.station.shape
            return int(rows * columns)
        return self._inside.count + sum(part.count for part in self._sample)

    def count(self, stations: Sequence[Station]) -> Levels:
        """See :meth:`gpuspec.light.levels.LevelCounter.count`."""
        found = Levels.empty(len(stations), len(self._zones.sizes))
        scales = np.array([station.sensor.full_scale_dn for station in stations])
        closed = np.array([has_closed_form(s) for s in stations])
        for i in np.flatnonzero(~closed):
            image = self._map.aspect(self._map.under(stations[int(i)]))
            found.put(np.array([i]), levels_of(image, self._zones, scales[i]))
        at_once = min(max(_AT_ONCE // self.pixels, 1), _DESIGNS_MAX)
        for scale in np.unique(scales[closed]):
            same = np.flatnonzero(closed & (scales == scale))
            for some in np.split(same, range(at_once, len(same), at_once)):
                blocks = np.stack([design_block(stations[i]) for i in some])
                found.put(some, self._counted(blocks, levels_per_dn(scale)))
        return found

    def _counted(self, blocks: NDArray[np.float32], per_dn: np.float32) -> Levels:
        b, defects = self._backend, len(self._zones.sizes)
        with b.failures():
            designs = b.constant(blocks)
            sets: list[Iterable[_PixelSet]] = [[self._inside]]
            sets += [[part] for part in self._sample] if self._sample else [self._whole()]
            counters = [b.constant(np.zeros((len(blocks), LEVELS), np.uint32)) for _ in sets]
            for counter, parts in zip(counters, sets, strict=True):
                for part in parts:
                    self._enqueue(counter, part, designs, len(blocks), per_dn)
            peaks = np.zeros((len(blocks), defects, b.widths["sweep.cl"]), np.float32)
            if defects:
                highest = b.empty(peaks.nbytes)
                b.kernel("sweep.cl", "zone_peaks")(
                    b.queue, peaks.shape[:2], None, highest, self._inside.light,
                    self._inside.footprint, self._inside.irradiance, designs, per_dn, self._first,
                )  # fmt: skip
                b.cl.enqueue_copy(b.queue, peaks, highest)
            counts = [np.empty((len(blocks), LEVELS), np.uint32) for _ in sets]
            for out, counter in zip(counts, counters, strict=True):
                b.cl.enqueue_copy(b.queue, out, counter)
            ceiling = self._ceiling(designs, len(blocks), per_dn)
        inside, outside, *sampled = (out.astype(np.int64) for out in counts)
        if not sampled:  # the whole image was counted, zones included
            outside -= inside
            sampled = [np.zeros_like(inside)]
        return Levels(inside, outside, sampled[0], peaks.max(axis=2).astype(np.int64), ceiling)

    def _ceiling(self, designs: Any, count: int, per_dn: np.float32) -> NDArray[np.int64]:
        """Return the level that no pixel of the strata is above."""
        if self._sample is None:
            return np.zeros(count, np.int64)
        b = self._backend
        highest = np.empty((count, self._region_vectors * b.widths["sweep.cl"]), np.float32)
        buffer = b.empty(highest.nbytes)
        b.kernel("sweep.cl", "ceilings")(
            b.queue, (count, self._region_vectors), None, buffer, *self._regions, designs, per_dn
        )
        b.cl.enqueue_copy(b.queue, highest, buffer)
        ceiling = np.ceil(highest.max(axis=1) + _ROUNDING).astype(np.int64)
        bounded: NDArray[np.int64] = np.clip(ceiling, 1, LEVELS - 1)
        return bounded

    def _whole(self) -> Iterator[_PixelSet]:
        """Yield the whole light map, tile by tile; what pads a row sees no light."""
        for tile, _ in self._map.bands():
            size = tile.rows * self._map.stride
            yield _PixelSet(tile.light, tile.footprint, tile.irradiance, size)

    def _enqueue(
        self, counter: Any, pixels: _PixelSet, designs: Any, count: int, per_dn: np.float32
    ) -> None:
        b = self._backend
        stretches = -(-pixels.count // _STRETCH)
        size, group = ((count, stretches), (1, 1))
        if b.widths["sweep.cl"] == 1:
            size, group = ((count, stretches * _GROUP), (1, _GROUP))
        if stretches:
            b.kernel("sweep.cl", "count_levels")(
                b.queue, size, group, counter, pixels.light, pixels.footprint, pixels.irradiance,
                designs, per_dn, np.uint32(pixels.count), np.uint32(_STRETCH),
            )  # fmt: skip

    def _gathered(self, pixels: Pixels) -> _PixelSet:
        """Put pixels of the light map, by flat index into the image, side by side."""
        b, columns = self._backend, self._map.station.shape[1]
        parts = [b.empty(max(4 * len(pixels), 4)) for _ in range(3)]
        for tile, rows in self._map.bands():
            row, column = np.divmod(pixels.astype(np.int64), columns)
            here = (row >= rows.start) & (row < rows.stop) & (pixels != _NO_PIXEL)
            at = np.where(here, (row - rows.start) * self._map.stride + column, _NO_PIXEL)
            if len(pixels):
                b.kernel("sweep.cl", "gather_pixels")(
                    b.queue, (len(pixels),), None, *parts,
                    tile.light, tile.footprint, tile.irradiance, b.constant(at.astype(np.uint32)),
                    np.int32(rows.start == 0),
                )  # fmt: skip
        return _PixelSet(parts[0], parts[1], parts[2], len(pixels))


def _padded(pixels: Pixels, width: int) -> Pixels:
    """Return pixels with as many of none behind them as make whole vectors."""
    return np.pad(pixels, (0, -len(pixels) % width), constant_values=_NO_PIXEL)


def _whole_vectors(zones: Zones, width: int) -> tuple[NDArray[np.int64], Pixels]:
    """Return where zones begin and their pixels, each zone padded to whole vectors."""
    parts = [
        _padded(zones.pixels[a:b], width)
        for a, b in zip(zones.first[:-1], zones.first[1:], strict=True)
    ]
    ends = np.cumsum([0, *map(len, parts)])
    return ends, np.concatenate([np.empty(0, np.uint32), *parts])
