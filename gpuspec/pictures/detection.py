"""The detection over the truth: what was hit, missed, or found where nothing is."""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

import numpy as np
from matplotlib.axes import Axes
from matplotlib.collections import LineCollection, PolyCollection
from matplotlib.figure import Figure
from matplotlib.lines import Line2D
from matplotlib.patches import Patch
from matplotlib.patheffects import AbstractPathEffect, withStroke
from matplotlib.transforms import Transform
from numpy.typing import NDArray

from gpuspec import words
from gpuspec.arrays import BESIDE, pooled
from gpuspec.detection.inspection import levelled
from gpuspec.detection.measures import measure_blobs
from gpuspec.pictures.page import (
    MARGIN,
    NOTES,
    SKY,
    VERMILION,
    WIDTH,
    YELLOW,
    Sheet,
    fitted,
    length_text,
)
from gpuspec.pictures.place import (
    GREY,
    draw_codes,
    draw_grey,
    grey_range,
    millimetres,
    range_up_to,
    reduction,
    scale_bar,
)
from gpuspec.station.station import Station

if TYPE_CHECKING:
    from gpuspec.pictures.seen import Inspected, Known


KINDS = {"hit": SKY, "false": YELLOW, "missed": VERMILION, "found": SKY}  # by rising priority
LETTERS = "abcdef"
DETAILS = len(LETTERS)
BOXES_MAX = 400  # of one kind; more would hide the image


@dataclass(frozen=True)
class _Find:
    """A defect or false blob, where it is, and what is said of it."""

    kind: str
    rows: tuple[int, int]
    columns: tuple[int, int]
    caption: str
    urgency: float


def detection_picture(result: Inspected) -> Figure:
    """Draw what is detected, missed and false over the aspect image, and details of each.

    Returns
    -------
    Figure
        Zones of defects that are hit or missed, and false blobs, filled and in a box; beside them
        up to six details: missed defects first, the largest zone first, then false blobs, the
        largest first, then hits, the least covered first. Where no defects are known, the blobs,
        the largest first.
    """
    station = result.station
    finds = _finds(result)
    shown = finds[:DETAILS]
    rows, columns = station.shape
    below = columns >= 1.5 * rows
    top, gap, caption = 118, 34, 90  # px, the last above and below each detail
    room = WIDTH - 2 * MARGIN
    reserved = 0 if below or not shown else 520
    width, height = fitted(station.shape, room - reserved, 800)
    left = MARGIN if reserved else (WIDTH - width) / 2
    number = max(len(shown), 1)
    if below:
        per_row, details_left, details_top = DETAILS, float(MARGIN), top + height + 86
        side = (room - (per_row - 1) * gap) / per_row
    else:
        per_row = min(3 if 3 * width < room else 2, number)
        details_left, details_top = left + width + 60, top
        side = min(
            (WIDTH - MARGIN - details_left + gap) / per_row - gap,
            (height + 30) / math.ceil(number / per_row) - caption,
        )
    bottom = details_top + math.ceil(len(shown) / per_row) * (side + caption)
    foot = NOTES * bool(result.warnings)
    sheet = Sheet(WIDTH, max(top + height + 84, bottom + 10) + foot)
    sheet.notes(result.warnings)
    sheet.heading(_title(result), result.about)
    handles: list[Any] = [
        Patch(facecolor=KINDS[kind], edgecolor="#404040", linewidth=0.6, label=label)
        for kind, label in _counts(result).items()
    ]
    if shown:
        label = f"detected, above {result.threshold:.1f} DN, in the details"
        outline = Line2D([], [], color="white", linewidth=1.4, label=label)
        outline.set_path_effects(_halo())
        handles.append(outline)
    sheet.legend(handles, 76)

    low, high = grey_range(result)
    ax = sheet.axes(left, top, width, height)
    draw_grey(ax, result.aspect, station, low, high, result.lost)
    codes = _codes(result)
    draw_codes(ax, codes, station, ["#00000000", *KINDS.values()])
    _draw_boxes(ax, finds, station)
    millimetres(ax)
    scale_bar(ax, 62)
    _name_boxes(ax, shown, station)
    for place, find in enumerate(shown):
        row, column = divmod(place, per_row)
        x = details_left + column * (side + gap)
        detail = sheet.axes(x, details_top + 58 + row * (side + caption), side, side)
        _draw_detail(detail, find, result, codes)
        letter = LETTERS[place]
        detail.set_title(find.caption, fontsize=9, loc="left", y=1, pad=6)
        _write_letter(detail, letter, (0.09, 0.91), detail.transAxes)
    return sheet.figure


