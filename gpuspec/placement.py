"""Random populations become defects: the same seed gives the same part everywhere."""

from __future__ import annotations

import itertools

import numpy as np
from numpy.typing import NDArray
from scipy.spatial import cKDTree
from scipy.special import ndtr, ndtri

from gpuspec.defects import (
    Defect,
    Distribution,
    Patch,
    Population,
    Scratch,
    ScratchPopulation,
    Spot,
)
from gpuspec.errors import StationError
from gpuspec.station import Station

_ROUNDS = 200
_COUNT_MAX = 1_000_000


def place(station: Station) -> tuple[Defect, ...]:
    """Return the explicit defects and those of every population.

    Zones of a population stay wholly on the part and clear of every other zone, so that each
    defect can be counted; candidates that touch are drawn again.

    Raises
    ------
    StationError
        If a population cannot fit.
    """
    placed: list[Defect] = list(station.defects)
    for number, population in enumerate(station.populations, 1):
        placed += _placed(population, number, station, placed)
    return tuple(placed)


def draw(distribution: Distribution, uniform: NDArray[np.float64]) -> NDArray[np.float64]:
    """Map uniform numbers in [0, 1) to a distribution by its quantile function."""
    low, high = distribution.low, distribution.high
    if distribution.median is None:
        return low + (high - low) * uniform
    spread = np.log(distribution.spread)
    below, above = ndtr(np.log(np.array([low, high]) / distribution.median) / spread)
    z = ndtri(below + (above - below) * uniform)
    return np.clip(distribution.median * np.exp(spread * z), low, high)


def _count(population: Population, station: Station) -> int:
    if population.count is not None:
        return population.count
    assert population.density_per_cm2 is not None
    area_cm2 = station.part.length_mm * station.part.width_mm / 100
    return round(population.density_per_cm2 * area_cm2)


def _placed(
    population: Population, number: int, station: Station, placed: list[Defect]
) -> list[Defect]:
    count = _count(population, station)
    name = f"{station.file}: populations[{number}]"
    if count > _COUNT_MAX:
        raise StationError(
            f"{name}.density_per_cm2 = {population.density_per_cm2:g} asks for {count:,} defects; "
            f"at most {_COUNT_MAX:,} are allowed."
        )
    # Only raw uniform numbers are drawn: their stream is the one numpy promises to keep.
    random = np.random.Generator(np.random.PCG64([population.seed, number]))
    wanted = _candidates(population, count, random, station)
    result: dict[int, Defect] = {}
    fixed = _Disks.of(placed)
    for _ in range(_ROUNDS):
        missing = [i for i in range(count) if i not in result]
        if not missing:
            break
        for i in missing:
            candidate = wanted(i)
            if candidate is not None:
                result[i] = candidate
        clashes = _Disks.of([result[i] for i in sorted(result)]).clashes(
            fixed, population.spacing_mm
        )
        order = sorted(result)
        for clash in clashes:
            del result[order[clash]]
    if len(result) < count:
        raise StationError(
            f"{name}: only {len(result):,} of {count:,} defects of kind {population.kind} fit on "
            f"the part of {station.part.length_mm:g} x {station.part.width_mm:g} mm without "
            f"touching; ask for fewer or smaller ones, or less spacing_mm."
        )
    return [result[i] for i in range(count)]


