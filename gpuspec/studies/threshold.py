"""Over the threshold: what each would find, where all is found and nothing else, and which to set.

The images are one; only the level moves. A threshold in the middle of the range in which everything
is found and nothing else bears most drift of the light, up and down.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any, ClassVar

import numpy as np
from matplotlib.figure import Figure

from gpuspec.arrays import BESIDE
from gpuspec.detection.false_blobs import least_pixels
from gpuspec.detection.inspection import Inspection, levelled
from gpuspec.detection.over_threshold import OverThreshold, over_threshold, thresholds_of
from gpuspec.errors import StationError
from gpuspec.light.backend import Backend
from gpuspec.pictures.over_threshold import STATED, thresholds_figure
from gpuspec.pictures.page import essentials
from gpuspec.simulation.light_map import Progress
from gpuspec.simulation.simulate import trace
from gpuspec.station.station import Station
from gpuspec.studies.outcome import Outcome
from gpuspec.words import plural

_MOST = 10_000


@dataclass(frozen=True, repr=False)
class Threshold(Outcome):
    """What a station would find at each threshold.

    Attributes
    ----------
    found : OverThreshold
    automatic : Inspection
        With the threshold that is found by itself.
    stated_dn : float or None
        The threshold that the station states; None: the automatic one.
    """

    name: ClassVar[str] = "threshold"

    found: OverThreshold
    automatic: Inspection
    stated_dn: float | None

    def at(self, threshold: float) -> dict[str, float]:
        """Return what is found at one of the thresholds: of those tried, the nearest.

        Parameters
        ----------
        threshold : float
            DN.
        """
        i = int(np.abs(self.found.threshold_dn - threshold).argmin())
        return {
            "threshold_dn": float(self.found.threshold_dn[i]),
            "defects_hit": int(self.found.hits[i]),
            "false_blobs": int(self.found.false_blobs[i]),
            "false_px": int(self.found.false_px[i]),
            "p1": float(self.found.p1[i]),
            "p2": float(self.found.p2[i]),
            "f1": float(self.found.f1[i]),
        }

    def numbers(self) -> dict[str, Any]:
        """See :meth:`Outcome.numbers`."""
        found, there = self.found, self.found.range_dn
        full = self.station.sensor.full_scale_dn
        return {
            "defects": found.defects,
            "flawless_dn": self.automatic.flawless_dn,
            "no_false_blob_from_dn": found.clean_dn,
            "all_found_below_dn": found.found_dn,
            "range_dn": None if there is None else there[1] - there[0],
            "range_share_of_full_scale": None if there is None else (there[1] - there[0]) / full,
            "best": self.at(self.found.best_dn),
            "best_f1": self.at(found.threshold_dn[int(np.argmax(found.f1))]),
            "automatic": self.at(self.automatic.threshold),
            "threshold_rule": self.automatic.rule,
            "threshold_said": self.automatic.threshold_said,
            "stated": None if self.stated_dn is None else self.at(self.stated_dn),
        }

    def findings(self) -> tuple[str, ...]:
        """See :meth:`Outcome.findings`."""
        found = self.found
        there = found.range_dn
        if there:
            said = [
                f"All {plural(found.defects, 'defect')} are found and nothing else from "
                f"{there[0]:.2f} to {there[1]:.2f} DN, over {there[1] - there[0]:.2f} DN: "
                f"segmentation.threshold = {self.found.best_dn:.4g} is its middle."
            ]
        else:
            above = "none" if np.isnan(found.found_dn) else f"those below {found.found_dn:.2f} DN"
            most = self.at(self.found.best_dn)
            said = [
                f"No threshold finds all {plural(found.defects, 'defect')} and nothing else: the "
                f"last false blob is gone at {found.clean_dn:.2f} DN, and {above} find every "
                f"defect. At {found.clean_dn:.2f} DN {most['defects_hit']} are found."
            ]
        named = [(f"The automatic threshold, {self.automatic.threshold:.2f} DN "
                  f"({self.automatic.threshold_said}),", self.automatic.threshold)]  # fmt: skip
        if self.stated_dn is not None:
            named.append((f"The station's threshold, {self.stated_dn:.4g} DN,", self.stated_dn))
        said += [f"{who} {self._said(level)}." for who, level in named]
        best = float(found.threshold_dn[int(np.argmax(found.f1))])
        said.append(f"F1 is highest at {best:.2f} DN, which {self._said(best)}.")
        return tuple(said)

    def _said(self, threshold: float) -> str:
        one = self.at(threshold)
        return (
            f"finds {one['defects_hit']} of {self.found.defects} and "
            f"{plural(int(one['false_blobs']), 'false blob')}: P1 {one['p1']:.3f}, "
            f"P2 {one['p2']:.3f}, F1 {one['f1']:.3f}"
        )

    def table(self) -> tuple[tuple[str, ...], list[tuple[Any, ...]]]:
        """See :meth:`Outcome.table`."""
        rows = [tuple(self.at(level).values()) for level in self.found.threshold_dn]
        return tuple(self.at(self.found.best_dn)), rows

    def figure(self) -> Figure:
        """See :meth:`Outcome.figure`."""
        named = [("automatic", self.automatic.threshold), ("best", self.found.best_dn)]
        if self.stated_dn is not None:
            named.append((STATED, self.stated_dn))
        return thresholds_figure(self.found, named, essentials(self.station), str(self.info))


def study(
    station: Station,
    levels: int = 200,
    backend: str | Backend = "auto",
    device: str | None = None,
    progress: Progress | None = None,
) -> Threshold:
    """Score a station at every threshold.

    Parameters
    ----------
    station : Station
        With its size filter, polarity and background.
    levels : int
        How many thresholds are tried, beside the automatic, the stated and the best ones.
    backend, device
        As for :func:`gpuspec.simulate`.
    progress : callable, optional
        Told what is being done.

    Returns
    -------
    Threshold

    Raises
    ------
    StationError
        If no defect is in view, or `levels` is not 2 to 10,000.
    BackendError
        If the backend is absent or fails.

    Examples
    --------
    >>> station = gpuspec.example("trim").replace(camera__sampling_mm=0.2)
    >>> found = gpuspec.study("threshold", station)
    >>> print(found.findings()[0])
    All 36 defects are found and nothing else from 88.04 to 109.33 DN, over 21.29 DN:
        segmentation.threshold = 98.68 is its middle.
    """
    if not 2 <= levels <= _MOST:
        raise StationError(f"levels = {levels} must be from 2 to {_MOST:,}.")
    traced = trace(station, backend, device, progress)
    zones, on_part, lit = traced.truth.labels, traced.lost != BESIDE, traced.lost == 0
    if not zones[on_part].any():
        raise StationError(
            f"{station.file} has no defect in view, so that nothing can be found; add [[defects]] "
            f"or [[populations]]."
        )
    aspect, automatic, _ = traced.light_map.inspected(
        station.replace(segmentation__threshold="auto"), progress
    )
    stated = station.segmentation.threshold
    stated_dn = None if stated == "auto" else float(stated)
    image = levelled(aspect, on_part, station, lit)
    least = least_pixels(station.segmentation.min_area_mm2, station.camera.sampling_mm)
    tried = thresholds_of(image, on_part, automatic, levels)
    tried = np.unique([*tried, *([] if stated_dn is None else [stated_dn])])
    (progress or (lambda _: None))(f"scoring at {len(tried):,} thresholds")
    found = over_threshold(image, zones, on_part, traced.guard, tried, min_area_px=least)
    # And once more with the best among them, and with where nothing false is left.
    tried = np.append(tried, [found.clean_dn, found.best_dn])
    found = over_threshold(image, zones, on_part, traced.guard, tried, min_area_px=least)
    return Threshold(
        station, traced.info, found, automatic, stated_dn,
        notes=tuple(traced.result().warnings),
    )  # fmt: skip
