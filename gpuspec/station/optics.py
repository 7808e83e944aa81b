"""A camera from its data sheet: what a thin lens makes of focal length, f-number and pitch."""

from __future__ import annotations

import math
from functools import cache

from gpuspec.station.materials import WAVELENGTH_NM

FOLLOWS = {
    "sampling_mm": ("focal_mm", "pixel_um", "height_mm"),
    "pupil_mm": ("focal_mm", "f_number"),
    "blur_mm": ("mtf50_lp_per_mm", "pixel_um"),
}
"""Keys of the camera that follow where all of some others are given, and those others."""

NO_DATA_SHEET = {
    f"camera.{key}": None for key in ("focal_mm", "f_number", "pixel_um", "mtf50_lp_per_mm")
}
"""Changes that leave a camera its sampling, pupil and blur, and let them be changed one by one."""

BELL = 4.0
"""What t + c t^3 has for c where points stand for a Gaussian. Against images blurred one by one, by
0.25 to 2 pixels, 8 x 8 points are nearest at 3 to 5. With the Gaussian's own fourth cumulant, at
c = 12 and more, they crowd in the middle, and the largest error is two to three times as large."""

_BOX, _FEW = -1.2, 4
_MICRO = 1e-3  # mm in a micrometre
_HALF = math.sqrt(2 * math.log(2)) / (2 * math.pi)  # exp(-2 (pi s f)^2) = 1/2 at s f = this
_AIRY_HALF = 0.404  # of the cut-off 1 / (wavelength N): where a perfect lens has half its contrast


def magnification(focal_mm: float, distance_mm: float) -> float:
    """Return the size of a thin lens's image over that of what is at a distance: f / (h - f).

    Parameters
    ----------
    focal_mm : float
        Focal length f.
    distance_mm : float
        From the entrance pupil to the plane in focus, h.

    Examples
    --------
    >>> from gpuspec.station.optics import magnification
    >>> magnification(25.0, 525.0)
    0.05
    """
    return focal_mm / (distance_mm - focal_mm)


def sampling_mm(
    focal_mm: float, pixel_um: float, distance_mm: float, focus_mm: float | None = None
) -> float:
    """Return the distance of two pixels on a plane.

    Parameters
    ----------
    focal_mm, distance_mm : float
        As of :func:`magnification`.
    pixel_um : float
        Pitch of the sensor.
    focus_mm : float, optional
        Distance of the plane in focus, if that is another one.

    Examples
    --------
    >>> from gpuspec.station.optics import sampling_mm
    >>> round(sampling_mm(25.0, 3.45, 525.0), 6)
    0.069
    """
    focus = distance_mm if focus_mm is None else focus_mm
    return pixel_um * _MICRO / magnification(focal_mm, focus) * (distance_mm / focus)


def blur_um(mtf50_lp_per_mm: float) -> float:
    """Return the standard deviation of the Gaussian whose contrast is one half at a frequency.

    Parameters
    ----------
    mtf50_lp_per_mm : float
        Line pairs per mm on the sensor.

    Examples
    --------
    >>> from gpuspec.station.optics import blur_um
    >>> round(blur_um(100.0), 3)  # um: a spot a pixel wide on most sensors
    1.874
    """
    return _HALF / mtf50_lp_per_mm / _MICRO


def diffraction_mtf50(
    f_number: float, magnified: float = 0.0, wavelength_nm: float = WAVELENGTH_NM
) -> float:
    """Return where the contrast of a perfect lens is one half, line pairs per mm on the sensor.

    J. W. Goodman, Introduction to Fourier Optics, 6.3: of a round pupil, 0.404 of the cut-off.

    Parameters
    ----------
    f_number : float
    magnified : float
        Size of the image over that of the object: near objects see a smaller cone.
    wavelength_nm : float
        Of the light.

    Examples
    --------
    >>> from gpuspec.station.optics import diffraction_mtf50
    >>> round(diffraction_mtf50(8.0), 1)
    91.8
    """
    return _AIRY_HALF / (wavelength_nm / 1e6 * f_number * (1 + magnified))


def depth_of_field_mm(pupil_mm: float, focus_mm: float, spot_mm: float) -> tuple[float, float]:
    """Return how much nearer and farther than the plane in focus a point is imaged within a spot.

    The cone from the pupil D to a point in focus, F away, is D d / F wide d before and behind it.

    Parameters
    ----------
    pupil_mm : float
        Diameter D of the pupil; 0: everything is sharp.
    focus_mm : float
        Distance F.
    spot_mm : float
        Diameter of the spot, measured on the plane in focus: a pixel's side, say.

    Examples
    --------
    >>> from gpuspec.station.optics import depth_of_field_mm
    >>> near, far = depth_of_field_mm(3.0, 600.0, 0.05)
    >>> round(near, 2), round(far, 2)
    (9.84, 10.17)
    """
    if pupil_mm <= spot_mm:
        near = focus_mm * spot_mm / (pupil_mm + spot_mm)
        return near, math.inf
    return focus_mm * spot_mm / (pupil_mm + spot_mm), focus_mm * spot_mm / (pupil_mm - spot_mm)


@cache
def spread(excess: float, n: int) -> tuple[float, float]:
    """Return a and b so that n points a t + b t^3, each a box of side 1/n, stand for a bell.

    Of n points t, even from -1/2 to 1/2. Points and boxes have the variance 1/12 together, whatever
    n is; b/a lies between that of a box and what `BELL` says of a Gaussian. Four points or fewer
    stand best as of a box: towards the middle of a bell they leave its sides to two of them.

    Parameters
    ----------
    excess : float
        Fourth cumulant over the variance squared: -1.2 of a box, 0 of a Gaussian.
    n : int

    Examples
    --------
    >>> from gpuspec.station.optics import spread
    >>> spread(-1.2, 8), spread(0.0, 4)
    ((1.0, 0.0), (1.0, 0.0))
    >>> first, third = spread(0.0, 8)
    >>> round(first, 3), round(third, 3)
    (0.627, 2.507)
    """
    cube = BELL * (1 - excess / _BOX)
    if n <= _FEW or cube <= 0:
        return 1.0, 0.0
    t = [(i + 0.5) / n - 0.5 for i in range(n)]
    scale = math.sqrt(sum(u**2 for u in t) / sum((u + cube * u**3) ** 2 for u in t))
    return scale, scale * cube
