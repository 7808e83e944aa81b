"""One part of a data set: its images, the masks of its defects, and what is known of each."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from gpuspec.arrays import BESIDE, Image
from gpuspec.datasets.draws import Value
from gpuspec.datasets.plan import DataSetPlan
from gpuspec.datasets.rle import Mask, masks
from gpuspec.detection.inspection import inspect
from gpuspec.detection.score import score
from gpuspec.light.backend import Backend, DeviceInfo
from gpuspec.part.truth import KnownDefect
from gpuspec.simulation.simulate import trace
from gpuspec.station.station import Station

_AROUND = 3  # px at least, about a defect's box, in which its surroundings are looked at


@dataclass(frozen=True)
class Taken:
    """The images of a part, come home from the device.

    Attributes
    ----------
    number : int
        Of the part, from 1.
    values : dict
        What was drawn for it.
    station : Station
    info : DeviceInfo
    aspect : ndarray of float32, shape (M, N)
        DN.
    fusions : dict of str to ndarray
        The other fusions, if they are kept.
    frames : ndarray of float32, shape (K, M, N), or None
        The images of the sequence, if they are kept.
    zones : ndarray of int32, shape (M, N)
        Of the known defects, on the part.
    lost : ndarray of uint8, shape (M, N)
    defects : tuple of KnownDefect
    """

    number: int
    values: dict[str, Value]
    station: Station
    info: DeviceInfo
    aspect: Image
    fusions: dict[str, Image]
    frames: NDArray[np.float32] | None
    zones: NDArray[np.int32]
    lost: NDArray[np.uint8]
    defects: tuple[KnownDefect, ...]


def taken(plan: DataSetPlan, number: int, backend: Backend) -> Taken:
    """Take the images of a part.

    Without the single images an aspect image with noise is one draw of its closed form, see
    :meth:`gpuspec.light.light_map.LightMap.one_draw`; with them it is their fusion.

    Parameters
    ----------
    plan : DataSetPlan
    number : int
        Of the part, from 1.
    backend : Backend

    Raises
    ------
    StationError
        If a population does not fit on the part, or the images exceed the memory.
    BackendError
        If the device fails.
    """
    kept = plan.kept
    values, station = plan.drawn(number)
    traced = trace(station, backend)
    with traced.light_map as light_map:
        fused: dict[str, Image] = {}
        frames = None
        if kept.fusions:
            fused = light_map.fuse()
        if kept.frames:
            images = range(station.sequence.images)
            frames = np.stack([light_map.image(k) for k in images])
        own = station.sequence.fusion
        if own in fused:
            aspect = fused.pop(own)
        else:
            aspect = light_map.aspect() if kept.frames else light_map.counted()
    zones = np.where(traced.lost != BESIDE, traced.truth.labels, 0)
    return Taken(
        number, values, station, traced.info, aspect, fused, frames, zones, traced.lost,
        traced.truth.defects,
    )  # fmt: skip


def known(of: Taken, plan: DataSetPlan) -> dict[str, Any]:
    """Return what is known of a part, as JSON holds it: ``image`` and ``annotations``.

    Parameters
    ----------
    of : Taken
    plan : DataSetPlan
    """
    on_part = of.lost != BESIDE
    found = inspect(of.aspect, on_part, of.station, of.lost == 0)
    scored = score(found.labels, of.zones, on_part, len(of.defects))
    rows, columns = of.station.shape
    image = {
        "id": of.number,
        "file_name": f"{of.number:06}.{plan.kept.format}",
        "width": columns,
        "height": rows,
        **({"license": 1} if plan.kept.licence else {}),
        "split": plan.split(of.number),
        "values": of.values,
        "sensor_seed": of.station.sensor.seed,
        "population_seeds": [population.seed for population in of.station.populations],
        "sampling_mm": of.station.camera.sampling_mm,
        "full_scale_dn": of.station.sensor.full_scale_dn,
        "threshold_dn": round(found.threshold, 4),
        "flawless_dn": round(found.flawless_dn, 4),
        "unseen": scored.unseen,
        "false_blobs": scored.false_blobs,
    }
    number_of = {name: number for number, name in enumerate(plan.categories, 1)}
    annotations = []
    for mask in masks(of.zones):
        defect = of.defects[mask.number - 1]
        hit = scored.defect_hit_px[mask.number - 1]
        annotations.append({
            "image_id": of.number,
            "category_id": number_of[defect.kind],
            "segmentation": mask.segmentation,
            "area": mask.area,
            "bbox": list(mask.box),
            "iscrowd": 0,
            "attributes": {
                "defect": mask.number,
                "x_mm": round(defect.x_mm, 4),
                "y_mm": round(defect.y_mm, 4),
                "size_mm": round(defect.size_mm, 5),
                "length_mm": round(defect.length_mm, 4),
                "depth_um": round(defect.depth_um, 5),
                **_contrast(mask, of),
                "hit_px": hit,
                "found": hit > 0,
            },
        })  # fmt: skip
    return {"image": image, "annotations": annotations}


def _contrast(mask: Mask, of: Taken) -> dict[str, float]:
    """Return how far a defect's grey levels are above the median of what is around it, in DN."""
    left, top, width, height = mask.box
    about = max(_AROUND, max(width, height) // 2)
    window = (
        slice(max(top - about, 0), top + height + about),
        slice(max(left - about, 0), left + width + about),
    )
    levels, zones = of.aspect[window], of.zones[window]
    around = levels[(zones == 0) & (of.lost[window] == 0)]
    inside = levels[zones == mask.number].astype(np.float64)
    base = float(np.median(around)) if around.size else float(np.median(of.aspect))
    return {
        "contrast_dn": round(float(inside.mean()) - base, 3),
        "peak_contrast_dn": round(float(inside.max()) - base, 3),
    }
