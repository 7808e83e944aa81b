"""The way through, in one place: from station and light map to blobs, classes and score."""

from __future__ import annotations

import math
import os
from collections.abc import Callable
from dataclasses import dataclass, field
from functools import cached_property
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from gpuspec.backends import BESIDE, Backend, DeviceInfo, Image, LightMap
from gpuspec.cautions import assumptions, cautions
from gpuspec.classification import DEFAULT_RULES, ClassRule, Confusion, classify, confusion
from gpuspec.devices import open_backend
from gpuspec.errors import StationError
from gpuspec.measures import Blobs, measure_blobs
from gpuspec.placement import MANY, asked_for
from gpuspec.relief import Relief
from gpuspec.scoring import Score, score
from gpuspec.segmentation import automatic_threshold, flawless_level, segment
from gpuspec.shown import array, object_of
from gpuspec.station import Station
from gpuspec.topography_file import size_mm
from gpuspec.truth import KnownDefect, Truth

# Host memory at the peak, per pixel: aspect, labels, truth and nearest (4 bytes each), masks, and
# the temporaries of threshold and labelling.
_BYTES_PER_PIXEL = 40
_SECONDS_PER_DEFECT = 3e-5  # placed and its zone worked out, on a core of a server CPU

Progress = Callable[[str], None]


@dataclass(frozen=True)
class Inspection:
    """What is found in an aspect image, simulated or real.

    Attributes
    ----------
    threshold : float
        Grey level above which a pixel is detected, DN.
    flawless_dn : float
        Median grey level of the part.
    labels : ndarray of int32, shape (M, N)
        Blobs, 0 elsewhere.
    blobs : Blobs
        Their measures.
    classes : ndarray of str, shape (n,)
        Class of each blob.
    """

    threshold: float
    flawless_dn: float
    labels: NDArray[np.int32]
    blobs: Blobs
    classes: NDArray[np.str_]

    def __repr__(self) -> str:
        return (
            f"Inspection({len(self.blobs)} blobs above {self.threshold:.1f} DN, flawless "
            f"{self.flawless_dn:.1f} DN; labels {array(self.labels)})"
        )


@dataclass(frozen=True)
class Result:
    """A simulated inspection: images, what was found in them, and how good that is.

    Attributes
    ----------
    station : Station
    info : DeviceInfo
        Backend, device, driver and version that made the images.
    aspect : ndarray of float32, shape (M, N)
        Aspect image, DN.
    lost : ndarray of uint8, shape (M, N)
        Why a pixel sees no light, index into ``backends.LOST``.
    truth : ndarray of int32, shape (M, N)
        Zones: 0 flawless, i the i-th of ``defects``.
    defects : tuple of KnownDefect
    inspection : Inspection
    score : Score
    confusion : Confusion
    light_map : LightMap
        For single images: ``result.light_map.image(k)``.
    relief : Relief
    warnings : tuple of str
        What to know before trusting the score, see :mod:`gpuspec.cautions`.
    """

    station: Station
    info: DeviceInfo
    aspect: Image
    lost: NDArray[np.uint8]
    truth: NDArray[np.int32]
    defects: tuple[KnownDefect, ...]
    inspection: Inspection
    score: Score
    confusion: Confusion
    light_map: LightMap = field(repr=False, compare=False)
    relief: Relief = field(repr=False, compare=False)
    warnings: tuple[str, ...] = ()

    def __repr__(self) -> str:
        parts = {
            "score": str(self.score),
            "aspect": array(self.aspect, "grey levels in DN"),
            "labels": array(self.labels, f"{len(self.blobs)} blobs above {self.threshold:.1f} DN"),
            "truth": array(self.truth, f"zones of {len(self.defects)} defects"),
            "lost": array(self.lost, "why a pixel sees no light"),
            "light_map": "on the device; image(k), fuse()",
        }
        if self.warnings:
            parts["warnings"] = f"{len(self.warnings)}, the first: {self.warnings[0]}"
        return object_of("Result", f"{self.station.file}, {self.info}", parts)

    @property
    def labels(self) -> NDArray[np.int32]:
        """Blobs as a label image, shape (M, N)."""
        return self.inspection.labels

    @property
    def blobs(self) -> Blobs:
        """Measures of the blobs."""
        return self.inspection.blobs

    @property
    def classes(self) -> NDArray[np.str_]:
        """Class of each blob."""
        return self.inspection.classes

    @property
    def threshold(self) -> float:
        """Grey level above which a pixel was detected, DN."""
        return self.inspection.threshold

    @property
    def flawless_dn(self) -> float:
        """Median grey level of the part, DN."""
        return self.inspection.flawless_dn

    @property
    def assumptions(self) -> tuple[str, ...]:
        """What is taken as ideal."""
        return assumptions(self.station)

    @cached_property
    def valid(self) -> NDArray[np.bool_]:
        """Pixels on the part, shape (M, N): the others are never scored."""
        on_part: NDArray[np.bool_] = self.lost != BESIDE
        return on_part

    def _repr_png_(self) -> bytes:
        """Show itself in a notebook: the detection over the truth."""
        from gpuspec.figures import detection_picture, png

        return png(detection_picture(self))


