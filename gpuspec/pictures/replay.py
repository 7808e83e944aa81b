"""Contrast, noise and their ratio over the exposure at which frames are replayed."""

from __future__ import annotations

from matplotlib.figure import Figure
from matplotlib.ticker import FixedLocator, NullLocator

from gpuspec.frames.replay import Replay
from gpuspec.pictures.page import MARGIN, VERMILION, WIDTH, Sheet


def replay_picture(found: Replay, about: str) -> Figure:
    """Draw what each exposure would have shown.

    Parameters
    ----------
    found : Replay
    about : str
        Which frames, for the line under the heading.

    Returns
    -------
    Figure
    """
    sheet = Sheet(WIDTH, 780)
    sheet.heading(f"Exposure {found.best:.3g} times that of the frames shows scratches best", about)
    left = MARGIN + 40
    width = WIDTH - MARGIN - left - 70
    ratio, contrast, noise = (sheet.axes(left, *at) for at in _panels(width))
    ratio.plot(found.exposure, found.ratio, "o-", color="#0072B2")
    ratio.set_ylabel("contrast over noise")
    contrast.plot(found.exposure, found.contrast_dn, "o-", color=VERMILION, label="contrast, DN")
    contrast.plot(
        found.exposure, 100 * found.saturated, ":", color="#8C8C8C", label="samples saturated, %"
    )
    contrast.set_ylabel("contrast, DN; %")
    contrast.legend(frameon=False)
    noise.plot(found.exposure, found.noise_dn, "s-", color="black")
    noise.set_ylim(0, 1.15 * float(found.noise_dn.max()))
    noise.set_ylabel("noise, DN")
    noise.set_xlabel("exposure, times that of the frames")
    for ax in (ratio, contrast, noise):
        ax.set_xscale("log")
        ax.xaxis.set_major_locator(FixedLocator(found.exposure.tolist()))
        ax.xaxis.set_minor_locator(NullLocator())
        ax.set_xticklabels([f"{one:.3g}" for one in found.exposure])
        ax.axvline(found.best, color="black", linestyle="--", linewidth=1)
        ax.axhline(0, color="#8C8C8C", linewidth=0.8)
    return sheet.figure


def _panels(width: float) -> tuple[tuple[float, float, float], ...]:
    """Return top, width and height of each, in pixels."""
    return (108, width, 220), (360, width, 190), (582, width, 120)
