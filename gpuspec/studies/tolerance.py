"""Tolerance of a chosen design to the part's pose, to heights and to reflectivity.

One thing at a time is moved away from what the design was chosen for. The threshold is the
design's own, taken once at nominal and held; the part keeps its defects.

What can move stands in `gpuspec.studies.movements`. What the station's own ``[tolerance]`` says may
be off is tried last: each key at both ends, and all at once, as a sweep's robust choice tries it.
"""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any, ClassVar

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.lines import Line2D
from numpy.typing import NDArray

from gpuspec import words
from gpuspec.arrays import BESIDE, Mask
from gpuspec.detection.score import Score
from gpuspec.errors import StationError
from gpuspec.light.backend import Backend
from gpuspec.light.devices import open_backend
from gpuspec.pictures.page import MARGIN, SKY, VERMILION, WIDTH, Sheet, essentials
from gpuspec.pictures.place import open_frame
from gpuspec.simulation.at_threshold import AtThreshold
from gpuspec.simulation.light_map import Progress
from gpuspec.simulation.simulate import Traced, trace
from gpuspec.station.corners import corners, stated
from gpuspec.station.materials import MATERIALS, reflectance
from gpuspec.station.station import Station
from gpuspec.studies.movements import frozen, movements
from gpuspec.studies.outcome import GREY, Outcome
from gpuspec.words import plural

Array = NDArray[np.float64]


OFF = "within [tolerance]"
"""What is tried of the station's own table."""

_LABELS_MAX = 10
"""Of what is off; of more rows some are labelled."""


@dataclass(frozen=True)
class Perturbation:
    """One thing moved away from nominal, and the score at each value of it.

    Attributes
    ----------
    name, unit : str
        What is moved, and in which unit; materials have none.
    values : tuple of float, or of str
        How far.
    nominal : int
        Which of them is nominal: 0, or the station's own material.
    scores : tuple of Score
        One for each value.
    seen : tuple of AtThreshold
        Likewise: hits, false blobs beyond the guard bands, and levels.
    """

    name: str
    unit: str
    values: tuple[float, ...] | tuple[str, ...]
    nominal: int
    scores: tuple[Score, ...]
    seen: tuple[AtThreshold, ...]

    def __repr__(self) -> str:
        unit = f" {self.unit}" if self.unit else ""
        return f"Perturbation({self.name}: {len(self.values)} values{unit})"

    @property
    def p1(self) -> Array:
        """Precision P1, shape (n,)."""
        return np.array([found.p1 for found in self.scores])

    @property
    def p2(self) -> Array:
        """Recall P2, shape (n,); NaN where no zone is seen."""
        return np.array([math.nan if s.p2 is None else s.p2 for s in self.scores])

    @property
    def hit(self) -> Array:
        """Share of the defects hit, shape (n,)."""
        return np.array([found.defects_hit / found.defects for found in self.scores])

    @property
    def margin_dn(self) -> Array:
        """Level of the faintest defect less the highest of what is flawless, shape (n,)."""
        return np.array([one.margin_dn for one in self.seen])

    @property
    def keeps(self) -> Mask:
        """Where all is hit that is hit at nominal, and nothing is false, shape (n,)."""
        hits = self.scores[self.nominal].defects_hit
        return np.array([s.defects_hit >= hits and not one.false_blobs
                         for s, one in zip(self.scores, self.seen, strict=True)])  # fmt: skip

    @property
    def kept(self) -> tuple[int, int] | None:
        """First and last value around nominal up to which nothing is lost; None: not even there."""
        lost = np.flatnonzero(~self.keeps)
        first = int(lost[lost <= self.nominal].max(initial=-1)) + 1
        last = int(lost[lost >= self.nominal].min(initial=len(self.values))) - 1
        return (first, last) if first <= last else None

    def where(self, index: int) -> str:
        """Return one of the values with its unit."""
        value = self.values[index]
        return value if isinstance(value, str) else f"{value:+.3g} {self.unit}"

    def worst(self, quality: Array, digits: int = 3) -> str:
        """Return the least of a quality, and where it is.

        Parameters
        ----------
        quality : ndarray, shape (values,)
        digits : int
            After the point.
        """
        index = int(np.nanargmin(quality))
        return f"{quality[index]:.{digits}f} ({self.where(index)})"

    @property
    def reach(self) -> str:
        """How far it moves without loss, in one clause."""
        if self.kept is None:
            return "with a false blob already at nominal"
        if self.unit:
            ends = self.kept
            return f"nothing lost from {self.where(ends[0])} to {self.where(ends[1])}"
        return f"nothing lost at {np.count_nonzero(self.keeps)} of {len(self.values)}"