def simulate(
    station: Station | str | Path,
    backend: str | Backend = "auto",
    device: str | None = None,
    progress: Progress | None = None,
) -> Result:
    """Simulate an inspection station from part to score.

    Parameters
    ----------
    station : Station, str or Path
        Or the path of a station file.
    backend : str or Backend
        A name for :func:`gpuspec.devices.open_backend`, or an open backend.
    device : str, optional
        Part of the device's name, or its number.
    progress : callable, optional
        Told in a few words what is being done.

    Returns
    -------
    Result

    Raises
    ------
    StationError
        If the file cannot be read, a population does not fit, or the images exceed the memory.
    TopographyError
        If a topography cannot be used.
    BackendError
        If the backend is absent or fails.
    """
    return trace(Station.of(station), backend, device, progress).result(progress=progress)


@dataclass(frozen=True)
class Traced:
    """A station whose part is placed and whose light map is traced: all that geometry decides.

    Attributes
    ----------
    station : Station
    info : DeviceInfo
    relief : Relief
    truth : Truth
    light_map : LightMap
        On the device.
    lost : ndarray of uint8, shape (M, N)
        Why a pixel sees no light, index into ``backends.LOST``.
    """

    station: Station
    info: DeviceInfo
    relief: Relief
    truth: Truth
    light_map: LightMap
    lost: NDArray[np.uint8]

    def __repr__(self) -> str:
        return f"Traced({self.light_map!r}, {self.truth!r})"

    def result(self, light_map: LightMap | None = None, progress: Progress | None = None) -> Result:
        """Take the aspect image, segment and score it.

        Parameters
        ----------
        light_map : LightMap, optional
            The traced one with another light on it; None: the station's own.
        progress : callable, optional
            Told in a few words what is being done.
        """
        tell = progress or (lambda _: None)
        light_map = light_map or self.light_map
        station, truth, valid = self.station, self.truth, self.lost != BESIDE
        tell("taking the aspect image")
        aspect = light_map.aspect()
        tell("segmenting and scoring")
        found = inspect(aspect, valid, station, self.lost == 0)
        scored = score(found.labels, truth.labels, valid, len(truth.defects))
        kinds = [defect.kind for defect in truth.defects]
        table = confusion(kinds, truth.labels, found.labels, found.classes)
        return Result(
            station, self.info, aspect, self.lost, truth.labels, truth.defects, found, scored,
            table, light_map, self.relief,
            cautions(
                station, self.relief, truth, self.lost, light_map, aspect, found.labels,
                found.threshold, scored,
            ),
        )  # fmt: skip


def trace(
    station: Station,
    backend: str | Backend = "auto",
    device: str | None = None,
    progress: Progress | None = None,
) -> Traced:
    """Place a station's defects and trace it; parameters and errors as :func:`simulate`."""
    tell = progress or (lambda _: None)
    check_memory(station)
    tell(_placing(station))
    relief = Relief.of(station, tell)
    if len(relief.defects) >= MANY:
        tell(f"working out the zones of {len(relief.defects):,} defects")
    truth = Truth.of(station, relief)
    tell("opening the device")
    engine = open_backend(backend, device) if isinstance(backend, str) else backend
    tell(f"tracing on {engine.info.device}")
    light_map = engine.trace(station, relief)
    return Traced(station, engine.info, relief, truth, light_map, light_map.lost())


