"""Tolerance of a chosen design to the part's pose, to heights and to reflectivity.

One thing at a time is moved away from what the design was chosen for. The threshold is the
design's own, taken once at nominal and held; the part keeps its defects.

What can move, and what the model cannot say, stands in `gpuspec.studies.movements`.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Any, ClassVar

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.lines import Line2D
from numpy.typing import NDArray

from gpuspec import words
from gpuspec.arrays import BESIDE
from gpuspec.detection.score import Score
from gpuspec.errors import StationError
from gpuspec.light.backend import Backend, DeviceInfo
from gpuspec.light.devices import open_backend
from gpuspec.pictures.page import MARGIN, SKY, VERMILION, WIDTH, Sheet, essentials
from gpuspec.pictures.place import open_frame
from gpuspec.simulation.light_map import Progress
from gpuspec.simulation.simulate import Traced, trace
from gpuspec.station.materials import MATERIALS
from gpuspec.station.station import Station
from gpuspec.studies.movements import frozen, movements
from gpuspec.studies.outcome import GREY, Outcome

Array = NDArray[np.float64]


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
    """

    name: str
    unit: str
    values: tuple[float, ...] | tuple[str, ...]
    nominal: int
    scores: tuple[Score, ...]

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

    def worst(self, quality: Array) -> str:
        """Return the least of a quality, and where it is."""
        index = int(np.nanargmin(quality))
        value = self.values[index]
        where = value if isinstance(value, str) else f"{value:+.3g} {self.unit}"
        return f"{quality[index]:.3f} ({where})"


@dataclass(frozen=True, repr=False)
class Tolerance(Outcome):
    """How a design's score holds when what it was chosen for changes.

    Attributes
    ----------
    station : Station
        The design, its populations placed and its threshold resolved.
    info : DeviceInfo
    nominal : Score
    perturbations : tuple of Perturbation
    notes : tuple of str
        What is wrong with the station, see :mod:`gpuspec.simulation.cautions`.
    """

    name: ClassVar[str] = "tolerance"

    station: Station
    info: DeviceInfo
    nominal: Score
    perturbations: tuple[Perturbation, ...]
    notes: tuple[str, ...] = ()

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
        return {
            "threshold_dn": self.threshold_dn,
            "nominal": self.nominal.as_dict(),
            "least": least,
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
                f"{p.worst(p.p2)}, at least {fewest} of {nominal.defects} defects hit."
            )
        return tuple(said)

    def table(self) -> tuple[tuple[str, ...], list[tuple[Any, ...]]]:
        """See :meth:`Outcome.table`."""
        heads = ("perturbation", "value", "unit", "p1", "p2", "f1", "defects_hit", "defects",
                 "false_blobs")  # fmt: skip
        rows = [
            (p.name, value, p.unit, s.p1, s.p2, s.f1, s.defects_hit, s.defects, s.false_blobs)
            for p in self.perturbations
            for value, s in zip(p.values, p.scores, strict=True)
        ]
        return heads, rows

    def figure(self) -> Figure:
        """See :meth:`Outcome.figure`."""
        pass

        return tolerance_picture(self)


def study(
    station: Station,
    *,
    offset_mm: float = 1.0,
    rotation_rad: float = 0.05,
    height_mm: float = 5.0,
    reflectivity: float = 0.3,
    steps: int = 7,
    backend: str | Backend = "auto",
    device: str | None = None,
    progress: Progress | None = None,
) -> Tolerance:
    """Score a design while pose, heights and reflectivity move away from nominal.

    Parameters
    ----------
    station : Station
        The design, e.g. the best of a sweep.
    offset_mm : float
        The part is moved so far aside along x and y, and up and down.
    rotation_rad : float
        The part is turned so far about z.
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
        If the part has no defect in view, so that P2 is undefined, the design detects none, or a
        value or a moved station is impossible.
    BackendError
        If the backend is absent or fails.

    Examples
    --------
    >>> from gpuspec.studies import tolerance
    >>> station = gpuspec.example("trim").replace(camera__sampling_mm=0.5)
    >>> found = tolerance.study(station, steps=3)
    >>> print(found.findings()[0])
    Nominal: precision P1 (overdetection) 0.280, recall P2 (misdetection) 0.897 (1 is best),
        33 of 36 defects hit, at the threshold of 99.5 DN that is held.
    """
    _check(offset_mm, rotation_rad, height_mm, reflectivity, steps)
    engine = open_backend(backend, device)
    tell = progress or (lambda _: None)
    design, nominal, traced, notes = _nominal(station, engine, tell)
    middle = steps // 2
    spread = np.linspace(-1, 1, steps)
    reach = {"offset": offset_mm, "rotation": rotation_rad, "height": height_mm}
    found = []
    for name, unit, kind, moved in movements(design):
        tell(f"moving the {name}")
        values = (reach[kind] * spread).tolist()
        scores = []
        for value in values:
            try:
                scores.append(trace(moved(design, value), engine).light_map.score())
            except StationError as error:
                raise StationError(f"{name} by {value:+.3g} {unit} is too far: {error}") from None
        found.append(Perturbation(name, unit, tuple(values), middle, tuple(scores)))
    tell("changing reflectivity")
    values = (reflectivity * spread).tolist()
    # Exposure and reflectivity are one factor of the signal: the light map stays as it is.
    exposures = [design.sensor.exposure * (1 + value) for value in values]
    scores = [traced.light_map.score(design.replace(**{"sensor.exposure": e})) for e in exposures]
    percents = tuple(100 * value for value in values)
    found.append(Perturbation("reflectivity", "%", percents, middle, tuple(scores)))
    tell("changing material")
    names = tuple(MATERIALS)
    scores = [
        trace(design.replace(**{"part.material": m}), engine).light_map.score() for m in names
    ]
    own = names.index(design.part.material)
    found.append(Perturbation("material", "", names, own, tuple(scores)))
    return Tolerance(design, engine.info, nominal, tuple(found), notes)


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


def _check(offset: float, rotation: float, height: float, reflectivity: float, steps: int) -> None:
    for name, value, largest in (
        ("offset_mm", offset, 1e3), ("rotation_rad", rotation, math.pi),
        ("height_mm", height, 1e4), ("reflectivity", reflectivity, 0.99),
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
        ax.set_xticks(x, names, rotation=60, ha="right", fontsize=9)
    ax.set_ylim(-0.03, 1.05)
    return drawn
