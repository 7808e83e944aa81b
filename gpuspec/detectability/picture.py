"""The picture of a probability of detection: curve, bound, sizes, trials, and signals."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any, Protocol

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.lines import Line2D
from matplotlib.ticker import FuncFormatter, LogLocator, NullLocator

from gpuspec.detectability.curve import POD
from gpuspec.detectability.false_calls import FalseCalls
from gpuspec.detectability.fitted import Fitted
from gpuspec.detection.chances import CONFIDENCE
from gpuspec.light.backend import DeviceInfo
from gpuspec.pictures.page import MARGIN, SKY, VERMILION, WIDTH, Sheet, essentials
from gpuspec.pictures.place import open_frame
from gpuspec.station.station import Station
from gpuspec.words import plural

_COLOURS = ("black", VERMILION, "#0072B2", "#009E73")
_GREY = "#606060"
_MARKS = {"a50": "o", "a90": "s", "a90_95": "D"}
_GROUPS = 12  # of like size, whose share of hits is drawn
_TICKS = 4000  # of a rug, at most
_HEIGHT = 800
_FOOT = 84
_MARGIN = 1.4  # beyond the signals, on a logarithmic scale
_WIDE = 15.0  # greatest size over least


class Found(Protocol):
    """What trials told, as :class:`gpuspec.detectability.outcome.Pod` explains it."""

    @property
    def station(self) -> Station | None:
        """That was tried."""

    @property
    def info(self) -> DeviceInfo | None:
        """Where."""

    @property
    def parts(self) -> int:
        """On how many parts."""

    @property
    def threshold_dn(self) -> float | None:
        """Above which a pixel is detected."""

    @property
    def simulated(self) -> Fitted | None:
        """Its hits and misses."""

    @property
    def signals(self) -> Fitted | None:
        """Its signals."""

    @property
    def measured(self) -> Sequence[Fitted]:
        """Trials of files."""

    @property
    def false_calls(self) -> FalseCalls | None:
        """Its false blobs."""

    @property
    def label(self) -> str:
        """The size with its unit."""

    def cautions(self) -> Sequence[str]:
        """Say where a model does not apply."""


def pod_picture(found: Found) -> Figure:
    """Draw the curves of hits over size, and signals over size where there are any."""
    sheet = Sheet(WIDTH, _HEIGHT)
    curves = ([found.simulated] if found.simulated else []) + list(found.measured)
    signals = found.signals or next((one for one in curves if one.signal is not None), None)
    lines = [one for one in _lines(found)]
    sheet.heading("Probability of detection", *lines)
    top = 44 + 24 * len(lines) + 14
    height = _HEIGHT - top - _FOOT
    wide = 560 if signals else 920
    axes = sheet.axes(MARGIN, top, wide, height)
    handles: list[Any] = []
    for number, (one, colour) in enumerate(zip(curves, _COLOURS * len(curves), strict=False)):
        handles += _draw_curve(axes, one, colour, number)
    axes.axhline(POD, color=_GREY, linewidth=0.8, linestyle=":")
    axes.set_ylim(-0.04 - 0.05 * len(curves), 1.04 + 0.05 * len(curves))
    axes.set_yticks(np.linspace(0, 1, 6))
    open_frame(axes, found.label, "probability of detection (POD)")
    ends = [[float(end(one.size)) for one in curves] for end in (np.min, np.max)]
    scale(axes, "x", min(ends[0]), max(ends[1]))
    axes.legend(
        handles=handles, loc="upper left", bbox_to_anchor=(1.02, 1.0), frameon=False, fontsize=9,
        borderaxespad=0,
    )  # fmt: skip
    if signals is not None:
        beside = sheet.axes(MARGIN + wide + 310, top, 510, height)
        sheet.figure.legend(
            handles=_draw_signals(beside, signals, found.label), loc="lower left", frameon=False,
            fontsize=9, borderaxespad=0,
            bbox_to_anchor=((MARGIN + wide + 18) / WIDTH, _FOOT / _HEIGHT),
        )  # fmt: skip
    return sheet.figure


def _lines(found: Found) -> list[str]:
    lines = []
    if found.station is not None and found.simulated is not None:
        lines.append(essentials(found.station))
        lines.append(
            f"{plural(len(found.simulated.size), 'trial')} on {plural(found.parts, 'part')}, hits "
            f"above {found.threshold_dn:.5g} DN  ·  {found.info}"
        )
    if found.false_calls is not None:
        calls = found.false_calls
        lines.append(
            f"false calls per part: {calls.per_part:.3g}, at most {calls.bound:.3g} with "
            f"{100 * CONFIDENCE:.0f} % confidence"
        )
    lines += [f"note: {text}" for text in found.cautions()[:2]]
    return lines


def _draw_curve(axes: Axes, one: Fitted, colour: str, number: int) -> list[Any]:
    """Draw trials as a rug, shares of groups, curve, bound and sizes; return them for a legend."""
    low, high = float(one.size.min()), float(one.size.max())
    for hits, level in ((True, 1.03 + 0.05 * number), (False, -0.03 - 0.05 * number)):
        ticks = one.size[one.hit == hits]
        ticks = ticks[:: max(len(ticks) // _TICKS, 1)]
        ends = sorted((level, level + (0.035 if hits else -0.035)))
        axes.vlines(ticks, ends[0], ends[1], color=colour, linewidth=0.5, alpha=0.35)
    groups = np.array_split(
        np.argsort(one.size, kind="stable"), min(_GROUPS, len(one.size) // 5 + 1)
    )
    shares = axes.plot(
        [one.size[g].mean() for g in groups], [one.hit[g].mean() for g in groups], "o",
        color=colour, markerfacecolor="white", markersize=5, label="hits of trials alike in size",
    )  # fmt: skip
    title = Line2D([], [], linestyle="none", label=f"{one.name}: {len(one.size):,} trials")
    if one.curve is None:
        return [title, *shares]
    sizes = {name: value for name, value in one.sizes.items() if value is not None}
    far = max([high, *(v for v in sizes.values() if v < 1.5 * high)])
    x = _span(low, far)
    drawn = [
        title,
        *axes.plot(x, one.curve.pod(x), color=colour, linewidth=1.8, label=one.curve.method),
        *axes.plot(
            x, one.curve.bound(x), color=colour, linewidth=1.2, linestyle=(0, (5, 3)),
            label=f"{100 * CONFIDENCE:.0f} % lower bound",
        ),
        *shares,
    ]  # fmt: skip
    axes.fill_between(
        x, one.curve.bound(x), one.curve.pod(x), color=colour, alpha=0.08, linewidth=0
    )
    for name, value in one.sizes.items():
        text = f"{name.replace('_', '/')} = {one.amount(value)}"
        at: Any = ([], [])
        if value is not None and low <= value <= far:
            at = [value], [0.5 if name == "a50" else POD]
        drawn += axes.plot(
            *at,
            _MARKS[name], color=colour, markeredgecolor="white", markersize=9, zorder=5, label=text,
        )  # fmt: skip
    return drawn


def _draw_signals(axes: Axes, one: Fitted, label: str) -> list[Any]:
    """Draw signals over size, their line with its scatter, and what censors them; return these."""
    signal, line = one.signal, one.line
    assert signal is not None and line is not None
    axes.plot(one.size, signal, ".", color=SKY, markersize=3, alpha=0.6, label="signals")
    x = _span(float(one.size.min()), float(one.size.max()))
    axes.plot(x, line.signal(x), "k-", linewidth=1.6, label=_method(one))
    # 1.645 deviations each way: nine of ten signals.
    for deviations, text in ((-1.645, "nine of ten signals"), (1.645, None)):
        axes.plot(x, line.signal(x, deviations), "k", linestyle=":", linewidth=1, label=text)
    for value, name, colour in (
        (line.threshold, "threshold", VERMILION), (line.noise, "noise", _GREY),
        (line.saturation, "saturation", _GREY),
    ):  # fmt: skip
        if np.isfinite(value):
            style = "-" if name == "threshold" else "--"
            axes.axhline(value, color=colour, linewidth=1, linestyle=style,
                         label=f"{name}, {value:.3g}")  # fmt: skip
    seen = signal[np.isfinite(signal)]
    if line.log_signal:
        low = min(float(seen[seen > 0].min()), line.noise if line.noise > 0 else np.inf)
        ends = low / _MARGIN, max(float(seen.max()), line.threshold) * _MARGIN
    else:
        room = 0.08 * max(float(np.ptp(seen)), 1e-9)
        ends = float(seen.min()) - room, float(seen.max()) + room
    open_frame(axes, label, "signal above the flawless level, DN" if one.unit else "signal")
    if line.log_signal:
        axes.set_yscale("log")
        axes.yaxis.set_major_formatter(FuncFormatter(lambda v, _: f"{v:g}"))
        axes.yaxis.set_minor_locator(NullLocator())
    axes.set_ylim(*ends)
    scale(axes, "x", float(one.size.min()), float(one.size.max()))
    return axes.get_legend_handles_labels()[0]


def is_wide(low: float, high: float) -> bool:
    """Whether sizes are told apart on a logarithmic scale alone.

    Parameters
    ----------
    low, high : float
    """
    return low > 0 and high > _WIDE * low


def _span(low: float, high: float) -> Any:
    return np.geomspace(low, high, 400) if is_wide(low, high) else np.linspace(low, high, 400)


def scale(axes: Axes, axis: str, low: float, high: float) -> None:
    """Draw sizes by their logarithm where they are far apart.

    Parameters
    ----------
    axes : Axes
    axis : str
        x or y.
    low, high : float
        Least and greatest size.
    """
    if is_wide(low, high):
        own = axes.xaxis if axis == "x" else axes.yaxis
        (axes.set_xscale if axis == "x" else axes.set_yscale)("log")
        own.set_major_formatter(FuncFormatter(lambda v, _: f"{v:g}"))
        own.set_major_locator(LogLocator(subs=(1.0, 2.0, 5.0)))
        own.set_minor_locator(NullLocator())


def _method(one: Fitted) -> str:
    return one.curve.method if one.curve else "line"