@dataclass(frozen=True, repr=False)
class Tolerance(Outcome):
    """How a design's score holds when what it was chosen for changes.

    Attributes
    ----------
    station : Station
        The design, its populations placed and its threshold resolved.
    nominal : Score
    perturbations : tuple of Perturbation
    """

    name: ClassVar[str] = "tolerance"

    nominal: Score
    perturbations: tuple[Perturbation, ...]

    @property
    def off(self) -> Perturbation | None:
        """What the station's ``[tolerance]`` says may be off; None without one."""
        return next((p for p in self.perturbations if p.name == OFF), None)

    @property
    def threshold_dn(self) -> float:
        """Grey level held throughout."""
        return float(self.station.segmentation.threshold)

    def numbers(self) -> dict[str, Any]:
        """See :meth:`Outcome.numbers`."""
        least = {
            p.name: {
                "p1": float(p.p1.min()),
                "p2": float(np.nanmin(p.p2)),
                "defects_hit": min(found.defects_hit for found in p.scores),
            }
            for p in self.perturbations
        }
        kept = {p.name: None if p.kept is None else [p.values[end] for end in p.kept]
                for p in self.perturbations if p.unit}  # fmt: skip
        found = {
            "threshold_dn": self.threshold_dn,
            "nominal": self.nominal.as_dict(),
            "least": least,
            "nothing_lost_between": kept,
        }
        if self.off is None:
            return found
        rooms = [one.room_dn(self.threshold_dn) for one in self.off.seen]
        return found | {
            "within_tolerance": {
                "tolerance": dict(stated(self.station)),
                "keeps_all": bool(self.off.keeps.all()),
                "defects_hit": least[OFF]["defects_hit"],
                "false_blobs": max(one.false_blobs for one in self.off.seen),
                "margin_dn": float(self.off.margin_dn.min()),
                "room_dn": min(rooms),
            }
        }

    def findings(self) -> tuple[str, ...]:
        """See :meth:`Outcome.findings`."""
        nominal = self.nominal
        said = [
            f"Nominal: {words.P1} {nominal.p1:.3f}, {words.P2} {nominal.p2:.3f} ({words.BEST}), "
            f"{nominal.defects_hit} of {nominal.defects} defects hit, at the threshold of "
            f"{self.threshold_dn:.5g} DN that is held."
        ]
        for p in self.perturbations:
            fewest = min(found.defects_hit for found in p.scores)
            values = p.values
            span = "" if not p.unit else f" from {values[0]:+.3g} to {values[-1]:+.3g} {p.unit}"
            said.append(
                f"{p.name.capitalize()}{span}: P1 at least {p.worst(p.p1)}, P2 at least "
                f"{p.worst(p.p2)}, at least {fewest} of {nominal.defects} defects hit; {p.reach}."
            )
        return (*said, self._verdict(self.off)) if self.off else tuple(said)

    def _verdict(self, off: Perturbation) -> str:
        """Say in one line whether what the station says may be off loses anything."""
        rooms = [one.room_dn(self.threshold_dn) for one in off.seen]
        halves = ", ".join(f"{key} +- {half:g}" for key, half in stated(self.station).items())
        blobs = plural(max(one.false_blobs for one in off.seen), "false blob")
        fewest, least = min(s.defects_hit for s in off.scores), int(np.argmin(rooms))
        return (
            f"Ends, corners and designs between of [tolerance] ({halves}) keep all hits and no "
            f"false blob: {'yes' if off.keeps.all() else 'no'}; at the worst {fewest} of "
            f"{self.nominal.defects} defects hit, {blobs}, a margin of {off.margin_dn.min():.2f} "
            f"DN, and {rooms[least]:.2f} DN of room at the held threshold ({off.where(least)})."
        )

    def table(self) -> tuple[tuple[str, ...], list[tuple[Any, ...]]]:
        """See :meth:`Outcome.table`."""
        heads = ("perturbation", "value", "unit", "p1", "p2", "f1", "defects_hit", "defects",
                 "false_blobs", "false_blobs_beyond_guard", "margin_dn", "room_dn")  # fmt: skip
        rows = [
            (
                p.name,
                value,
                p.unit,
                s.p1,
                s.p2,
                s.f1,
                s.defects_hit,
                s.defects,
                s.false_blobs,
                one.false_blobs,
                one.margin_dn,
                one.room_dn(self.threshold_dn),
            )
            for p in self.perturbations
            for value, s, one in zip(p.values, p.scores, p.seen, strict=True)
        ]
        return heads, rows

    def figure(self) -> Figure:
        """See :meth:`Outcome.figure`."""
        return tolerance_picture(self)


