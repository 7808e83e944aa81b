"""Random populations become defects: the same seed gives the same part everywhere."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from functools import cached_property
from typing import Any

import numpy as np
from numpy.typing import NDArray

from gpuspec.errors import StationError
from gpuspec.part.spans import pixels_of
from gpuspec.station.defects import (
    Defect,
    Distribution,
    Patch,
    Population,
    Scratch,
    ScratchPopulation,
    Spot,
)
from gpuspec.station.station import Station

Array = NDArray[np.float64]
Owners = NDArray[np.int64]
Progress = Callable[[str], None]

MANY = 10_000
"""Defects from which on it is told how many are placed."""

_COUNT_MAX = 1_000_000
_IDLE_ROUNDS = 30
_TRIALS = 100
# Equal disks dropped at random on a plane without overlap never cover more (Feder's jamming limit).
_JAMMING = 0.547
_PAIRS_ALL = 200_000  # of disks one above the other, all looked at in 4 ms; a tree's import is slow
_TOGETHER = 1024  # of disks, not worth a search of their own by size
_FEW = 100  # so few may be large beside the part and cover more


def place(station: Station, progress: Progress | None = None) -> tuple[Defect, ...]:
    """Return the explicit defects and those of every population.

    The time is about proportional to the number: 10 to 20 s for a million dents.

    Zones of a population stay wholly on the part and clear of every other dent, bump and scratch,
    so that each defect can be counted; candidates that touch are drawn again.

    Parameters
    ----------
    station : Station
    progress : callable, optional
        Told how many are placed, where there are many.

    Raises
    ------
    StationError
        If a population cannot fit.

    Examples
    --------
    >>> from gpuspec.part.placement import place
    >>> defects = place(gpuspec.example("trim"))
    >>> len(defects), defects[0].kind, round(defects[0].diameter_mm, 2)
    (36, 'dent', 0.8)
    """
    placed: list[Defect] = list(station.defects)
    taken = _Chains.of(placed).by_size()
    tell = progress or (lambda _: None)
    for number, population in enumerate(station.populations, 1):
        placed += _placed(population, number, station, taken, tell)
    return tuple(placed)


def asked_for(station: Station) -> int:
    """Return how many defects a station has, those of its populations included."""
    area = station.part.length_mm * station.part.width_mm
    return len(station.defects) + sum(_count(p, area) for p in station.populations)


def _count(population: Population, area_mm2: float) -> int:
    return population.count or round((population.density_per_cm2 or 0) * area_mm2 / 100)


def draw(distribution: Distribution, uniform: Array) -> Array:
    """Map uniform numbers in [0, 1) to a distribution by its quantile function.

    Parameters
    ----------
    distribution : Distribution
    uniform : ndarray of float64
        In [0, 1).

    Returns
    -------
    ndarray of float64, of the same shape
        In the distribution's unit.
    """
    low, high = distribution.low, distribution.high
    if distribution.median is None or distribution.spread is None:
        return low + (high - low) * uniform
    from scipy.special import ndtr, ndtri  # slow to import

    spread = np.log(distribution.spread)
    below, above = ndtr(np.log(np.array([low, high]) / distribution.median) / spread)
    z = ndtri(below + (above - below) * uniform)
    drawn: Array = np.clip(distribution.median * np.exp(spread * z), low, high)
    return drawn


def _placed(
    population: Population,
    number: int,
    station: Station,
    taken: list[_Chains],
    tell: Progress,
) -> list[Defect]:
    """Return a population's defects; their zones are added to those taken before."""
    length, width = station.part.length_mm, station.part.width_mm
    name = f"{station.file}: populations[{number}]"
    count = _count(population, length * width)
    if count > _COUNT_MAX:
        raise StationError(
            f"{name}.density_per_cm2 = {population.density_per_cm2:g} asks for {count:,} defects; "
            f"at most {_COUNT_MAX:,} are allowed."
        )
    # Only raw uniform numbers are drawn: their stream is the one numpy promises to keep.
    random = np.random.Generator(np.random.PCG64([population.seed, number]))
    depth = draw(population.depth_um, random.random(count))
    extent, vertices, bend = np.zeros(count), 1, 0.0
    if isinstance(population, ScratchPopulation):
        size = draw(population.width_mm, random.random(count))
        extent = draw(population.length_mm, random.random(count))
        vertices, bend = population.vertices, population.bend_rad
    else:
        size = draw(population.diameter_mm, random.random(count))
    # Zones with half the spacing around them are as far from touching as the zones from spacing.
    spaced = size + population.spacing_mm
    area = (np.pi / 4 * spaced**2 + spaced * extent).sum()
    room = (length + population.spacing_mm) * (width + population.spacing_mm)
    room *= 1 if count <= _FEW else _JAMMING
    # The first of two that touch stays: among many small ones a large one would find no place.
    largest_first = np.argsort(-(size * (size + extent)), kind="stable")
    points = np.zeros((count, vertices, 2))
    done = np.zeros(count, bool)
    idle = 0
    while not done.all() and area < room and idle < _IDLE_ROUNDS:
        missing = largest_first[~done[largest_first]]
        if idle:  # those left are hard to place: many trials at once
            missing = np.tile(missing, 1 + _TRIALS // len(missing))
        drawn, fits = _drawn(
            extent[missing], size[missing], vertices, bend, random, np.array([length, width]) / 2
        )
        trial, drawn = missing[fits], drawn[fits]
        fresh = _Chains.along(drawn, size[trial] / 2)
        clear = fresh.clear_of(taken, population.spacing_mm)
        settled, first = np.unique(trial[clear], return_index=True)
        points[settled] = drawn[clear][first]
        done[settled] = True
        if count >= MANY:
            tell(f"placing defects: {done.sum():,} of {count:,} of populations[{number}]")
        taken += _Chains.along(points[settled], size[settled] / 2).by_size()
        idle = 0 if len(settled) else idle + 1
    if not done.all():
        raise StationError(
            f"{name}: {count:,} defects of kind {population.kind} do not fit on the part of "
            f"{length:g} x {width:g} mm without touching; ask for fewer or smaller ones, or less "
            f"spacing_mm."
        )
    defects: list[Defect] = [
        Scratch(
            kind="scratch",
            points_mm=tuple((x, y) for x, y in points[i].tolist()),
            width_mm=float(size[i]),
            depth_um=float(depth[i]),
        )
        if population.kind == "scratch"
        else Spot(
            kind=population.kind,
            x_mm=float(points[i, 0, 0]),
            y_mm=float(points[i, 0, 1]),
            diameter_mm=float(size[i]),
            depth_um=float(depth[i]),
        )
        for i in range(count)
    ]
    return defects


def _drawn(
    extent: Array, size: Array, vertices: int, bend: float, random: np.random.Generator, half: Array
) -> tuple[Array, NDArray[np.bool_]]:
    """Centre lines (n, vertices, 2) at random places and directions, and whether they fit."""
    count = len(size)
    points = np.zeros((count, vertices, 2))
    if vertices > 1:
        turns = bend * (2 * random.random((count, vertices - 1)) - 1)
        turns[:, 0] = 2 * np.pi * random.random(count)
        heading = np.cumsum(turns, axis=1)
        steps = np.stack([np.cos(heading), np.sin(heading)], axis=2)
        points[:, 1:] = np.cumsum(steps * (extent / (vertices - 1))[:, None, None], axis=1)
        points -= (points.min(axis=1, keepdims=True) + points.max(axis=1, keepdims=True)) / 2
    room = half - np.abs(points).max(axis=1) - size[:, None] / 2
    points += ((2 * random.random((count, 2)) - 1) * room)[:, None]
    return points, (room >= 0).all(axis=1)


@dataclass(frozen=True)
class _Chains:
    """Zones as chains of disks, to find which touch: centre (n, 2), radius and owner (n,)."""

    centre: Array
    radius: Array
    owner: NDArray[np.int64]

    @classmethod
    def along(cls, points: Array, radius: Array) -> _Chains:
        """Chains along centre lines (n, vertices, 2), disks at most a radius apart.

        The disks are so much larger than the zone is wide that they cover it whole.
        """
        count, vertices = points.shape[:2]
        start = points[:, : max(vertices - 1, 1)].reshape(-1, 2)
        course = points[:, min(1, vertices - 1) :].reshape(-1, 2) - start
        owner = np.repeat(np.arange(count), max(vertices - 1, 1))
        length = np.hypot(*course.T)
        steps = np.ceil(length / radius[owner]).astype(np.int64)
        cover = np.hypot(radius[owner], length / np.maximum(steps, 1) / 2)
        piece = np.repeat(np.arange(len(owner)), steps + 1)
        nth = np.arange(len(piece)) - np.repeat(np.cumsum(steps + 1) - steps - 1, steps + 1)
        share = nth / np.maximum(steps[piece], 1)
        centre = start[piece] + course[piece] * share[:, None]
        return cls(centre, cover[piece], owner[piece])

    @classmethod
    def of(cls, defects: list[Defect]) -> _Chains:
        """Chains of defects already placed."""
        chains = cls(np.zeros((0, 2)), np.zeros(0), np.zeros(0, np.int64))
        for defect in defects:
            if isinstance(defect, Scratch):
                line, size = np.array([defect.points_mm]), defect.width_mm
            elif not isinstance(defect, Patch):
                line, size = np.array([[[defect.x_mm, defect.y_mm]]]), defect.diameter_mm
            else:
                continue
            chains = chains.with_(cls.along(line, np.array([size / 2])))
        return chains

    def with_(self, other: _Chains) -> _Chains:
        """Both together; owners of the other are not kept apart."""
        return _Chains(
            np.concatenate([self.centre, other.centre]),
            np.concatenate([self.radius, other.radius]),
            np.concatenate([self.owner, other.owner]),
        )

    def by_size(self) -> list[_Chains]:
        """Return the disks apart by size, each up to twice as large as the one before.

        Among small disks alone the search for neighbours need not reach as far as a large one. Few
        disks stay together.
        """
        if len(self.radius) <= _TOGETHER:
            return [self]
        octave = np.floor(np.log2(self.radius))
        return [
            _Chains(self.centre[of], self.radius[of], self.owner[of])
            for of in (octave == size for size in np.unique(octave))
        ]

    @cached_property
    def tree(self) -> Any:
        """Their centres, to be searched."""
        from scipy.spatial import cKDTree  # slow to import

        return cKDTree(self.centre)

    def touching(self, other: _Chains, spacing: float) -> tuple[Owners, Owners]:
        """Owners here and there whose disks touch, or are nearer than the spacing."""
        reach = self.radius.max(initial=0) + other.radius.max(initial=0) + spacing
        order = np.argsort(other.centre[:, 0])
        across = other.centre[order, 0]
        low = np.searchsorted(across, self.centre[:, 0] - reach)
        count = np.searchsorted(across, self.centre[:, 0] + reach, "right") - low
        if count.sum() <= _PAIRS_ALL:
            here, there = np.repeat(np.arange(len(count)), count), order[pixels_of(low, count)]
            away = np.sqrt(((self.centre[here] - other.centre[there]) ** 2).sum(axis=1))
        else:
            pairs = self.tree.sparse_distance_matrix(other.tree, reach, output_type="ndarray")
            here, there, away = pairs["i"], pairs["j"], pairs["v"]
        touch = away < self.radius[here] + other.radius[there] + spacing
        return self.owner[here[touch]], other.owner[there[touch]]

    def clear_of(self, taken: list[_Chains], spacing: float) -> NDArray[np.bool_]:
        """Owners that touch neither a taken zone nor one of their own of lower number."""
        clear = np.ones(self.owner[-1] + 1 if len(self.owner) else 0, bool)
        for own in self.by_size():
            for other in taken:
                clear[own.touching(other, spacing)[0]] = False
        left = clear[self.owner]
        sizes = _Chains(self.centre[left], self.radius[left], self.owner[left]).by_size()
        found = []
        for nth, own in enumerate(sizes):
            for other in sizes[nth:]:
                here, there = own.touching(other, spacing)
                pair = np.stack([np.minimum(here, there), np.maximum(here, there)], axis=1)
                found.append(np.unique(pair[here != there], axis=0))
        pairs = np.unique(np.concatenate([*found, np.zeros((0, 2), np.int64)]), axis=0)
        for a, b in pairs.tolist():
            if clear[a]:
                clear[b] = False
        return clear
