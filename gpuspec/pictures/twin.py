"""A fitted station over the frames that it was fitted to, and what is left."""

from __future__ import annotations

from typing import Any, Protocol

import numpy as np
from matplotlib.figure import Figure
from numpy.typing import NDArray

from gpuspec.arrays import Image, Mask
from gpuspec.frames.photon_transfer import Transfer
from gpuspec.frames.texture import Texture
from gpuspec.pictures.page import MARGIN, SKY, VERMILION, WIDTH, Sheet

_GREY = "#8C8C8C"


class Fitted(Protocol):
    """What is drawn of a fit; as :class:`gpuspec.captured.fit.Fit` explains."""

    @property
    def about(self) -> str:
        """Which frames."""

    @property
    def kind(self) -> str:
        """Which light."""

    @property
    def real(self) -> Texture:
        """The frames' aspect image."""

    @property
    def twin(self) -> Texture:
        """The twin's."""

    @property
    def transfer(self) -> Transfer:
        """Variance over level."""

    @property
    def region(self) -> Mask:
        """Where the part is."""

    @property
    def residual(self) -> Image:
        """Aspect image less the fitted one, DN."""

    @property
    def fold(self) -> tuple[NDArray[np.float64], ...]:
        """Samples and fit over the light."""


def twin_picture(found: Fitted) -> Figure:
    """Draw light and noise with their fits, and what is left of the aspect image.

    Parameters
    ----------
    found : Fitted
    """
    sheet = Sheet(WIDTH, 1010)
    real, twin = found.real, found.twin
    sheet.heading(
        f"The twin ({found.kind}): flawless level {twin.level_dn:.1f} DN "
        f"(frames {real.level_dn:.1f}), noise {twin.noise_dn:.2f} DN (frames {real.noise_dn:.2f})",
        found.about,
    )
    turn, seen, fitted, spread = found.fold
    width, left = 560, MARGIN + 10
    upper, lower = sheet.axes(left, 118, width, 310), sheet.axes(left, 462, width, 130)
    upper.plot(turn, seen, ".", color="black", markersize=4, label="frames, mean at a place")
    upper.plot(turn, fitted, "-", color=VERMILION, linewidth=1.4, label="fit")
    upper.set_ylabel("grey level, DN")
    upper.legend(frameon=False)
    upper.tick_params(labelbottom=False)
    lower.axhline(0, color=_GREY, linewidth=0.8)
    lower.fill_between(turn, -spread, spread, color=SKY, alpha=0.35, linewidth=0,
                       label="standard deviation of a sample")  # fmt: skip
    lower.plot(turn, seen - fitted, ".", color="black", markersize=4, label="frames less fit")
    lower.set_ylabel("residual, DN")
    lower.set_xlabel("place on the light, periods")
    lower.legend(frameon=False, ncols=2, fontsize=9)
    high = 1.9 * max(float(np.max(np.abs(seen - fitted))), float(spread.max()))
    lower.set_ylim(-high, high)
    noise = sheet.axes(left, 690, width, 250)
    transfer = found.transfer
    noise.plot(transfer.level_dn, transfer.variance_dn2, "o", color="black", markersize=4,
               label="frames")  # fmt: skip
    ends = np.array([0.0, float(transfer.level_dn.max())])
    noise.plot(ends, transfer.variance(ends), "-", color=VERMILION, linewidth=1.4, label="fit")
    noise.set_ylim(0, 1.15 * float(transfer.variance_dn2.max()))
    noise.set_xlabel("grey level above black, DN")
    noise.set_ylabel("variance, DN²")
    noise.legend(frameon=False)
    sheet.text(left, 664, "Photon transfer: noise of a grey level from image to image")
    _residual(sheet, found, left + width + 130)
    return sheet.figure


def _residual(sheet: Sheet, found: Fitted, left: float) -> None:
    """Draw what is left of the aspect image without the fit."""
    rows, columns = (slice(*_span(found.region.any(axis))) for axis in (1, 0))
    rest = np.where(found.region, found.residual, np.nan)[rows, columns]
    factor = max(1, max(rest.shape) // 600)
    room = WIDTH - left - 96
    high, wide = rest.shape
    scale = min(room / wide, 760 / high)
    ax = sheet.axes(left, 146, wide * scale, high * scale)
    limit = float(np.nanquantile(np.abs(rest), 0.99)) or 1.0
    style: dict[str, Any] = {"vmin": -limit, "vmax": limit, "cmap": "RdBu_r"}
    extent = (columns.start, columns.stop, rows.stop, rows.start)
    drawn = ax.imshow(rest[::factor, ::factor], extent=extent, interpolation="nearest", **style)
    ax.set_xlabel("column, px")
    ax.set_ylabel("row, px")
    ax.set_facecolor("#E8E8E8")
    sheet.text(left, 118, "Aspect image of the frames less that of the fit")
    bar = sheet.axes(left + wide * scale + 12, 146, 14, high * scale)
    sheet.figure.colorbar(drawn, cax=bar).set_label("DN")


def _span(used: Any) -> tuple[int, int]:
    places = np.flatnonzero(used)
    return int(places[0]), int(places[-1]) + 1
