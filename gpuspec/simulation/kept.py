"""A run's folder read back to a result."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any, get_args

import numpy as np
from numpy.typing import NDArray

from gpuspec.arrays import BESIDE, LOST
from gpuspec.detection.classes import classify, confusion
from gpuspec.detection.inspection import Inspection, Rule, class_rules
from gpuspec.detection.measures import measure_blobs
from gpuspec.detection.score import score
from gpuspec.detection.segmentation import Ceiling
from gpuspec.errors import GpuspecError, OutputError
from gpuspec.files import changed
from gpuspec.light.backend import DeviceInfo
from gpuspec.light.patterns import Pattern
from gpuspec.light.refinement import CUTS, counted, name_of
from gpuspec.part.relief import Relief
from gpuspec.part.truth import Truth
from gpuspec.report.folder import ARRAYS, KIND, PATTERN
from gpuspec.simulation.light_map import ScoredLightMap
from gpuspec.simulation.result import Result
from gpuspec.station.station import Station

_TYPES = {"aspect": np.float32, "labels": np.int32, "truth": np.int32, "lost": np.uint8}
_NEEDED = ("score.json", "station.toml", *(f"{name}.tif" for name in ARRAYS))


def read(folder: Path) -> Result:
    """Return the result whose files a folder holds.

    Images, threshold, notes and what made them are as they were written; blobs, classes and score
    are measured on those images, and the score must be the one that was written. Nothing is traced.

    Parameters
    ----------
    folder : Path
        Of ``gpuspec simulate`` or :meth:`gpuspec.simulation.result.Result.save`.

    Raises
    ------
    OutputError
        If it holds no whole run, or a file is damaged or was changed since it was written.
    """
    missing = [name for name in _NEEDED if not (folder / name).is_file()]
    if len(missing) == len(_NEEDED):
        raise OutputError(
            f"{folder} holds no run; result.save(folder) or `gpuspec simulate STATION -o {folder}` "
            f"writes one."
        )
    if missing:
        raise OutputError(
            f"{folder} holds no whole run: {missing[0]} is not there; simulate the station again."
        )
    for name in changed(folder, KIND, (*_NEEDED, PATTERN)):
        raise _damage(folder / name, "it was changed since gpuspec wrote it")
    said = _summary(folder / "score.json")
    try:
        return _result(folder, said)
    except (KeyError, TypeError, ValueError, AttributeError) as error:
        raise _damage(folder / "score.json", f"it is not that of this run ({error})") from None


def _result(folder: Path, said: dict[str, Any]) -> Result:
    station = _station(folder, str(said["station"]))
    for name in changed(folder, KIND, station.files):
        raise _damage(folder / name, "it was changed since gpuspec wrote it")
    info = DeviceInfo(*(str(said[name]) for name in ("backend", "device", "driver", "version")))
    pattern = None
    if said["pattern"]:
        pattern = Pattern.parse((folder / PATTERN).read_text("utf-8"), said["pattern"])
    relief = Relief.of(station)
    defects = Truth.of(station, relief).defects
    aspect, labels, zones, lost = (_image(folder, name, station) for name in ARRAYS)
    if lost.max(initial=0) >= len(LOST):
        raise _damage(folder / "lost.tif", f"it holds the code {lost.max()}")
    threshold, flawless = float(said["threshold_dn"]), float(said["flawless_dn"])
    blobs = measure_blobs(
        labels, aspect, sampling_mm=station.camera.sampling_mm, flawless_dn=flawless
    )
    found = Inspection(
        threshold, flawless, labels, blobs, classify(blobs, class_rules(station)), *_rule(said)
    )
    scored = score(labels, zones, lost != BESIDE, len(defects))
    if json.loads(json.dumps(scored.as_dict())) != said["score"]:
        raise ValueError("its score is not that of the images beside it")
    table = confusion([defect.kind for defect in defects], zones, labels, found.classes)
    truth = Truth(zones, defects)
    told = {**counted({}), **said["refined"]}  # one of an earlier version knew fewer ways
    refined = {cut: int(told[name_of(cut)]) for cut in CUTS}
    if counted(refined) != told:
        raise ValueError("its numbers of refined pixels do not add up")
    light_map = ScoredLightMap(
        station, info, relief, truth, lost, pattern=pattern,
        refined={cut: pixels for cut, pixels in refined.items() if pixels},
    )  # fmt: skip
    return Result(
        station, info, aspect, lost, zones, defects, found, scored, table, light_map, relief,
        tuple(map(str, said["warnings"])),
    )  # fmt: skip


def _rule(said: dict[str, Any]) -> tuple[Rule, Ceiling | None, str]:
    """Return how the threshold came about; of earlier versions' runs from the spread, or stated."""
    rule = said.get("threshold_rule", "spread")
    if rule not in get_args(Rule):
        raise ValueError(f"there is no rule {rule!r} for a threshold")
    level = said.get("ceiling_dn")
    ceiling = None if level is None else Ceiling(float(level), float(said["ceiling_noise_dn"]))
    why = str(said.get("threshold_said", "")).partition("spread: ")[2] if rule == "spread" else ""
    return rule, ceiling, why


def _summary(path: Path) -> dict[str, Any]:
    try:
        found = json.loads(path.read_text("utf-8"))
    except (OSError, ValueError, RecursionError) as error:
        raise _damage(path, str(error)) from None
    if not isinstance(found, dict):
        raise _damage(path, "it is no table")
    return found


def _station(folder: Path, file: str) -> Station:
    path = folder / "station.toml"
    try:
        return Station.parse(path.read_text("utf-8"), file, folder.resolve())
    except (OSError, UnicodeDecodeError, GpuspecError) as error:
        raise _damage(path, str(error)) from None


def _image(folder: Path, name: str, station: Station) -> NDArray[Any]:
    import tifffile

    path = folder / f"{name}.tif"
    try:
        image: NDArray[Any] = tifffile.imread(path)
    except Exception as error:  # a damaged file fails in as many ways as it has bytes
        raise _damage(path, str(error)) from None
    if image.shape != station.shape or image.dtype != _TYPES[name]:
        raise _damage(path, f"it is {image.dtype} of {image.shape}, the station's {station.shape}")
    return image


def _damage(path: Path, why: str) -> OutputError:
    return OutputError(f"{path} cannot be read back: {why}; simulate the station again.")
