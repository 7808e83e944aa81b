"""What dark and flat frames say of the camera, taken off the aspect image.

Every fusion goes with an even gain and, but for spreads and differences, with an offset: what is
done to each frame can be done once, to what they are fused to, and no frame is touched.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from gpuspec.arrays import Image, Mask
from gpuspec.errors import FrameError
from gpuspec.frames.accumulator import Fusion

_DARKEST = 0.02  # share of the flat frame's median below which it tells nothing of a pixel


@dataclass(frozen=True, eq=False)
class Shading:
    """Dark and flat level of each pixel.

    Attributes
    ----------
    dark : ndarray of float32, shape (M, N), or None
        Mean of frames without light, DN.
    flat : ndarray of float32, shape (M, N), or None
        Mean of frames of an evenly lit surface, DN.
    """

    dark: Image | None = None
    flat: Image | None = None

    def corrected(self, aspect: Image, fusion: Fusion, region: Mask) -> Image:
        """Return the aspect image of frames without dark level and with an even gain.

        Parameters
        ----------
        aspect : ndarray of float32, shape (M, N)
            DN.
        fusion : str
            How it was made of its frames.
        region : ndarray of bool, shape (M, N)
            Whose median gain is 1.

        Raises
        ------
        FrameError
            If the flat frame is no brighter than the dark one at a pixel of the region.
        """
        spread = fusion in ("std", "differential")
        dark = np.float32(0) if self.dark is None else self.dark
        level: Image = aspect if spread else aspect - dark
        if self.flat is None:
            return level
        lit = self.flat - dark
        middle = np.median(lit[region])
        bad = np.count_nonzero(region & (lit < max(_DARKEST * middle, 1)))
        if bad:
            raise FrameError(
                f"the flat frame is as dark as the dark one at {bad:,} pixels that are inspected; "
                f"take it of an evenly lit surface, or leave these out with --region."
            )
        gain = np.divide(middle, lit, out=np.ones_like(lit), where=lit > 0)
        even: Image = level * gain
        return even
