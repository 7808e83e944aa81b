"""How often a station calls a defect where none is, and at most how often."""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike, NDArray

from gpuspec.detection.chances import CONFIDENCE, greatest_mean, greatest_share


@dataclass(frozen=True)
class FalseCalls:
    """False blobs of a number of parts.

    Attributes
    ----------
    parts : int
    near : ndarray of int64, shape (parts,)
        Counted near defects, all of them.
    drawn : int
        Pixels drawn of the rest, of all parts.
    drawn_false : float
        False blobs of these.
    rest_px : float
        Pixels of the rest of a part, on average.
    clear : bool
        Whether no pixel of the rest can be above the threshold, for certain.

    Examples
    --------
    >>> from gpuspec.detectability.false_calls import FalseCalls
    >>> calls = FalseCalls.of([0, 1, 0, 0], [0, 0, 0, 0], [1000] * 4, [0] * 4, True)
    >>> calls.per_part, round(calls.bound, 2)
    (0.25, 1.19)
    """

    parts: int
    near: NDArray[np.int64]
    drawn: int
    drawn_false: float
    rest_px: float
    clear: bool

    @classmethod
    def of(
        cls, near: ArrayLike, drawn_false: ArrayLike, drawn: ArrayLike, rest_px: ArrayLike,
        clear: bool,
    ) -> FalseCalls:  # fmt: skip
        """Add up those of some parts.

        Parameters
        ----------
        near, drawn_false, drawn, rest_px : array_like, shape (parts,)
        clear : bool
            Of all parts.
        """
        found = np.asarray(near, np.int64)
        return cls(
            len(found), found, int(np.sum(drawn)), float(np.sum(drawn_false)),
            float(np.mean(np.asarray(rest_px, np.float64))), clear,
        )  # fmt: skip

    @property
    def per_part(self) -> float:
        """False blobs of a part, on average."""
        return float(self.near.mean()) + self._rest(self.drawn_false / max(self.drawn, 1))

    @property
    def bound(self) -> float:
        """Upper bound of this, with the confidence of all bounds.

        Blobs near defects follow Poisson's law where their variance is not above their mean, and
        else come in so many at a time; of the drawn pixels, Clopper's and Pearson's bound. Each has
        half of the risk, where both are needed.
        """
        sure = CONFIDENCE if self._is_clear else (1 + CONFIDENCE) / 2
        mean = float(self.near.mean())
        together = max(float(self.near.var(ddof=1)) / mean, 1.0) if mean and self.parts > 1 else 1.0
        near = together * greatest_mean(self.near.sum() / together, sure) / self.parts
        return near + self._rest(greatest_share(math.ceil(self.drawn_false), self.drawn, sure))

    @property
    def said(self) -> str:
        """Both in a sentence."""
        how = (
            "none away from defects, for certain" if self._is_clear
            else f"{self.drawn:,} pixels drawn away from defects"
        )  # fmt: skip
        return (
            f"false calls per part: {self.per_part:.3g}, at most {self.bound:.3g} with "
            f"{100 * CONFIDENCE:.0f} % confidence ({self.near.sum():,} near defects on "
            f"{self.parts:,} parts; {how})"
        )

    @property
    def _is_clear(self) -> bool:
        return self.clear and not self.drawn_false

    def _rest(self, share: float) -> float:
        return 0.0 if self._is_clear else share * self.rest_px
