"""A curve of the probability of detection over a defect's size, and its bounds.

With x the size or its logarithm, POD(a) = F(b0 + b1 x), F the logistic or the normal distribution
function. The lower bound is Wald's, of MIL-HDBK-1823A: at each size F(b0 + b1 x - z s(x)), with
s(x)^2 = v00 + 2 v01 x + v11 x^2 of the covariance v of b0 and b1, z = 1.645 for 95 %, one-sided.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from gpuspec.detection.chances import CONFIDENCE

Floats = NDArray[np.float64]

POD = 0.9
"""Of the size that is quoted: a90."""


@dataclass(frozen=True)
class Curve:
    """A fitted curve.

    Attributes
    ----------
    link : str
        logit or probit.
    log : bool
        Whether x is the size's natural logarithm.
    intercept, slope : float
        b0 and b1; per unit of x.
    covariance : ndarray of float64, shape (2, 2)
        Of both.
    method : str
        How it was fitted, in a few words.
    aic : float or None
        Akaike's criterion; None: a penalised fit has none.
    trials : int
        From how many.

    Examples
    --------
    >>> from gpuspec.detectability.curve import Curve
    >>> curve = Curve("logit", False, -10.0, 20.0, np.diag([4.0, 9.0]), "said", None, 60)
    >>> round(curve.size(0.5), 6), round(curve.size(0.9), 6), round(curve.bound_size(0.9), 6)
    (0.5, 0.609861, 0.882804)
    """

    link: str
    log: bool
    intercept: float
    slope: float
    covariance: Floats
    method: str
    aic: float | None
    trials: int

    def pod(self, size: ArrayLike) -> Floats:
        """Return the probability of detection.

        Parameters
        ----------
        size : array_like
            Above 0 where its logarithm is taken.
        """
        return share(self.link, self.intercept + self.slope * self._x(size))

    def bound(self, size: ArrayLike) -> Floats:
        """Return the lower bound of the probability; parameters as of :meth:`pod`."""
        x = self._x(size)
        (v00, v01), (_, v11) = self.covariance
        deviation = np.sqrt(np.maximum(v00 + 2 * v01 * x + v11 * x**2, 0))
        return share(self.link, self.intercept + self.slope * x - _z() * deviation)

    def size(self, pod: float) -> float:
        """Return the size found with this probability.

        Parameters
        ----------
        pod : float
            Between 0 and 1.
        """
        return self._size((self._line(pod) - self.intercept) / self.slope)

    def bound_size(self, pod: float = POD) -> float | None:
        """Return the least size from which on the lower bound is at least a probability.

        Parameters
        ----------
        pod : float

        Returns
        -------
        float or None
            None: the bound comes to it nowhere, or does not stay there.

        Notes
        -----
        (b0 + b1 x - q)^2 = z^2 s(x)^2 is a quadratic in x; above a_pod it has one root where the
        slope is surer than z of its deviations, and none otherwise.
        """
        more, z2 = self.intercept - self._line(pod), _z() ** 2
        (v00, v01), (_, v11) = self.covariance
        square = self.slope**2 - z2 * v11
        if self.slope <= 0 or square <= 0:
            return None
        half = self.slope * more - z2 * v01
        under = half**2 - square * (more**2 - z2 * v00)
        return self._size(float(-half + math.sqrt(max(under, 0.0))) / float(square))

    def trials_for(self, size: float, pod: float = POD) -> int | None:
        """Return from how many such trials the lower bound would be as high at a size.

        The covariance falls as one over the number of trials.

        Parameters
        ----------
        size : float
        pod : float

        Returns
        -------
        int or None
            None: the curve itself is not as high there.
        """
        x = float(self._x(size))
        above = self.intercept + self.slope * x - self._line(pod)
        if above <= 0:
            return None
        (v00, v01), (_, v11) = self.covariance
        needed = self.trials * _z() ** 2 * (v00 + 2 * v01 * x + v11 * x * x) / above**2
        return math.ceil(needed) if needed < 1e12 else None

    def _x(self, size: ArrayLike) -> Floats:
        found = np.asarray(size, np.float64)
        return np.log(found) if self.log else found

    def _size(self, x: float) -> float:
        return math.exp(min(x, 700.0)) if self.log else x

    def _line(self, pod: float) -> float:
        from scipy import special  # slow to import

        return float(special.logit(pod) if self.link == "logit" else special.ndtri(pod))


def share(link: str, line: Any) -> Floats:
    """Return F of a line: the probability of detection.

    Parameters
    ----------
    link : str
        logit or probit.
    line : array_like
    """
    from scipy import special  # slow to import

    found: Floats = special.expit(line) if link == "logit" else special.ndtr(line)
    return found


def _z() -> float:
    from scipy import special  # slow to import

    return float(special.ndtri(CONFIDENCE))
