"""The probability of detection over two sizes, and the curve over the first at each of the second.

With x and w the two sizes or their logarithms, POD = F(b0 + b1 x + b2 w). At one w that is a curve
over x, with the intercept b0 + b2 w and the covariance that follows (delta method, exact as it is
linear), so that its sizes and Wald's bound are those of any curve.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from gpuspec.detectability.curve import Curve, share

Floats = NDArray[np.float64]


@dataclass(frozen=True)
class Surface:
    """A fitted surface.

    Attributes
    ----------
    link : str
        logit or probit.
    logs : tuple of bool
        Whether x, and whether w, is the size's natural logarithm.
    coefficients : ndarray of float64, shape (3,)
        b0, b1 and b2.
    covariance : ndarray of float64, shape (3, 3)
        Of these.
    method : str
        How it was fitted, in a few words.
    aic : float or None
        Akaike's criterion; None: a penalised fit has none.
    trials : int
        From how many.
    """

    link: str
    logs: tuple[bool, ...]
    coefficients: Floats
    covariance: Floats
    method: str
    aic: float | None
    trials: int

    def pod(self, first: Floats, second: Floats) -> Floats:
        """Return the probability of detection of defects.

        Parameters
        ----------
        first, second : ndarray, shape (n,)
        """
        x, w = (
            np.log(of) if log else of for of, log in zip((first, second), self.logs, strict=True)
        )
        b0, b1, b2 = self.coefficients
        return share(self.link, b0 + b1 * x + b2 * w)

    def at(self, second: float) -> Curve:
        """Return the curve over the first size at one of the second.

        Parameters
        ----------
        second : float

        Examples
        --------
        >>> from gpuspec.detectability.surface import Surface
        >>> b, v = np.array([-10.0, 20.0, -4.0]), np.diag([4.0, 9.0, 1.0])
        >>> found = Surface("logit", (False, False), b, v, "said", None, 60)
        >>> [round(found.at(w).size(0.5), 6) for w in (0.0, 1.0)]
        [0.5, 0.7]
        """
        w = math.log(second) if self.logs[1] else second
        fold = np.array([[1.0, 0.0, w], [0.0, 1.0, 0.0]])
        intercept, slope = fold @ self.coefficients
        return Curve(
            self.link, self.logs[0], float(intercept), float(slope),
            fold @ self.covariance @ fold.T, self.method, self.aic, self.trials,
        )  # fmt: skip
