"""Constants that Python and the programs on a device share: told once, defined in every program.

`kernels/` and `shaders/` say none of these values; `sources` defines those that a program names.
"""

from __future__ import annotations

import re

from gpuspec.arrays import Lost
from gpuspec.part.grooves import BLOCK

NEWTON_STEPS = 3
"""From z = 0 to where a ray meets a height surface: the error falls as slope times field angle,
squared each time. Measured in float64 on crowns up to half cylinders and grooves of slope 1, the
camera 1.5 to 2.5 times as far as the part is long: after two steps light points are off by up to a
thousandth of their footprint, after three by 2e-9. From as far as the part is long, the worst of
80,000 pixels is off by 11 % of its footprint after two steps, by 0.1 % after three."""

CHUNK = 8
"""Images whose exposure is worked out together: each sub-ray's trapezoid is made once for all."""

GROUP = 128
"""Invocations of a workgroup of the compute shaders."""

LEVELS = 256
"""Levels of an aspect image: how many of as many thresholds a pixel is above."""

NO_PIXEL = 0xFFFFFFFF
"""In a list of pixels: none."""

SECTIONS = {"ceiling": 0, "box": 1, "arch": 2}
"""Numbers of the tunnel's sections."""

DEFINES = {
    "BLOCK": f"{BLOCK}",
    "NEWTON_STEPS": f"{NEWTON_STEPS}",
    "CHUNK": f"{CHUNK}",
    "GROUP": f"{GROUP}",
    "LEVELS": f"{LEVELS}",
    "NO_PIXEL": f"{NO_PIXEL}u",
    **{f"SECTION_{name.upper()}": f"{number}.0f" for name, number in SECTIONS.items()},
    **{f"LOST_{reason.name}": f"{reason.value}.0f" for reason in Lost},
}
"""Their names in programs and their values as the languages write them."""


def defines(text: str, given: tuple[str, ...] = ()) -> list[str]:
    """Return ``#define`` lines of the constants that a program's text names.

    Parameters
    ----------
    text : str
    given : tuple of str
        Definitions that stand in their place, e.g. ``"NEWTON_STEPS 0"``.
    """
    named = set(re.findall(r"\w+", text)) - {words.split()[0] for words in given}
    return [f"#define {name} {value}" for name, value in DEFINES.items() if name in named]