def study(
    station: Station,
    *,
    offset_mm: float = 1.0,
    rotation_rad: float = 0.05,
    tilt_rad: float = 0.005,
    camera_tilt_rad: float | None = None,
    height_mm: float = 5.0,
    reflectivity: float = 0.3,
    steps: int = 7,
    backend: str | Backend = "auto",
    device: str | None = None,
    progress: Progress | None = None,
) -> Tolerance:
    """Score a design while pose, heights and reflectivity move away from nominal.

    What its ``[tolerance]`` says may be off is tried, too: each key at both ends, and all at once.

    Parameters
    ----------
    station : Station
        The design, e.g. the best of a sweep.
    offset_mm : float
        The part is moved so far aside along x and y, and up and down.
    rotation_rad : float
        The part is turned so far about z.
    tilt_rad : float
        Part and camera are tilted so far about x and y, the camera about its pupil.
    camera_tilt_rad : float, optional
        The camera, if another way: its view soon leaves the part. None: as the part.
    height_mm : float
        Tunnel and camera are moved so far up and down.
    reflectivity : float
        Its relative change, which is that of the exposure. Every material is tried, too.
    steps : int
        Values tried of each, nominal in the middle; odd.
    backend, device, progress
        As for :func:`gpuspec.simulate`.

    Returns
    -------
    Tolerance

    Raises
    ------
    StationError
        If the part has no defect in view, so that P2 is undefined, the design detects none, a
        value or a moved station is impossible, or ``[tolerance]`` names what is no number.
    BackendError
        If the backend is absent or fails.

    Examples
    --------
    >>> station = gpuspec.example("trim").replace(camera__sampling_mm=0.5)
    >>> found = gpuspec.study("tolerance", station, steps=3)
    >>> print(found.findings()[0])
    Nominal: precision P1 (overdetection) 0.240, recall P2 (misdetection) 1.000 (1 is best),
        33 of 36 defects hit, at the threshold of 93.625 DN that is held.
    """
    camera_tilt_rad = tilt_rad if camera_tilt_rad is None else camera_tilt_rad
    _check(offset_mm, rotation_rad, tilt_rad, camera_tilt_rad, height_mm, reflectivity, steps)
    halves = stated(station)
    some = corners(station, halves) if halves else []
    engine = open_backend(backend, device)
    tell = progress or (lambda _: None)
    design, nominal, traced, notes = _nominal(station, engine, tell)
    middle = steps // 2
    spread = np.linspace(-1, 1, steps)
    reach = {
        "offset": offset_mm, "rotation": rotation_rad, "tilt": tilt_rad,
        "camera tilt": camera_tilt_rad, "height": height_mm,
    }  # fmt: skip
    found = []
    for name, unit, kind, moved in movements():
        tell(f"moving the {name}")
        values = (reach[kind] * spread).tolist()
        looks = []
        for value in values:
            try:
                looks.append(_look(moved(design, value), engine))
            except StationError as error:
                raise StationError(f"{name} by {value:+.3g} {unit} is too far: {error}") from None
        found.append(Perturbation(name, unit, tuple(values), middle, *_apart(looks)))
    tell("changing reflectivity")
    values = (reflectivity * spread).tolist()
    # Exposure and reflectivity are one factor of the signal: the light map stays as it is.
    exposures = [design.sensor.exposure * (1 + value) for value in values]
    lit = [design.replace(**{"sensor.exposure": e}) for e in exposures]
    looks = [(traced.light_map.score(one), AtThreshold.of(traced, one)) for one in lit]
    percents = tuple(100 * value for value in values)
    found.append(Perturbation("reflectivity", "%", percents, middle, *_apart(looks)))
    tell("changing material")
    part, light = design.part, design.tunnel.wavelength_nm
    names = tuple(m for m in MATERIALS if m == "ideal" or part.diffuse + reflectance(m, light) <= 1)
    looks = [_look(design.replace(**{"part.material": m}), engine) for m in names]
    own = names.index(design.part.material)
    found.append(Perturbation("material", "", names, own, *_apart(looks)))
    if halves:
        tell("trying what [tolerance] says may be off")
        level = {"segmentation.threshold": design.segmentation.threshold}
        # Of the station as it is written: its keys may be those of a population.
        looks = [_look(station.replace(**off, **level), engine) for off in [{}, *some]]
        names = ("nominal", *(_named(off) for off in some))
        found.append(Perturbation(OFF, "", names, 0, *_apart(looks)))
    return Tolerance(design, engine.info, nominal, tuple(found), notes=notes)


def _look(station: Station, engine: Backend) -> tuple[Score, AtThreshold]:
    """Score a station at its threshold, and count what it leaves beyond the guard bands."""
    traced = trace(station, engine)
    looked = traced.light_map.score(), AtThreshold.of(traced, station)
    traced.light_map.release()
    return looked


def _apart(
    looks: list[tuple[Score, AtThreshold]],
) -> tuple[tuple[Score, ...], tuple[AtThreshold, ...]]:
    return tuple(score for score, _ in looks), tuple(seen for _, seen in looks)


