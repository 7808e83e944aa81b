"""Which pixels of a part are traced to screen it: found from where its defects are, no image."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np
from numpy.typing import NDArray

from gpuspec.arrays import BESIDE, Lost, Mask
from gpuspec.light.constants import AT_LOSS, NO_PIXEL
from gpuspec.light.levels import Pixels, Sample, Zones
from gpuspec.light.light_map import LightMap
from gpuspec.light.refined_levels import Roles
from gpuspec.light.refinement import ACROSS, Neighbourhood, by_cut
from gpuspec.part.crossings import Crossings
from gpuspec.part.edges import cut_at_border
from gpuspec.part.grooves import Grooves, by_block
from gpuspec.part.guard import REACH_PX, near
from gpuspec.part.relief import Relief
from gpuspec.part.truth import Truth
from gpuspec.part.view import surface_points
from gpuspec.station.station import Station

Ints = NDArray[np.int64]

WHOLE = 16
"""Pixels of the widest vector, of which each set in a list is a whole number."""

_EDGE = 1e-3  # of a pixel: nearer to the part's edge, float32 decides which side it is on


@dataclass(frozen=True)
class Refinable:
    """The pixels of a list that have sub-rays where they need them: of zones, near, or all.

    Attributes
    ----------
    around : Neighbourhood
        Of these pixels.
    own : ndarray of int64
        Their places in the list, in its order.
    order : ndarray of intp
        Of them, block by block, see :func:`gpuspec.part.grooves.by_block`.
    known : ndarray of int64
        Places of the neighbourhood's pixels, likewise.
    end : int
        From which place on there are but neighbours.
    crossings : Crossings
        Of these pixels, in the order of `own`.
    cut : ndarray of bool
        Which of them the part's edge cuts at the border of the image.
    """

    around: Neighbourhood
    own: Ints
    order: NDArray[np.intp]
    known: Ints
    end: int
    crossings: Crossings
    cut: Mask

    def places(self, light_map: LightMap) -> dict[int, Pixels]:
        """Return the places of the pixels that are refined, by how they are cut.

        Parameters
        ----------
        light_map : LightMap
            Of the list, one footprint per pixel.
        """
        sides = light_map.sides_beside(self.around, self.known)
        sides[self.cut] = AT_LOSS
        order = self.order[sides[self.order] != 1]
        found = by_cut(sides[order], lambda some: self.crossings.at(order[some]))
        return {cut: self.own[order[some]].astype(np.uint32) for cut, some in found.items()}


@dataclass(frozen=True)
class Listing:
    """The pixels that are traced: zone by zone, the guard band, those near, those drawn.

    Attributes
    ----------
    pixels : ndarray of uint32, shape (n,)
        Flat indices into the image; ``NO_PIXEL`` where zones and sets are filled to whole vectors.
    zones : Zones
        By places in the list.
    near, chosen : ndarray of uint32
        Places in the list, see :class:`gpuspec.light.levels.Sample`.
    weight : int
        Pixels that a chosen one stands for.
    refinable : Refinable or None
        Which of them may have sub-rays; None: none has.
    """

    pixels: Pixels
    zones: Zones
    near: Pixels
    chosen: Pixels
    weight: int
    refinable: Refinable | None = None

    def sample(self, bounds: tuple[NDArray[np.float32], ...]) -> Sample:
        """Return the sample, what bounds its strata given.

        Parameters
        ----------
        bounds : tuple of three ndarray
            See :class:`gpuspec.light.levels.Sample`.
        """
        return Sample(self.near, self.chosen, self.weight, *bounds)

    @property
    def itself(self) -> Pixels:
        """Flat indices of the pixels that stand for themselves: of zones, around them, and near."""
        end = self.zones.first[-1]
        for places in (self.zones.guard, self.near):
            end = places[-1] + 1 if len(places) else end
        return self.pixels[:end][self._there[:end]]

    def in_view(self, lost: NDArray[np.uint8]) -> Zones:
        """Return the zones' pixels that are on the part.

        Parameters
        ----------
        lost : ndarray of uint8, shape (1, n)
            Why pixels of the list see no light.
        """
        if not lost.any():
            return self._whole_zones
        return self.zones.only((lost != BESIDE) & self._there)

    def losses(self, lost: NDArray[np.uint8]) -> NDArray[np.float64] | None:
        """Return how many pixels of the image are lost for each reason, estimated by the sample.

        Parameters
        ----------
        lost : ndarray of uint8, shape (1, n)
            Why pixels of the list see no light.

        Returns
        -------
        ndarray of float64, or None
            By index into ``LOST``; None if none is lost.
        """
        if not lost.any():
            return None
        stands_for = self._there.astype(np.float64)
        stands_for[self.chosen] *= self.weight
        if self.refinable is not None:  # neighbours are but looked at
            stands_for[self.refinable.end :] = 0
        counts: NDArray[np.float64] = np.bincount(lost[0], stands_for, len(Lost)).astype(float)
        return counts

    @cached_property
    def roles(self) -> Roles:
        """How each place is counted."""
        return Roles.of(self.zones, self.sample((np.zeros(0, np.float32),) * 3))

    @cached_property
    def _there(self) -> NDArray[np.bool_]:
        """Which places of the list are pixels."""
        there: NDArray[np.bool_] = self.pixels != NO_PIXEL
        return there

    @cached_property
    def _whole_zones(self) -> Zones:
        return self.zones.only(self._there)


def listed(
    station: Station,
    relief: Relief,
    truth: Truth,
    strata: int,
    seed: int,
    around: Ints | None = None,
    *,
    everywhere: bool = False,
) -> Listing:
    """List the zones, the pixels near defects, and a sample of all others.

    The others, row by row, are cut into runs of neighbours of one length, a stratum each, and one
    pixel is drawn at random from every run.

    Parameters
    ----------
    station : Station
    relief : Relief
        Of that station.
    truth : Truth
        Likewise.
    strata : int
        Number of runs, about.
    seed : int
        Of the draw.
    around : ndarray of int64, optional
        What :func:`gpuspec.part.guard.near` returns of them; None: it is asked.
    everywhere : bool
        Whether the drawn pixels, too, have sub-rays where they need them: where the light is lost
        at an opening, or past the tunnel's end, neighbours tell of it.
    """
    around = near(station, relief, truth.labels) if around is None else around
    ground = _Ground.of(station, relief)
    known = np.union1d(around, ground.doubtful) if len(ground.doubtful) else around
    rest = _Rest(ground, known)
    # One length for all parts of a geometry, so that their strata can be taken together.
    weight = max(truth.labels.size // strata, 1)
    runs = rest.count // weight
    offset = np.random.default_rng(seed).integers(0, weight, runs)
    chosen = rest.nth(np.arange(runs) * weight + offset)
    left = rest.nth(np.arange(runs * weight, rest.count))
    owner = truth.labels.flat[around]
    beyond = np.setdiff1d(ground.doubtful, around, assume_unique=True)
    others = np.sort(np.concatenate([beyond, left]))
    inside = np.flatnonzero(owner)
    inside = inside[np.argsort(owner[inside], kind="stable")]
    sizes = np.bincount(owner[inside], minlength=len(truth.defects) + 1)[1:]
    listing = _in_order(around[inside], sizes, (around[owner == 0], others, chosen), weight)
    told = station.camera.subsampling == "auto" and min(station.shape) >= ACROSS
    return _refinable(listing, station, relief, everywhere=everywhere) if told else listing


def _in_order(inside: Ints, sizes: Ints, others: Sequence[Ints], weight: int) -> Listing:
    """Lay zones of some sizes, the guard band, what is near and what is drawn one after another."""
    first = np.concatenate([[0], np.cumsum(_filled(sizes))])
    places = np.arange(len(inside)) + np.repeat(first[:-1] - np.cumsum(sizes) + sizes, sizes)
    begin = first[-1] + np.cumsum([0, *(_filled(len(its)) for its in others)])
    pixels = np.full(begin[-1], NO_PIXEL, np.uint32)
    pixels[places] = inside
    where = []
    for at, its in zip(begin, others, strict=False):
        where.append(np.arange(at, at + len(its), dtype=np.uint32))
        pixels[where[-1]] = its
    guard, near, chosen = where
    every = np.arange(first[-1], dtype=np.uint32)
    zones = Zones(every, first, np.ones((1, len(pixels)), np.bool_), guard)
    return Listing(pixels, zones, near, chosen, weight)


def _refinable(listing: Listing, station: Station, relief: Relief, *, everywhere: bool) -> Listing:
    """Return the list with the neighbours of zones and what is near them at its end.

    Of an uneven part, and where it is asked, those drawn have theirs, too.
    """
    every = listing.pixels[listing.pixels != NO_PIXEL]
    chosen = every if station.part.uneven or everywhere else listing.itself
    own = np.sort(chosen).astype(np.int64)
    places = np.flatnonzero(listing.pixels != NO_PIXEL)[: len(own)]
    places = places[np.argsort(listing.pixels[places])]
    around = Neighbourhood(own, station.shape)
    at = np.searchsorted(own, around.pixels)
    among = own[np.minimum(at, len(own) - 1)] == around.pixels if len(own) else at > 0
    more = around.pixels[~among]
    known = np.empty(len(around.pixels), np.int64)
    known[among] = places[at[among]]
    known[~among] = len(listing.pixels) + np.arange(len(more))
    filling = np.full(_filled(len(more)) - len(more), NO_PIXEL, np.uint32)
    pixels = np.concatenate([listing.pixels, more.astype(np.uint32), filling])
    zones = replace(listing.zones, valid=np.ones((1, len(pixels)), np.bool_))
    return replace(
        listing,
        pixels=pixels,
        zones=zones,
        refinable=Refinable(
            around,
            places,
            by_block(own, station.shape),
            known,
            len(listing.pixels),
            Crossings(station, relief, own),
            np.isin(own, cut_at_border(relief.edges, station), assume_unique=True),
        ),
    )


def _filled(count: Ints | int) -> Ints:
    """Return numbers of pixels rounded up to whole vectors."""
    return -(-np.asarray(count) // WHOLE) * WHOLE


def seeing(station: Station) -> tuple[range, range]:
    """Return the rows and columns of the image outside of which no pixel sees the part.

    Parameters
    ----------
    station : Station
    """
    ground = _Ground.of(station, Relief((), Grooves.of(()), ()))
    every = [np.concatenate([ground.beyond, ground.doubtful])]
    rows, columns = np.divmod(every[0], ground.width)
    spans = []
    for span, more in ((ground.rows, rows), (ground.columns, columns)):
        ends = [more.min(), more.max() + 1] if len(more) else [span.start, span.stop]
        spans.append(range(min(span.start, ends[0]), max(span.stop, ends[1])))
    return spans[0], spans[1]


def crowd(relief: Relief, station: Station) -> int:
    """Return how many defects at most reach one block of the image: what is left of each adds up.

    Parameters
    ----------
    relief : Relief
    station : Station
    """
    first, pieces = relief.blocks(station)
    block = np.repeat(np.arange(len(first) - 1), np.diff(first))
    grooves = pieces < len(relief.grooves)
    block, pieces = block[grooves], pieces[grooves]
    both = np.unique(block * (len(relief.defects) + 1) + relief.grooves.owner[pieces])
    return int(np.bincount(both // (len(relief.defects) + 1)).max(initial=0))


@dataclass(frozen=True)
class _Ground:
    """The pixels that see the part: a rectangle of them, and some more beyond it.

    Attributes
    ----------
    rows, columns : range
        Of the rectangle.
    beyond : ndarray of int64
        Flat indices of the others, ascending.
    doubtful : ndarray of int64
        Of those that may or may not see it.
    width : int
        Columns of the image.
    """

    rows: range
    columns: range
    beyond: Ints
    doubtful: Ints
    width: int

    @classmethod
    def of(cls, station: Station, relief: Relief) -> _Ground:
        """Find them in float64."""
        part, p, h = station.part, station.camera.sampling_mm, station.camera.height_mm
        half = np.array([part.width_mm, part.length_mm]) / 2
        low = high = 1.0
        edge, doubt = _EDGE, 1e-6 * half.max()
        if part.surface == "height":
            deep = sum(abs(float(d)) for d in relief.grooves.depth)
            deep += sum(float(np.abs(m.relief_mm).max()) for m in relief.maps)
            low, high = (
                1 - (z + s * deep) / h
                for z, s in zip(part.height_range_mm[::-1], (1, -1), strict=True)
            )
            doubt += deep * half.max() / h
        if station.camera.subsampling == "auto":
            edge = station.camera.reach_px
            outermost = (np.array(station.shape) / 2 - 0.5) * p
            if station.camera.spotted or ((half - doubt) / high < outermost).any():
                # Whoever has a neighbour beside the part has sub-rays. Spread over all that a pixel
                # sees they are not the very footprint that a bound is made of; and of noise, not
                # the same draw to the last bit.
                edge += REACH_PX
        doubt += edge * p
        spans = []
        for edge in ((half - doubt) / high, (half + doubt) / low):
            spans.append([_between(e / p, n) for e, n in zip(edge, station.shape, strict=True)])
        (rows, columns), (wide_rows, wide_columns) = spans
        width = station.shape[1]
        near = [
            (row * width + np.array(columns_)).ravel() if len(columns_) else np.zeros(0, np.int64)
            for row_, columns_ in (
                (range(wide_rows.start, rows.start), wide_columns),
                (rows, range(wide_columns.start, columns.start)),
                (rows, range(columns.stop, wide_columns.stop)),
                (range(rows.stop, wide_rows.stop), wide_columns),
            )
            for row in [np.array(row_, np.int64)[:, None]]
        ]
        band = np.sort(np.concatenate(near))
        x, y = surface_points(station, band % width, band // width)
        inward = np.minimum(half[1] - np.abs(x), half[0] - np.abs(y))
        return cls(rows, columns, band[inward > doubt], band[np.abs(inward) <= doubt], width)


def _between(half: float, size: int) -> range:
    """Return the pixels of a line of `size` with centres within `half` pixels of its middle."""
    first = int(np.clip(np.ceil(size / 2 - half - 0.5), 0, size))
    last = int(np.clip(np.floor(size / 2 + half - 0.5) + 1, first, size))
    return range(first, last)


class _Rest:
    """The pixels that see the part but for some, by their number among them."""

    def __init__(self, ground: _Ground, without: Ints) -> None:
        self._ground = ground
        row, column = np.divmod(without, ground.width)
        row, column = row - ground.rows.start, column - ground.columns.start
        across = len(ground.columns)
        inside = (row >= 0) & (row < len(ground.rows)) & (column >= 0) & (column < across)
        missing = (row * across + column)[inside]
        # Of the kept pixels before each that is left out: how many there are.
        self._kept_before = missing - np.arange(len(missing))
        self._inside = len(ground.rows) * across - len(missing)
        self._beyond = np.setdiff1d(ground.beyond, without, assume_unique=True)
        self.count = self._inside + len(self._beyond)

    def nth(self, number: Ints) -> Ints:
        """Return the flat indices of some of them, given by ascending numbers from 0 on."""
        g = self._ground
        inside = number[number < self._inside]
        place = inside + np.searchsorted(self._kept_before, inside, "right")
        row, column = np.divmod(place, max(len(g.columns), 1))
        found = (row + g.rows.start) * g.width + column + g.columns.start
        return np.concatenate([found, self._beyond[number[len(inside) :] - self._inside]])
