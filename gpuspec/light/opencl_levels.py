"""Levels on an OpenCL device: `kernels/sweep.cl` on a traced part."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Iterator, Sequence
from dataclasses import dataclass, replace
from functools import partial
from typing import Any

import numpy as np
from numpy.typing import NDArray

from gpuspec.light.constants import LEVELS, NO_PIXEL
from gpuspec.light.float64_noise import Excess
from gpuspec.light.levels import Levels, Pixels, Sample, Zones, levels_of, levels_per_dn
from gpuspec.light.light_map import BLIND, PLANES, in_closed_form
from gpuspec.light.records import design_block
from gpuspec.station.sections import Sensor
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
_MARGIN = 1.1  # of a bound of the variance, for what the closed form is off


@dataclass
class _PixelSet:
    """Pixels of a light map side by side on the device, a whole number of vectors.

    Attributes
    ----------
    planes : tuple of Buffer
        Their entries.
    first : int
        Place of the first of them.
    count : int
    pixels : callable
        Returns the flat indices into the image of all places up to their last, NO_PIXEL for what
        is none.
    zones : ndarray of int64, shape (defects + 1,), or None
        Places where each defect's pixels begin, and the end; None: they belong to none.
    normals : tuple of Buffer
        Their normal numbers, drawn when first asked for,
    drawn : tuple
        and for which noise.
    """

    planes: tuple[Any, ...]
    first: int
    count: int
    pixels: Callable[[], Pixels]
    zones: NDArray[np.int64] | None = None
    normals: tuple[Any, ...] = ()
    drawn: tuple[Any, ...] = ()


def device_noise(sensor: Sensor, device: Any) -> tuple[Any, ...]:
    """Put the table of a sensor's noise on a device; without noise there is none.

    Parameters
    ----------
    sensor : Sensor
    device : OpenCLDevice

    Returns
    -------
    entries : Buffer
        Its cells.
    last : float32
        Number of the last.
    excess, variance : float32
        Bounds, see `highest_draw` in `kernels/noise.h`.
    """
    if not sensor.noise:
        return device.constant(np.zeros(4, np.float32)), *np.zeros(3, np.float32)
    table = Excess.of(sensor)
    bounds = len(table.cells) - 1, table.mean_dn, table.variance_dn2 * _MARGIN
    return device.constant(table.cells.astype(np.float32)), *np.array(bounds, np.float32)


Noise = tuple[Any, ...]
"""A sensor, and what `device_noise` returns of it."""


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
        self._kept: _PixelSet | None = None
        self._regions: tuple[Any, ...] = ()
        width = self._backend.widths["sweep.cl"]
        with self._backend.failures():
            ends, places = _whole_vectors(zones, width)
            inside = self._gathered(places)
            # Each set is counted by itself, and their counts are added; None: every pixel.
            self._inside = [replace(inside, zones=ends + inside.first)]
            self._guard = [self._gathered(zones.guard)] if len(zones.guard) else []
            self._near: list[_PixelSet] | None = None
            self._chosen: list[_PixelSet] = []
            if sample is not None:
                self._near, self._chosen = (
                    [self._gathered(pixels)] for pixels in (sample.near, sample.chosen)
                )
            if sample is not None and len(sample.chosen):
                # They hold for every light coordinate; that of their planes is 0.
                bounds = np.zeros_like(sample.wide_mm), *sample.bounds
                self._regions = tuple(
                    self._backend.constant(np.pad(bound, (0, -len(bound) % width), mode="edge"))
                    for bound in bounds
                )
                self._region_vectors = -(-len(sample.wide_mm) // width)

    def count(self, stations: Sequence[Station]) -> Levels:
        """See :meth:`gpuspec.light.levels.LevelCounter.count`."""
        found = Levels.empty(len(stations), len(self._zones.sizes))
        alike: dict[tuple[Any, ...], list[int]] = {}
        for i, station in enumerate(stations):
            if in_closed_form(station):
                alike.setdefault(_shared(station.sensor), []).append(i)
                continue
            image = self._map.aspect(self._map.under(station))
            counted = levels_of(image, self._zones, station.sensor.full_scale_dn)
            found.put(np.array([i]), counted)
        zones = (np.diff(s.zones).max(initial=0) for s in self._inside if s.zones is not None)
        whole = max(_STRETCH, *zones)
        at_once = min(max(_AT_ONCE // whole, 1), _DESIGNS_MAX)
        for same in alike.values():
            sensor = stations[same[0]].sensor
            for some in np.split(np.array(same), range(at_once, len(same), at_once)):
                blocks = np.stack([design_block(stations[i]) for i in some])
                found.put(some, self._counted(blocks, levels_per_dn(sensor.full_scale_dn), sensor))
        return found

    def _counted(self, blocks: NDArray[np.float32], per_dn: np.float32, sensor: Sensor) -> Levels:
        with self._backend.failures():
            designs, count = self._backend.constant(blocks), len(blocks)
            noise = sensor, *device_noise(sensor, self._backend)
            outside = self._whole() if self._near is None else self._near
            counts = [
                self._counts(sets, noise, designs, count, per_dn)
                for sets in (self._inside, outside, self._chosen, self._guard)
            ]
            peaks = [self._peaks(part, noise, designs, count, per_dn) for part in self._inside]
            regions = self._ceilings(noise, designs, count, per_dn)
            self._backend.queue.finish()
        inside, outer, sampled, guard = (found.astype(np.int64) for found in counts)
        # Of a list the guard band is a set of its own; of the whole image it is counted in it.
        outer += guard if self._near is not None else -inside
        highest = np.max([_highest(found) for found in peaks], axis=0).astype(np.int64)
        return Levels(inside, outer, sampled, highest, self._ceiling(regions, count), guard)

    def _counts(
        self,
        sets: Iterable[_PixelSet],
        noise: Noise,
        designs: Any,
        count: int,
        per_dn: np.float32,
    ) -> NDArray[np.uint32]:
        """Return how often each level comes under each design, when the queue is done."""
        b = self._backend
        counts = np.zeros((count, LEVELS), np.uint32)
        counters = None
        items = 1
        if b.widths["sweep.cl"] == 1:
            items = b.group("sweep.cl", "count_levels", _GROUP)
        for part in sets:
            counters = counters or b.counters(count, LEVELS)
            more = self._noise_of(part, noise, designs)
            stretches = np.full(-(-part.count // _STRETCH), _COST * count * _STRETCH)
            for some in b.launches("count_levels", stretches):
                b.start(
                    "sweep.cl", "count_levels", (count, (some.stop - some.start) * items),
                    counters, *part.planes, *more, designs, per_dn,
                    np.uint32(part.first), np.uint32(part.count), np.uint32(_STRETCH),
                    offset=(0, some.start * items), group=(1, items),
                )  # fmt: skip
        if counters:
            b.copy_home(counts, counters, wait=False)
        return counts

    def _noise_of(self, part: _PixelSet, noise: Noise, designs: Any) -> tuple[Any, ...]:
        """Return what a kernel takes of the noise of some pixels, their numbers drawn."""
        b, (sensor, *table, _, _) = self._backend, noise
        if not sensor.noise:
            return part.planes[0], part.planes[0], part.planes[0], *table
        drawn = sensor.seed, _has_pattern(sensor)
        if part.drawn != drawn:
            pattern = _has_pattern(sensor)
            places = part.first + part.count
            part.normals = tuple(b.empty(max(4 * places, 4)) for _ in range(1 + 2 * pattern))
            part.normals = (*part.normals, *part.normals * 2)[:3]
            pixels, columns = b.constant(part.pixels()), np.uint32(self._map.station.shape[1])
            vectors = places // b.widths["sweep.cl"]
            for some in b.launches("pixel_normals", np.full(vectors, _COST)):
                b.start(
                    "sweep.cl", "pixel_normals", (some.stop - some.start,), *part.normals,
                    pixels, columns, designs, np.int32(pattern), offset=(some.start,),
                )  # fmt: skip
            part.drawn = drawn
        return *part.normals, *table

    def _peaks(
        self, part: _PixelSet, noise: Noise, designs: Any, count: int, per_dn: np.float32
    ) -> list[NDArray[np.float32]]:
        """Return the highest level in each zone under each design, see `_by_zone`."""
        assert part.zones is not None
        return self._by_zone(
            "zone_peaks", count, _COST * count * (np.diff(part.zones) + 1),
            *part.planes, *self._noise_of(part, noise, designs), designs, per_dn,
            self._backend.constant(part.zones.astype(np.uint32)),
        )  # fmt: skip

    def _ceilings(
        self, noise: Noise, designs: Any, count: int, per_dn: np.float32
    ) -> list[NDArray[np.float32]] | None:
        """Return what no pixel of each region of the strata is above, see `_by_zone`."""
        if not self._regions:
            return None
        vectors = np.full(self._region_vectors, _COST * count * self._backend.widths["sweep.cl"])
        return self._by_zone(
            "ceilings", count, vectors, *self._regions, *noise[3:], designs, per_dn
        )

    def _ceiling(self, regions: list[NDArray[np.float32]] | None, count: int) -> NDArray[np.int64]:
        """Return the level that no pixel of the strata is above."""
        if regions is None:
            return np.zeros(count, np.int64)
        highest = _highest(regions).max(axis=1)
        bounded: NDArray[np.int64] = np.ceil(highest + _ROUNDING).astype(np.int64)
        return np.clip(bounded, 1, LEVELS - 1)

    def _by_zone(
        self, kernel: str, count: int, work: NDArray[Any], *arguments: Any
    ) -> list[NDArray[np.float32]]:
        """Return what a kernel finds highest under each design, some zones at a time.

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

        Returns
        -------
        list of ndarray, shape (designs, zones, lanes)
            When the queue is done; those of all but the last launch have their highest lane alone.
        """
        b = self._backend
        width = b.widths["sweep.cl"]
        most = max(_BYTES // (4 * count * width), 1)
        buffer = b.empty(4 * count * width * min(most, max(len(work), 1)))
        found = [np.zeros((count, 0, 1), np.float32)]
        for some in b.launches(kernel, work, most):
            zones = some.stop - some.start
            b.start(
                "sweep.cl", kernel, (count, zones), buffer, *arguments,
                offset=(0, some.start),
            )  # fmt: skip
            lanes = np.empty((count, zones, width), np.float32)
            last = some.stop == len(work)
            b.copy_home(lanes, buffer, wait=not last)
            found.append(lanes if last else lanes.max(axis=2, keepdims=True))
        return found

    def _whole(self) -> Iterator[_PixelSet]:
        """Yield the whole light map, tile by tile; what pads a row sees no light."""
        if self._kept:
            yield self._kept
            return
        for tile, rows in self._map.bands():
            pixels = partial(_seen_in, self._map, self._zones, rows)
            part = _PixelSet(tile.planes, 0, tile.rows * self._map.stride, pixels)
            if self._map.tiles == 1:
                self._kept = part
            yield part

    def _gathered(self, pixels: Pixels) -> _PixelSet:
        """Return pixels, by flat index, side by side; those that lie so are left where they are."""
        b, (_, columns) = self._backend, self._map.grid
        count = -(-len(pixels) // b.width) * b.width
        if self._lie_together(pixels, count):
            tile, _ = next(self._map.bands())
            first = int(pixels[0])
            return _PixelSet(tile.planes, first, count, partial(_first, self._map, first + count))
        pixels = np.pad(pixels, (0, count - len(pixels)), constant_values=NO_PIXEL)
        planes = tuple(b.empty(max(4 * len(pixels), 4)) for _ in range(PLANES))
        for tile, rows in self._map.bands() if len(pixels) else ():
            row, column = np.divmod(pixels.astype(np.int64), columns)
            here = (row >= rows.start) & (row < rows.stop) & (pixels != NO_PIXEL)
            at = np.where(here, (row - rows.start) * self._map.stride + column, NO_PIXEL)
            chosen = b.constant(at.astype(np.uint32))
            for plane, of, blank in zip(planes, tile.planes, BLIND, strict=True):
                b.start(
                    "sweep.cl", "gather_pixels", (len(pixels),), plane, of, chosen,
                    np.int32(rows.start == 0), np.float32(blank),
                )  # fmt: skip
        return _PixelSet(planes, 0, len(pixels), partial(_numbers, self._map, pixels))

    def _lie_together(self, pixels: Pixels, count: int) -> bool:
        """Return whether pixels of a list are neighbours, filled up to whole vectors."""
        listed, (_, columns) = self._map.pixels, self._map.grid
        if listed is None or self._map.tiles > 1 or self._map.stride != columns or not count:
            return False
        first, end = int(pixels[0]), int(pixels[0]) + len(pixels)
        together = not first % self._backend.width and int(pixels[-1]) == end - 1
        filling = listed[end : first + count]
        return bool(
            together and (np.diff(pixels.view(np.int32)) == 1).all() and (filling == NO_PIXEL).all()
        )


# What a set of pixels remembers holds no counter, which holds the set: light maps that nobody wants
# would stay on the device until Python looks for circles.


def _seen_in(light_map: Any, zones: Zones, rows: slice) -> Pixels:
    """Return the flat indices into the image of a tile's pixels; of none beside the part."""
    valid, columns = zones.valid.ravel(), light_map.grid[1]
    places = np.arange(rows.start, rows.stop)[:, None] * columns + np.arange(columns)
    seen = places < len(valid)
    seen[seen] = valid[places[seen]]
    found = np.full((len(places), light_map.stride), NO_PIXEL, np.uint32)
    found[:, :columns] = np.where(seen, places, NO_PIXEL)
    return _numbers(light_map, found.ravel())