def _title(result: Inspected) -> str:
    """Return what was found, and how good that is where defects are known."""
    score = result.score
    if score is None:
        found = words.plural(len(result.blobs), "blob")
        return f"Detection: {found} above {result.threshold:.1f} DN"
    p2, f1 = ("undefined" if v is None else f"{v:.3f}" for v in (score.p2, score.f1))
    p1 = words.precision(score.p1, score.hit_px + score.false_px)
    return f"Detection: {words.P1} {p1}   {words.P2} {p2}   F1 {f1}   ({words.BEST})"


def _counts(result: Inspected) -> dict[str, str]:
    """Return how many finds there are of each kind, in words."""
    score = result.score
    if score is None:
        names, counts = np.unique(result.classes, return_counts=True)
        classes = ", ".join(f"{n:,} {name}" for name, n in zip(names, counts, strict=True))
        boxed = f"; {BOXES_MAX} in boxes" if len(result.blobs) > BOXES_MAX else ""
        return {"found": f"blob ({classes or 'none'}{boxed})"}
    unseen = f", {score.unseen:,} unseen" if score.unseen else ""
    missed = score.defects - score.defects_hit
    return {
        "hit": f"defect hit ({_counted(score.defects_hit, score.defects)})",
        "missed": f"defect missed ({_counted(missed, score.defects)}{unseen})",
        "false": f"false blob ({_counted(score.false_blobs, score.blobs)})",
    }


def _counted(number: int, of: int) -> str:
    """Return how many of a kind there are, and that not all are in boxes."""
    boxed = f", {BOXES_MAX} of them in boxes" if number > BOXES_MAX else ""
    return f"{number:,} of {of:,}{boxed}"


def _false_blobs(result: Inspected) -> NDArray[np.bool_]:
    """Return whether each blob touches no zone."""
    touching = np.zeros(int(result.blobs.label.max(initial=0)) + 1, np.bool_)
    touching[result.labels[result.truth != 0]] = True
    return ~touching[result.blobs.label]


def _codes(result: Inspected) -> NDArray[np.uint8]:
    """Return 0, or 1 + the place in `KINDS` of what each pixel belongs to."""
    hit, false, missed, found = range(1, 5)
    if result.score is None:
        return np.where(result.labels, found, 0).astype(np.uint8)
    of_defect = np.array([0, *(hit if n else missed for n in result.score.defect_hit_px)], np.uint8)
    of_blob = np.zeros(int(result.blobs.label.max(initial=0)) + 1, np.uint8)
    of_blob[result.blobs.label[_false_blobs(result)]] = false
    codes = np.zeros(result.truth.shape, np.uint8)
    for labels, code in ((result.truth, of_defect), (result.labels, of_blob)):
        there = np.flatnonzero(labels)
        codes.flat[there] = np.maximum(codes.flat[there], code[labels.flat[there]])
    return codes


def _finds(result: Inspected) -> list[_Find]:
    """Return missed defects, false blobs and hits, in this order, the most telling first."""
    if result.score is None:
        return _blob_finds(result, "found", np.arange(len(result.blobs)))
    sampling = result.station.camera.sampling_mm
    held = levelled(result.aspect, result.lost != BESIDE, result.station, result.lost == 0)
    zones = measure_blobs(result.truth, held, sampling_mm=sampling, flawless_dn=result.flawless_dn)
    finds = []
    for zone in zones.rows():
        number = int(zone["label"])
        hit_px = result.score.defect_hit_px[number - 1]
        kind = "hit" if hit_px else "missed"
        urgency = hit_px / zone["area_px"] if hit_px else -zone["area_px"]
        caption = (
            f"{kind}: {_caption(result.defects[number - 1], number)}\npeak {zone['peak_dn']:.0f} DN"
        )
        finds.append(_find(kind, zone, caption, urgency))
    finds += _blob_finds(result, "false", np.flatnonzero(_false_blobs(result)))
    order = ["missed", "false", "hit"]
    return sorted(finds, key=lambda find: (order.index(find.kind), find.urgency))