def _placing(station: Station) -> str:
    """Say how many defects are placed where they are many, and how long that takes."""
    count = asked_for(station)
    if count < MANY:
        return "placing defects"
    seconds = count * _SECONDS_PER_DEFECT
    return f"placing {count:,} defects" + (f", about {seconds:.0f} s" if seconds > 2 else "")


def inspect(
    aspect: Image,
    valid: NDArray[np.bool_],
    station: Station,
    lit: NDArray[np.bool_] | None = None,
) -> Inspection:
    """Segment, measure and classify an aspect image, simulated or real.

    Parameters
    ----------
    aspect : ndarray of float32, shape (M, N)
        Grey levels in DN.
    valid : ndarray of bool, shape (M, N)
        Pixels on the part.
    station : Station
        Its threshold, size filter, classes, sampling and full scale are used.
    lit : ndarray of bool, shape (M, N), optional
        Pixels known to see the light, from which the flawless level and the automatic threshold
        are taken; None, or none at all: the valid ones.

    Returns
    -------
    Inspection
    """
    if not valid.any():
        raise StationError(
            f"{station.file}: no pixel of the image sees the part; check part.length_mm, "
            f"part.width_mm and camera.sampling_mm."
        )
    rule = station.segmentation
    sampling = station.camera.sampling_mm
    if lit is None or not lit.any():
        lit = valid
    level = flawless_level(aspect, lit)
    threshold = (
        automatic_threshold(
            aspect,
            lit,
            full_scale_dn=station.sensor.full_scale_dn,
            images=station.sequence.images,
        )
        if rule.threshold == "auto"
        else float(rule.threshold)
    )
    labels = segment(
        aspect, valid, threshold, min_area_px=math.ceil(rule.min_area_mm2 / sampling**2 - 1e-9)
    )
    blobs = measure_blobs(labels, aspect, sampling_mm=sampling, flawless_dn=level)
    return Inspection(threshold, level, labels, blobs, classify(blobs, class_rules(station)))


def class_rules(station: Station) -> tuple[ClassRule, ...]:
    """Return the station's class rules, or the default ones if it has none."""
    if not station.classes:
        return tuple(DEFAULT_RULES)
    return tuple(
        ClassRule(
            rule.name,
            (rule.area_min_mm2, rule.area_max_mm2),
            (rule.weight_min_dn, rule.weight_max_dn),
            (rule.elongation_min, rule.elongation_max),
        )
        for rule in station.classes
    )


def check_memory(station: Station) -> None:
    """Refuse an image that the host's memory cannot hold, before any work.

    Raises
    ------
    StationError
        With the sampling that would fit.
    TopographyError
        If the map that gives the part its size cannot be read.
    """
    relief = station.part.relief
    if relief and station.sides_of_map:  # a size that no map gave would be refused in its place
        size_mm(relief, station.locate(relief.file), station.file)
    rows, columns = station.shape
    needed = rows * columns * _BYTES_PER_PIXEL
    available = _available_bytes()
    if needed > available:
        camera = station.camera
        if camera.columns or camera.rows:
            way = "set smaller camera.columns and camera.rows"
        else:
            fits = _two_digits_up(camera.sampling_mm * math.sqrt(needed / available) * 1.001)
            way = f"{fits:g} or more fits, or set camera.columns and camera.rows to see a piece"
        raise StationError(
            f"{station.file}: camera.sampling_mm = {camera.sampling_mm:g} makes an image "
            f"of {columns} x {rows} pixels, which needs {needed / 2**30:.1f} GiB of memory while "
            f"{available / 2**30:.1f} GiB are free; {way}."
        )


def _two_digits_up(value: float) -> float:
    exponent = 1 - math.floor(math.log10(value))
    return math.ceil(value * 10.0**exponent) / 10.0**exponent


def _available_bytes() -> int:
    try:
        with open("/proc/meminfo", encoding="ascii") as lines:  # noqa: PTH123
            for line in lines:
                if line.startswith("MemAvailable"):
                    return int(line.split()[1]) * 1024
        return os.sysconf("SC_PAGE_SIZE") * os.sysconf("SC_PHYS_PAGES")
    except (OSError, ValueError, AttributeError):
        return 2**63