def _candidates(population, count, random, station):  # type: ignore[no-untyped-def]
    """Return a function giving defect i at a new place; sizes are drawn once."""
    depth = draw(population.depth_um, random.random(count))
    half = np.array([station.part.length_mm, station.part.width_mm]) / 2
    if isinstance(population, ScratchPopulation):
        width = draw(population.width_mm, random.random(count))
        length = draw(population.length_mm, random.random(count))

        def scratch(i: int) -> Defect | None:
            points = _centre_line(length[i], population.vertices, population.bend_rad, random)
            reach = np.abs(points).max(axis=0) + width[i] / 2
            room = half - reach
            place = random.random(2)
            if np.any(room < 0):
                return None
            points = points + (2 * place - 1) * room
            return Scratch(
                kind="scratch",
                points_mm=tuple((float(x), float(y)) for x, y in points),
                width_mm=float(width[i]),
                depth_um=float(depth[i]),
            )

        return scratch
    diameter = draw(population.diameter_mm, random.random(count))

    def spot(i: int) -> Defect | None:
        x, y = (2 * random.random(2) - 1) * (half - diameter[i] / 2)
        if diameter[i] / 2 > half.min():
            return None
        return Spot(
            kind=population.kind,
            x_mm=float(x),
            y_mm=float(y),
            diameter_mm=float(diameter[i]),
            depth_um=float(depth[i]),
        )

    return spot


def _centre_line(
    length: float, vertices: int, bend: float, random: np.random.Generator
) -> NDArray[np.float64]:
    """Polyline of equal pieces, centred on its box, in a random direction."""
    turns = bend * (2 * random.random(vertices - 1) - 1)
    turns[0] = 2 * np.pi * random.random()
    heading = np.cumsum(turns)
    steps = length / (vertices - 1) * np.stack([np.cos(heading), np.sin(heading)], axis=1)
    points = np.concatenate([np.zeros((1, 2)), np.cumsum(steps, axis=0)])
    centred: NDArray[np.float64] = points - (points.min(axis=0) + points.max(axis=0)) / 2
    return centred


class _Disks:
    """Zones as chains of disks, to find which touch."""

    def __init__(
        self, centre: NDArray[np.float64], radius: NDArray[np.float64], owner: NDArray[np.int64]
    ) -> None:
        self.centre, self.radius, self.owner = centre, radius, owner

    @classmethod
    def of(cls, defects: list[Defect]) -> _Disks:
        centre: list[NDArray[np.float64]] = [np.zeros((0, 2))]
        radius: list[float] = []
        owner: list[int] = []
        for index, defect in enumerate(defects):
            if isinstance(defect, Patch):
                continue
            if isinstance(defect, Scratch):
                r = defect.width_mm / 2
                chain = []
                for a, b in itertools.pairwise(np.array(defect.points_mm)):
                    n = max(int(np.ceil(np.hypot(*(b - a)) / r)), 1)
                    chain.append(a + (b - a) * np.linspace(0, 1, n + 1)[:, None])
                points = np.concatenate(chain)
            else:
                r, points = defect.diameter_mm / 2, np.array([[defect.x_mm, defect.y_mm]])
            centre.append(points)
            radius += [r] * len(points)
            owner += [index] * len(points)
        return cls(np.concatenate(centre), np.array(radius), np.array(owner, np.int64))

    def clashes(self, fixed: _Disks, spacing: float) -> set[int]:
        """Owners that must go so that no two zones, nor a zone and a fixed one, touch."""
        if not len(self.radius):
            return set()
        reach = 2 * max(self.radius.max(), fixed.radius.max(initial=0)) + spacing
        tree = cKDTree(self.centre)
        gone: set[int] = set()
        if len(fixed.radius):
            pairs = cKDTree(fixed.centre).sparse_distance_matrix(tree, reach, output_type="ndarray")
            touch = pairs["v"] < fixed.radius[pairs["i"]] + self.radius[pairs["j"]] + spacing
            gone |= set(self.owner[pairs["j"][touch]].tolist())
        pairs = tree.sparse_distance_matrix(tree, reach, output_type="ndarray")
        a, b = self.owner[pairs["i"]], self.owner[pairs["j"]]
        touch = pairs["v"] < self.radius[pairs["i"]] + self.radius[pairs["j"]] + spacing
        for first, second in np.unique(np.stack([a, b], axis=1)[touch & (a < b)], axis=0).tolist():
            if first not in gone:
                gone.add(second)
        return gone