def _blob_finds(result: Inspected, kind: str, chosen: NDArray[np.int64]) -> list[_Find]:
    """Return the largest of some blobs as finds."""
    blobs, finds = result.blobs, []
    for index in chosen[np.argsort(-blobs.area_px[chosen], kind="stable")][:BOXES_MAX]:
        box = {
            side: int(getattr(blobs, side)[index]) for side in ("top", "left", "bottom", "right")
        }
        said = "" if kind == "found" else f"{kind}: "
        caption = (
            f"{said}{result.classes[index]}\nblob {blobs.label[index]}, "
            f"{_two_digits(blobs.area_mm2[index])} mm²\n"
            f"peak {blobs.peak_dn[index]:.0f} DN"
        )
        finds.append(_find(kind, box, caption, -float(blobs.area_px[index])))
    return finds


def _find(kind: str, box: dict[str, Any], caption: str, urgency: float) -> _Find:
    return _Find(kind, (box["top"], box["bottom"]), (box["left"], box["right"]), caption, urgency)


def _caption(defect: Known, number: int) -> str:
    way = "↑" if defect.kind == "bump" else "↓"
    across = "wide" if defect.length_mm else "⌀"
    size = length_text(float(_two_digits(defect.size_mm)))
    depth = "" if defect.depth_um is None else f", {way} {_two_digits(defect.depth_um)} µm"
    return f"{defect.kind} {number}\n{across} {size}{depth}"


def _two_digits(value: float) -> str:
    return words.number(float(f"{value:.2g}"))


def _box_mm(find: _Find, station: Station) -> tuple[float, float, float, float]:
    """Return a find's centre and half sides along x and y, in mm."""
    (rows, columns), p = station.shape, station.camera.sampling_mm
    x = (sum(find.columns) - columns) / 2 * p
    y = (rows - sum(find.rows)) / 2 * p
    return (
        x,
        y,
        (find.columns[1] - find.columns[0]) / 2 * p,
        (find.rows[1] - find.rows[0]) / 2 * p,
    )


def _half_box(find: _Find, ax: Axes, station: Station) -> NDArray[np.float64]:
    """Return centre and half sides in mm of the box drawn round a find: 5 px off, 8 px at least."""
    x, y, half_x, half_y = _box_mm(find, station)
    mm_per_px = station.shape[1] * station.camera.sampling_mm / ax.get_window_extent().width
    half = np.maximum(np.array([half_x, half_y]) + 5 * mm_per_px, 8 * mm_per_px)
    return np.array([x, y, *half])


def _draw_boxes(ax: Axes, finds: list[_Find], station: Station) -> None:
    """Draw open boxes round the finds, so that a pixel-sized one cannot be overlooked."""
    corners = np.array([[-1, -1], [1, -1], [1, 1], [-1, 1]])
    for kind, colour in KINDS.items():
        of_kind = [find for find in finds if find.kind == kind][:BOXES_MAX]
        if not of_kind:
            continue
        boxes = np.array([_half_box(find, ax, station) for find in of_kind])
        ax.add_collection(
            PolyCollection(
                boxes[:, None, :2] + corners * boxes[:, None, 2:],
                facecolors="none",
                edgecolors=colour,
                linewidths=2.2 if kind == "missed" else 1.2,
                linestyles="dashed" if kind == "false" else "solid",
            ),
            autolim=False,
        )