def _first(light_map: Any, count: int) -> Pixels:
    """Return the flat indices into the image of a light map's first places."""
    return _numbers(light_map, np.arange(count, dtype=np.uint32))


def _numbers(light_map: Any, places: Pixels) -> Pixels:
    """Return the flat indices into the image of places in a light map: it may be a list."""
    listed = light_map.pixels
    if listed is None:
        return places
    return np.append(listed, np.uint32(NO_PIXEL))[np.minimum(places, len(listed))]


def _shared(sensor: Sensor) -> tuple[Any, ...]:
    """Return what designs have in common that are counted together."""
    if not sensor.noise:
        return (sensor.bit_depth,)
    noise = sensor.saturation_e, sensor.read_noise_e, sensor.black_level_dn
    return (sensor.bit_depth, *noise, sensor.seed, _has_pattern(sensor))


def _has_pattern(sensor: Sensor) -> bool:
    """Whether pixels differ in what they make of one signal."""
    return sensor.prnu > 0 or sensor.dsnu_e > 0


def _highest(found: list[NDArray[np.float32]]) -> NDArray[np.float32]:
    """Return the highest of the lanes, of all launches, shape (designs, zones)."""
    return np.concatenate([lanes.max(axis=2, initial=-np.inf) for lanes in found], axis=1)


def _whole_vectors(zones: Zones, width: int) -> tuple[NDArray[np.int64], Pixels]:
    """Return where zones begin and their pixels, each zone padded to whole vectors."""
    if not (zones.first % width).any():
        return zones.first, zones.pixels
    sizes = zones.sizes
    ends = np.concatenate([[0], np.cumsum(-(-sizes // width) * width)])
    padded = np.full(ends[-1], NO_PIXEL, np.uint32)
    padded[np.arange(sizes.sum()) + np.repeat(ends[:-1] - zones.first[:-1], sizes)] = zones.pixels
    return ends, padded
