"""Which pixels of a list need sub-rays, told on the device that holds it: `kernels/refine.cl`."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np
from numpy.typing import NDArray

from gpuspec.light.refinement import WIDTH_MM, Beside, Neighbourhood

Ints = NDArray[np.int64]


class Surroundings:
    """Pixels of a list and their neighbours, laid on a device once for all light maps of the list.

    Parameters
    ----------
    device : OpenCLDevice
    around : Neighbourhood
        Of the pixels.
    known : ndarray of int64
        Where its `pixels` stand in the list.
    """

    def __init__(self, device: Any, around: Neighbourhood, known: Ints) -> None:
        self.around = around
        self._device = b = device
        self._width = width = b.widths["refine.cl"]
        self._laid = [
            _filled(planes, width)
            for planes in ([known], _planes(around.near), _planes(around.around), [around.own])
        ]
        self._buffers = [b.kept(values) for values in self._laid]

    def sides_needed(self, light: Any, wide: Any, bend: float) -> NDArray[np.uint8]:
        """Return how many sub-rays the pixels need on each side, in the order of the image.

        Parameters
        ----------
        light, wide : Buffer
            Of the list.
        bend : float
            See :func:`gpuspec.light.refinement.bend_of`.
        """
        b = self._device
        known, near, around, own = self._buffers
        ordered, among, needing, _ = (values.shape[1] for values in self._laid)
        coordinates, widths, change = (b.empty(4 * n) for n in (ordered, ordered, among))
        sides = b.empty(needing)
        self._start("in_order", ordered, coordinates, widths, light, wide, known)
        self._start("changes_beside", among, change, coordinates, widths, near, np.uint32(among))
        self._start(
            "sides_beside", needing, sides, change, widths, around, np.uint32(needing), own,
            np.float32(bend), np.float32(WIDTH_MM),
        )  # fmt: skip
        found = np.empty(needing, np.uint8)
        b.copy_home(found, sides)
        return found[: len(self.around.own)]

    def _start(self, kernel: str, count: int, *arguments: Any) -> None:
        for some in self._device.launches(kernel, np.ones(count // self._width)):
            self._device.start(
                "refine.cl", kernel, (some.stop - some.start,), *arguments, offset=(some.start,)
            )


def _planes(beside: Beside) -> list[NDArray[Any]]:
    """Return what the struct ``Beside`` is read from, four rows."""
    sides = beside.left + 2 * beside.right.astype(np.uint8)
    return [beside.above, beside.middle, beside.below, sides]


def _filled(rows: Sequence[NDArray[Any]], width: int) -> NDArray[np.uint32]:
    """Return rows as whole vectors; what fills them looks at the first pixel."""
    count = len(rows[0])
    found = np.zeros((len(rows), -(-count // width) * width), np.uint32)
    for filled, row in zip(found, rows, strict=True):
        filled[:count] = row
    return found