def _name_boxes(ax: Axes, finds: list[_Find], station: Station) -> None:
    """Name finds as their details are named, beside their boxes where there is room."""
    box = ax.get_window_extent()
    px_per_mm = box.width / (station.shape[1] * station.camera.sampling_mm)
    taken: list[NDArray[np.float64]] = []
    for letter, find in zip(LETTERS, finds, strict=False):
        x, y, half_x, half_y = _half_box(find, ax, station) * px_per_mm
        beside, above = half_x + 9, half_y + 11
        places = [
            np.array([x + dx, y + dy])
            for dx, dy in ((beside, 0), (-beside, 0), (0, above), (0, -above), (0, 0))
        ]
        inside = np.array([box.width / 2 - 9, box.height / 2 - 10])
        if (inside < 20).any():  # too narrow for letters: they stand beside the part
            across = int(inside[1] < inside[0])
            far = np.array([x, y])
            far[across] = (box.width, box.height)[across] / 2 + (12, 14)[across]
            inside[across] = np.inf
            places = [far + step for step in np.eye(2)[across] * np.arange(0, 80, 16)[:, None]]
        place = next(
            (
                at
                for at in places
                if (np.abs(at) < inside).all()
                and all(np.abs(at - other).max() > 16 for other in taken)
            ),
            places[-1],
        )
        taken.append(place)
        _write_letter(ax, letter, place / px_per_mm, ax.transData, beside=not (inside < 1e6).all())


def _write_letter(
    ax: Axes, letter: str, place: Any, where: Transform, *, beside: bool = False
) -> None:
    """Name a find on the image, or beside it on the page."""
    ax.text(
        place[0],
        place[1],
        letter,
        transform=where,
        ha="center",
        va="center_baseline",
        fontsize=11,
        fontweight="bold",
        color="black" if beside else "white",
        path_effects=[] if beside else _halo(),
    )


def _halo() -> list[AbstractPathEffect]:
    return [withStroke(linewidth=2.5, foreground="black")]


def _draw_detail(ax: Axes, find: _Find, result: Inspected, codes: NDArray[np.uint8]) -> None:
    """Draw a find large, on a grey scale of its own, with zones and what is detected outlined."""
    station = result.station
    p = station.camera.sampling_mm
    x, y, half_x, half_y = _box_mm(find, station)
    rows, columns = station.shape
    half = min(max(1.5 * max(half_x, half_y), 8 * p), max(rows, columns) * p / 2)
    first_row = max(math.floor(rows / 2 - (y + half) / p), 0)
    last_row = math.ceil(rows / 2 - (y - half) / p)
    first_column = max(math.floor(columns / 2 + (x - half) / p), 0)
    last_column = math.ceil(columns / 2 + (x + half) / p)
    window = np.s_[first_row:last_row, first_column:last_column]
    aspect, labels, codes = result.aspect[window], result.labels[window], codes[window]
    factor = reduction(ax, aspect.shape)
    left, top = (first_column - columns / 2) * p, (rows / 2 - first_row) * p
    grey = pooled(aspect, factor, np.add)
    low, high = range_up_to(float(grey.max()), result, 0.05)
    right, bottom = left + grey.shape[1] * factor * p, top - grey.shape[0] * factor * p
    ax.imshow(
        grey,
        cmap=GREY,
        vmin=low,
        vmax=high,
        extent=(left, right, bottom, top),
        interpolation="nearest",
        aspect="auto",
    )
    outlines = [(codes == code, colour, 2.4) for code, colour in enumerate(KINDS.values(), 1)]
    for mask, colour, width in (*outlines, (labels != 0, "white", 1.2)):
        edges = _edges(pooled(mask, factor, np.maximum)) * factor * p
        ax.add_collection(
            LineCollection(
                [*(edges * [1, -1] + [left, top])],
                colors=colour,
                linewidths=width,
                capstyle="projecting",
            )
        )
    ax.set(xlim=(x - half, x + half), ylim=(y - half, y + half), xticks=[], yticks=[])
    for spine in ax.spines.values():
        spine.set(color=KINDS[find.kind], linewidth=3)
    scale_bar(ax, 16, 0.55)


def _edges(mask: NDArray[np.bool_]) -> NDArray[np.float64]:
    """Return the pixel edges round a mask, shape (n, 2 ends, (column, row))."""
    padded = np.pad(mask, 1)
    row, column = np.nonzero(padded[1:, 1:-1] != padded[:-1, 1:-1])
    flat = np.stack([np.stack([column, row], 1), np.stack([column + 1, row], 1)], 1)
    row, column = np.nonzero(padded[1:-1, 1:] != padded[1:-1, :-1])
    upright = np.stack([np.stack([column, row], 1), np.stack([column, row + 1], 1)], 1)
    return np.concatenate([flat, upright]).astype(np.float64)