def _named(off: Mapping[str, float]) -> str:
    """Return what is off in few words."""
    return ", ".join(f"{key.rpartition('.')[2]} {value:.6g}" for key, value in off.items())


def _nominal(
    station: Station, engine: Backend, tell: Progress
) -> tuple[Station, Score, Traced, tuple[str, ...]]:
    """Return the design, its part and its threshold fixed, its score, it traced, and its notes."""
    tell("placing defects")
    design = frozen(station)
    traced = trace(design, engine, progress=tell)
    if not traced.truth.labels[traced.lost != BESIDE].any():
        raise StationError(
            f"{station.file} has no defect in view, so that P2 is undefined; add [[defects]] or "
            f"[[populations]]."
        )
    result = traced.result()
    threshold = result.threshold
    if threshold >= design.sensor.full_scale_dn:
        why = next((note for note in result.warnings if "beyond full scale" in note), "")
        raise StationError(
            f"{station.file}: {why or 'the image is dark, and nothing is detected.'}"
        )
    design = design.replace(**{"segmentation.threshold": threshold})
    nominal = traced.light_map.score(design)
    if not nominal.hit_px:
        raise StationError(
            f"{station.file} detects no defect at its threshold of {threshold:.5g} DN: there is "
            f"nothing to lose; choose a design that works, e.g. by `gpuspec sweep`."
        )
    return design, nominal, traced, result.warnings


def _check(
    offset: float, rotation: float, tilt: float, camera_tilt: float, height: float,
    reflectivity: float, steps: int,
) -> None:  # fmt: skip
    for name, value, largest in (
        ("offset_mm", offset, 1e3), ("rotation_rad", rotation, math.pi), ("tilt_rad", tilt, 1.0),
        ("camera_tilt_rad", camera_tilt, 1.0), ("height_mm", height, 1e4),
        ("reflectivity", reflectivity, 0.99),
    ):  # fmt: skip
        if not 0 < value <= largest:
            raise StationError(
                f"{name} = {value:g} must be greater than 0 and at most {largest:.3g}."
            )
    if steps < 3 or steps % 2 == 0:
        raise StationError(f"steps = {steps} must be odd, so that nominal is among them, and >= 3.")


def tolerance_picture(found: Tolerance) -> Figure:
    """Draw P1, P2 and the share of defects hit, a panel for each perturbation."""
    columns, width, height, pitch = 4, 285, 250, 370
    rows = math.ceil(len(found.perturbations) / columns)
    sheet = Sheet(WIDTH, 160 + rows * pitch)
    nominal = found.nominal
    sheet.heading(
        f"Tolerance at the fixed threshold of {found.threshold_dn:.5g} DN: nominally "
        f"P1 {nominal.p1:.3f}, P2 {nominal.p2:.3f}, {nominal.defects_hit} of {nominal.defects} "
        f"defects hit ({words.BEST})",
        essentials(found.station),
        str(found.info),
    )
    for number, perturbation in enumerate(found.perturbations):
        row, column = divmod(number, columns)
        ax = sheet.axes(MARGIN + column * (width + 56), 150 + row * pitch, width, height)
        curves = _draw_perturbation(ax, perturbation)
        if column:
            ax.set_ylabel("")
    sheet.legend(curves, 100)
    return sheet.figure


def _draw_perturbation(ax: Axes, moved: Perturbation) -> list[Line2D]:
    """Draw one perturbation's scores; return its curves for the legend."""
    names = [str(value) for value in moved.values]
    x = np.array(moved.values, np.float64) if moved.unit else np.arange(len(names))
    open_frame(ax, f"{moved.name}, {moved.unit}" if moved.unit else moved.name,
               f"share; {words.BEST}")  # fmt: skip
    style: dict[str, Any] = {"markersize": 5, "linestyle": "-" if moved.unit else "none"}
    drawn = [
        *ax.plot(x, moved.p1, marker="o", color="black", label=words.P1, **style),
        *ax.plot(x, moved.p2, marker="s", color=VERMILION, label=words.P2, **style),
        *ax.plot(x, moved.hit, marker="^", color=SKY, label="defects hit", **style),
        ax.axvline(x[moved.nominal], color=GREY, linestyle=":", label="nominal"),
    ]
    if not moved.unit:
        if moved.name == OFF:  # numbered as in the table: the names are too long for an axis
            names = [str(row) for row in range(len(names))]
            every = math.ceil(len(names) / _LABELS_MAX)
            ax.set_xticks(x[::every], names[::every], fontsize=9)
            ax.set_xlabel(f"{moved.name}, row of the table; 0 nominal")
        else:
            ax.set_xticks(x, names, rotation=60, ha="right", fontsize=9)
    ax.set_ylim(-0.03, 1.05)
    return drawn
