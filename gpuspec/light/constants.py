"""Constants that Python and the programs on a device share: told once, defined in every program.

`kernels/` and `shaders/` say none of these values; `sources` defines those that a program names.
"""

from __future__ import annotations

import re

from gpuspec.arrays import Lost
from gpuspec.part.grooves import BLOCK

NEWTON_STEPS = 2
"""From z = 0 to where a ray meets a height surface that it can meet only once: the error falls as
slope times field angle, squared each time. Measured against float64 on the steepest of such parts
(`part/marches.py`): after one step light points are off by up to 0.12 of their footprint, after two
by 2e-4, after three by the rounding of floats."""

POSED_STEPS = 6
"""The same of a posed part, whose field angle may be that of its tilt, and of one that a ray may
meet twice, from its highest point on. Three are enough but at grazing angles: dents seen at 60
degrees leave 0.13 % of the pixels undecided after five steps, 0.04 % after six."""

CHUNK = 8
"""Images whose exposure is worked out together: each sub-ray's trapezoid is made once for all."""

HARMONICS = 16
"""Of a light that is no stripes, at most: through a screen's gamma a sinusoid has some five."""

GROUP = 128
"""Invocations of a workgroup of the compute shaders."""

EXPOSURES = 16
"""Designs that differ in exposure alone and are worked out together."""

TABLE_STEPS = 512
"""Of a footprint's table, at most: a pixel whose footprint takes more is seen ray by ray."""

SUB_RAYS = 256
"""Of a pixel that has a table, at most."""

LEVELS = 256
"""Levels of an aspect image: how many of as many thresholds a pixel is above."""

KINDS = 4
"""Of sets of pixels, whose levels are counted together."""

LINE = 4096
"""Pixels of a long list side by side in a row of the device; a power of two."""

LINE_SHORT = 512
"""The same of a list of fewer than 8 such rows: the cores of a CPU share its rows."""

LINE_MIN = 64
"""The same of still shorter ones, rounded up to a power of two, at least."""

STRIP_VECTORS, STRIP_ROWS = 32, 32
"""What a work-item looks at to find where sub-rays are needed: vectors of a row, and rows."""

BLIND_WIDTH_MM = 1e6
"""What stands for a footprint's width where light is lost when pixels are told to be refined: so
much more than any that all of an edge of loss are, as finely as can be."""

AT_LOSS = 9
"""In place of 8 sub-rays on a side, where a pixel needs them for an edge of loss beside it."""

NO_PIXEL = 0xFFFFFFFF
"""In a list of pixels: none."""

CELLS_FINE, CELLS_COARSE, CELLS_OFFSET = 4096, 512, 224
"""Cells per E of the table of a sensor's noise (`kernels/noise.h`): below E = 1/16, and above.
There the place of a signal is E times CELLS_COARSE, plus CELLS_OFFSET."""

SECTIONS = {"ceiling": 0, "box": 1, "arch": 2}
"""Numbers of the tunnel's sections."""

DEFINES = {
    "BLOCK": f"{BLOCK}",
    "NEWTON_STEPS": f"{NEWTON_STEPS}",
    "POSED_STEPS": f"{POSED_STEPS}",
    "CHUNK": f"{CHUNK}",
    "HARMONICS": f"{HARMONICS}",
    "GROUP": f"{GROUP}",
    "EXPOSURES": f"{EXPOSURES}",
    "SUB_RAYS": f"{SUB_RAYS}",
    "TABLE_STEPS": f"{TABLE_STEPS}",
    "LEVELS": f"{LEVELS}",
    "KINDS": f"{KINDS}",
    "CELLS_FINE": f"{CELLS_FINE}.0f",
    "CELLS_COARSE": f"{CELLS_COARSE}.0f",
    "CELLS_OFFSET": f"{CELLS_OFFSET}.0f",
    "AT_LOSS": f"{AT_LOSS}.0f",
    "BLIND_WIDTH": f"{BLIND_WIDTH_MM}f",
    "NO_PIXEL": f"{NO_PIXEL}u",
    "STRIP_VECTORS": f"{STRIP_VECTORS}",
    "STRIP_ROWS": f"{STRIP_ROWS}",
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
