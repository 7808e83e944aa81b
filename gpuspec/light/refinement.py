"""Sub-rays where they matter: which pixels of a light map one footprint does not tell.

A footprint takes the light coordinate l for linear over its pixel. Where it is not, n x n sub-rays,
each with a footprint of its own, leave second differences n^2 times smaller. A second difference d
beside the width w makes the kernel wider by about d^2/(50 w), which counts by full scale over the
period for each mm, and skews it by some d/8: where few images step by more than w, a pixel at the
edge of a stripe is then off by full scale times exposure over images, times d/(8 w). So a sub-ray
may bend by a share of the width (`BEND`) and, where widths are large, of `WIDTH_MM`; neither the
stripes nor the exposure nor the number of images is asked, and one list serves every design. Where
the surface bends within less than a pixel, the light coordinates of its neighbours may not tell,
but their widths do: they are first differences.

A pixel that one straight groove crosses bends in one direction alone: slices along the groove
(`kernels/slices.h`) are a third of its squares.

Of the pixels left at one footprint 1 in 10,000 is off by more than 0.1 of 255 grey levels and none
by more than 0.3, on 36 random stations with 8 to 100 images and exposures up to 8; at a bend of 0.3
it is 5 in 10,000, up to 1.1. Without the bound in mm the error
of those refined is up to three times as large.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from gpuspec.arrays import Mask
from gpuspec.light.constants import AT_LOSS, BLIND_WIDTH_MM
from gpuspec.part.crossings import CREASE, GROOVE
from gpuspec.part.guard import widened
from gpuspec.part.spans import pixels_of
from gpuspec.station.sections import MOST_SIDES, Camera
from gpuspec.station.station import Station

Ints = NDArray[np.int64]

BEND = 0.2
"""Largest second difference of the light coordinate over a sub-ray, in widths of the pixel."""

WIDTH_MM = 1.0
"""Larger widths count as this."""

SIDES = (2, 4, MOST_SIDES)
"""Sub-rays on each side of a refined pixel."""

SLICES = 20
"""In place of the most sub-rays, where one groove alone crosses a pixel. Against 48 x 48 squares
their rms error is half that of 8 x 8 on the demo's part, and 0.4 to 1.0 times it where a pinhole
sees a scratch as wide as 1.2 pixels at 7 to 90 degrees to the rows; of one twice as wide, where
both are below 0.05 grey levels, up to 0.02 more. Fewer squares than 8 x 8 are left: where they are
enough, oblique slices are worse."""

CREASED = 16
"""Sub-rays on a side in place of 4 or more where a scratch bends within a pixel: the light
coordinate jumps there, and a sub-ray is on one side or the other. Of scenes kept back it lowers the
largest error of a pinhole's view from 5.0 grey levels to 1.7; of pixels at bends of scratches 1.2
to 2.5 pixels wide for which 4 x 4 seem enough, that of the rest from 11.8 to 2.7."""

CUTS = (*SIDES, CREASED, -SLICES)
"""How a refined pixel is cut, as `Camera.subsampling` has it: into n x n squares, or -n slices."""

ACROSS = 3
"""Pixels that differences take: an image of fewer across is seen with neighbours beyond it."""

_TOLD = 2  # pixels on either side of an edge of loss that their neighbours tell of it
_BAND = 256  # rows at once, which a processor's cache holds


def bend_of(camera: Camera) -> float:
    """Return the largest second difference over a sub-ray of a camera's pixels, see ``BEND``.

    Sub-rays of a pixel that looks at a spot wider than itself lie that much further apart.

    Parameters
    ----------
    camera : Camera
    """
    return BEND * (camera.sampling_mm / camera.spot_side_mm) ** 2


def further(camera: Camera) -> int:
    """Return by how many pixels more than their neighbours tell spots reach over an edge of loss.

    Parameters
    ----------
    camera : Camera
    """
    return max(camera.beyond_px - _TOLD, 0)


def at_loss_within(sides: NDArray[np.uint8], distance: int) -> NDArray[np.uint8]:
    """Return how pixels are refined that see an edge of loss so many pixels further away, too.

    Parameters
    ----------
    sides : ndarray of uint8, shape (M, N)
        See :func:`sides_needed`.
    distance : int
        Of :func:`further`.
    """
    lossy = sides == AT_LOSS
    if not distance or not lossy.any():
        return sides
    from scipy import ndimage  # slow to import

    near = ndimage.maximum_filter(lossy, 2 * distance + 1, mode="constant")
    return np.where(near, np.uint8(AT_LOSS), sides)


def sides_needed(
    light: NDArray[np.float32], wide: NDArray[np.float32], bend: float = BEND
) -> NDArray[np.uint8]:
    """Return how many sub-rays each pixel needs on each side.

    Parameters
    ----------
    light, wide : ndarray of float32, shape (M, N)
        Light coordinate and the wider of the footprint's boxes with one ray per pixel, mm; 0 and 1
        where light is lost, whose edges are refined the most.
    bend : float
        See :func:`bend_of`.

    Returns
    -------
    ndarray of uint8, shape (M, N)
        1, or one of ``SIDES``; ``AT_LOSS`` where the most are for an edge of loss.

    Examples
    --------
    >>> from gpuspec.light.refinement import sides_needed
    >>> light = np.tile(np.float32([0, 1, 2, 3, 4, 5.5, 8, 12, 16, 20, 24]), (5, 1))
    >>> sides_needed(light, np.full_like(light, 2))[2].tolist()
    [1, 1, 1, 2, 4, 4, 4, 4, 1, 1, 1]
    """
    rows, columns = light.shape
    wide = _told_apart(light, wide)
    found = np.empty(light.shape, np.uint8)
    across = np.zeros(columns, bool)
    across[1:-1] = True
    for first in range(0, rows, _BAND):
        last = min(first + _BAND, rows)
        above, below = max(first - 2, 0), min(last + 2, rows)
        down = np.arange(above, below)
        inner = (down > 0) & (down < rows - 1)
        near = [np.pad(plane[above:below], 1, "edge") for plane in (light, wide)]
        change = _spread(_changes(near[0], near[1], inner, across))
        found[first:last] = _sides(change[first - above : last - above], wide[first:last], bend)
    return found


def with_neighbours(station: Station, pixels: Ints) -> tuple[Station, Ints]:
    """Return a station whose image has neighbours for pixels, and their flat indices there.

    The station itself where its image has them.

    Parameters
    ----------
    station : Station
    pixels : ndarray of int64, shape (n,)
        Flat indices into its image.
    """
    rows, columns = station.shape
    if min(rows, columns) >= ACROSS:
        return station, pixels
    more = ACROSS - 1  # on each side: a bend may lie between two pixels
    wider = station.replace(camera__rows=rows + 2 * more, camera__columns=columns + 2 * more)
    row, column = np.divmod(pixels, columns)
    return wider, (row + more) * wider.shape[1] + column + more


class Neighbourhood:
    """Pixels of an image, and their neighbours, which tell how many sub-rays they need.

    Parameters
    ----------
    own : ndarray of int64, shape (n,)
        Flat indices, ascending, none twice.
    shape : tuple of int
        Rows and columns of the image.

    Attributes
    ----------
    pixels : ndarray of int64, shape (k,)
        They, and all within two pixels of them; likewise.
    near : Beside
        Where the neighbours of all within one pixel of them stand among `pixels`.
    around : Beside
        Where their own neighbours stand among those within one pixel.
    own : ndarray of int64, shape (n,)
        Where they stand among `pixels`.
    """

    def __init__(self, own: Ints, shape: tuple[int, int]) -> None:
        around = widened(own, shape)
        self.pixels = widened(around, shape)
        self.near = Beside.of(around, self.pixels, shape)
        self.around = Beside.of(own, around, shape)
        self.own = self.near.middle[self.around.middle]

    def sides_needed(
        self, light: NDArray[np.float32], wide: NDArray[np.float32], bend: float = BEND
    ) -> NDArray[np.uint8]:
        """Return how many sub-rays the n pixels need on each side, see :func:`sides_needed`.

        Parameters
        ----------
        light, wide : ndarray of float32, shape (k,)
            Of `pixels`, in their order.
        bend : float
            See :func:`bend_of`.
        """
        wide = _told_apart(light, wide)
        near = [np.moveaxis(plane[self.near.places], -1, 0) for plane in (light, wide)]
        change = _changes(near[0], near[1], self.near.down, self.near.across).ravel()
        return _sides(change[self.around.places].max(axis=(0, 1), initial=0), wide[self.own], bend)


def _told_apart(light: NDArray[np.float32], wide: NDArray[np.float32]) -> NDArray[np.float32]:
    """Return widths, or where light is lost one that no neighbour has."""
    blind = (wide == 1) & (light == 0)
    return np.where(blind, np.float32(BLIND_WIDTH_MM), wide) if blind.any() else wide


@dataclass(frozen=True)
class Beside:
    """Where the 3 x 3 around pixels of an image stand among others, all of them among these.

    Attributes
    ----------
    above, middle, below : ndarray of int64, shape (n,)
        Places of the pixels above, of themselves, and of those below, on the border the nearest.
    left, right : ndarray of bool, shape (n,)
        Whether there is one to the left, and to the right: each is next to the pixel itself.
    """

    above: Ints
    middle: Ints
    below: Ints
    left: Mask
    right: Mask

    @classmethod
    def of(cls, pixels: Ints, among: Ints, shape: tuple[int, int]) -> Beside:
        """Look them up.

        Runs of a row are as long among the others: their first pixels alone are looked for.

        Parameters
        ----------
        pixels, among : ndarray of int64
            Flat indices, ascending, none twice.
        shape : tuple of int
            Rows and columns of the image.
        """
        rows, columns = shape
        row, column = np.divmod(pixels, columns)
        begin = np.flatnonzero((np.diff(pixels, prepend=-2) != 1) | (column == 0))
        length = np.diff(begin, append=len(pixels))
        lines = []
        for step in (-1, 0, 1):
            first = np.clip(row[begin] + step, 0, rows - 1) * columns + column[begin]
            lines.append(pixels_of(np.searchsorted(among, first), length))
        return cls(lines[0], lines[1], lines[2], column > 0, column < columns - 1)

    @property
    def places(self) -> Ints:
        """Of the 3 x 3, shape (3, 3, n)."""
        lines = np.stack([self.above, self.middle, self.below])
        return np.stack([lines - self.left, lines, lines + self.right], axis=1)

    @property
    def across(self) -> Mask:
        """Which have neighbours on both sides, shape (n, 1)."""
        return (self.left & self.right)[:, None]

    @property
    def down(self) -> Mask:
        """Which have neighbours above and below, shape (n, 1)."""
        found: Mask = (self.above != self.middle) & (self.below != self.middle)
        return found[:, None]


def counted(refined: Mapping[int, int]) -> dict[str, int]:
    """Return how much was refined as `score.json` has it.

    Parameters
    ----------
    refined : mapping of int to int
        Number of pixels by how they are cut, see ``CUTS``.

    Examples
    --------
    >>> from gpuspec.light.refinement import counted
    >>> counted({2: 100, 8: 7, -20: 1})
    {'pixels': 108, 'sub_rays': 868, '2': 100, '4': 0, '8': 7, '16': 0, 'slices': 1}
    """
    pixels = {cut: refined.get(cut, 0) for cut in CUTS}
    return {
        "pixels": sum(pixels.values()),
        "sub_rays": sum((-cut if cut < 0 else cut**2) * n for cut, n in pixels.items()),
        **{name_of(cut): count for cut, count in pixels.items()},
    }


def name_of(cut: int) -> str:
    """Return the name under which `score.json` has the pixels of a cut of ``CUTS``.

    Parameters
    ----------
    cut : int
    """
    return str(cut) if cut > 0 else "slices"


def by_cut(
    sides: NDArray[np.uint8], crossings: Callable[[Ints], NDArray[np.uint8]]
) -> dict[int, Ints]:
    """Return the numbers of the pixels that are refined, by how they are cut.

    Parameters
    ----------
    sides : ndarray of uint8, shape (n,)
        Sub-rays that each needs on a side, see :func:`sides_needed`.
    crossings : callable
        Returns what crosses some, given by their numbers: see :mod:`gpuspec.part.crossings`.
    """
    cuts = sides.astype(np.int8)
    asked = np.flatnonzero(sides >= SIDES[-2])
    across = crossings(asked)
    cuts[asked[(across == GROOVE) & (sides[asked] >= SIDES[-1])]] = -SLICES
    cuts[asked[across == CREASE]] = CREASED
    # An edge of loss need not run along a groove: slices would not tell on which side they are.
    cuts[sides == AT_LOSS] = SIDES[-1]
    places = {cut: np.flatnonzero(cuts == cut) for cut in CUTS}
    return {cut: own for cut, own in places.items() if len(own)}


def _sides(
    change: NDArray[np.float32], wide: NDArray[np.float32], bend: float
) -> NDArray[np.uint8]:
    """Return the least number of sub-rays on a side that leaves a bend below the bound."""
    found = np.full(change.shape, SIDES[-1], np.uint8)
    found[change > 0.5 * BLIND_WIDTH_MM] = AT_LOSS
    bound = np.float32(bend) * np.minimum(wide, np.float32(WIDTH_MM))
    for side in (*SIDES[-2::-1], 1):
        found[change <= bound * np.float32(side**2)] = side
    return found


def _changes(
    light: NDArray[np.float32],
    wide: NDArray[np.float32],
    down: NDArray[np.bool_],
    across: NDArray[np.bool_],
) -> NDArray[np.float32]:
    """Return |l_cc| + |l_rr| + 2 |l_cr| over a pixel, or more: a neighbour's width less one's own.

    Parameters
    ----------
    light, wide : ndarray of float32, shape (..., rows + 2, columns + 2)
    down, across : ndarray of bool, shape (..., rows) and (..., columns)
        Rows and columns that have neighbours on both sides; for others differences are 0.
    """
    middle = light[..., 1:-1, 1:-1]
    twice = 2 * middle
    columns = np.abs(light[..., 1:-1, :-2] - twice + light[..., 1:-1, 2:])
    rows = np.abs(light[..., :-2, 1:-1] - twice + light[..., 2:, 1:-1])
    mixed = (light[..., 2:, 2:] - light[..., 2:, :-2]) - (
        light[..., :-2, 2:] - light[..., :-2, :-2]
    )
    down, across = down[..., :, None], across[..., None, :]
    change: NDArray[np.float32] = columns * across
    change += rows * down
    change += np.float32(0.5) * np.abs(mixed) * (down & across)
    own = wide[..., 1:-1, 1:-1]
    for beside in (
        wide[..., 1:-1, :-2], wide[..., 1:-1, 2:], wide[..., :-2, 1:-1], wide[..., 2:, 1:-1]
    ):  # fmt: skip
        np.maximum(change, np.abs(own - beside), out=change)
    return change


def _spread(values: NDArray[np.float32]) -> NDArray[np.float32]:
    """Return the largest of the 3 x 3 around each: a bend may lie between two pixels."""
    for axis in (0, 1):
        ahead, behind = np.moveaxis(values, axis, 0)[1:], np.moveaxis(values, axis, 0)[:-1]
        largest = values.copy()
        along = np.moveaxis(largest, axis, 0)
        np.maximum(along[:-1], ahead, out=along[:-1])
        np.maximum(along[1:], behind, out=along[1:])
        values = largest
    return values
