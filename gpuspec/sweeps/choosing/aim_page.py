"""The front of an aim as one page that opens without a network: what is pointed at tells itself."""

from __future__ import annotations

from typing import Any

import numpy as np
from bokeh.embed import file_html
from bokeh.models import ColumnDataSource, HoverTool
from bokeh.models.annotations.legends import ColorBar
from bokeh.plotting import figure
from bokeh.resources import INLINE
from bokeh.transform import linear_cmap

from gpuspec import words
from gpuspec.sweeps.choosing.aimed import AimChoice, Standing
from gpuspec.sweeps.measures import measure

DRAWN = 5_000
"""Designs at most, so that the page stays small."""

_SHOWN = ("margin_dn", "margin_sigma", "hits", "images")


def aim_page(choice: AimChoice) -> str:
    """Return the front as HTML with all that it needs in it.

    Parameters
    ----------
    choice : AimChoice
    """
    up, across, *third = (measure(name) for name in choice.over)
    plot = figure(
        title=f"{choice.run.path.name}: {choice.aim}", x_axis_label=across.axis,
        y_axis_label=up.axis, width=1000, height=640, tools="pan,wheel_zoom,box_zoom,reset,save",
        output_backend="canvas",
    )  # fmt: skip
    count = len(choice.ranked.design)
    some = np.arange(count)
    if count > DRAWN:
        some = np.sort(np.random.default_rng(0).choice(count, DRAWN, replace=False))
    front = choice.front.only(np.argsort(choice.front.values[choice.over[1]], kind="stable"))
    tips = [
        ("design", "@design"),
        *((key, f"@{{{key}}}") for key in choice.plan.values(0)),
        ("threshold, DN", "@threshold_dn{0.0}"),
        *((name, f"@{{{name}}}{{0.[000]}}") for name in dict.fromkeys([*choice.over, *_SHOWN])),
    ]
    colour: Any = "black"
    if third:
        seen = front.values[third[0].name]
        low, high = float(seen.min()), float(seen.max())
        colour = linear_cmap(third[0].name, "Viridis256", low, high)
        scale = ColorBar(color_mapper=colour.transform, title=third[0].axis)
        plot.add_layout(scale, "right")
    else:
        plot.step("x", "y", source=_source(choice, front), color="black", line_width=1.5,
                  mode="before" if across.high else "after")  # fmt: skip
    drawn: list[Any] = []
    for points, fill, size, name in (
        (choice.ranked.only(some), "#A8A8A8", 5, "meets what is required"),
        (front, colour, 7, "front"),
        (choice.next(3), "#F0E442", 10, "next three"),
    ):
        drawn.append(
            plot.scatter("x", "y", source=_source(choice, points), size=size, fill_color=fill,
                         line_color="black" if size > 5 else None, legend_label=name)
        )  # fmt: skip
    for held, fill, marker, name in (
        (choice.peak, "#D55E00", "circle", "peak"), (choice.robust, "#0072B2", "diamond", "robust"),
    ):  # fmt: skip
        values = held.values
        at = {n: np.array([v]) for n, v in values.items()}
        one = Standing(np.array([held.design]), np.array([0]), at)
        drawn.append(
            plot.scatter("x", "y", source=_source(choice, one, held.threshold_dn), size=17,
                         marker=marker, fill_color=fill, line_color="white", legend_label=name)
        )  # fmt: skip
    plot.add_tools(HoverTool(renderers=drawn, tooltips=tips))
    plot.legend.orientation = "horizontal"
    plot.legend.click_policy = "hide"
    plot.add_layout(plot.legend[0], "above")  # beside the points, none of which it hides
    told = f"gpuspec: front of {choice.run.path.name}, {words.plural(count, 'design')}"
    return str(file_html(plot, INLINE, told))


def _source(
    choice: AimChoice, points: Standing, threshold_dn: float | None = None
) -> ColumnDataSource:
    """Return points with all that is told of them."""
    first, second, *_ = choice.over
    designs = points.design.tolist()
    values = [choice.plan.values(design) for design in designs]
    dn = [threshold_dn if threshold_dn is not None else choice.threshold_dn(points, number)
          for number in range(len(designs))]  # fmt: skip
    told = {name: points.values[name].tolist() for name in dict.fromkeys([*choice.over, *_SHOWN])}
    return ColumnDataSource(
        {
            "x": told[second], "y": told[first], "design": designs, "threshold_dn": dn,
            **{key: [v[key] for v in values] for key in choice.plan.values(0)}, **told,
        }
    )  # fmt: skip
