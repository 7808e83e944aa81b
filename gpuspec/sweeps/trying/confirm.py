"""A chosen design looked at whole, as `simulate` sees it: every score, exact, part by part."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import asdict, dataclass
from itertools import groupby, product
from typing import Any

import numpy as np

from gpuspec.detection.chances import least_share, share_within
from gpuspec.detection.score import precision, recall
from gpuspec.light.backend import Backend
from gpuspec.light.light_map import has_noisy_form
from gpuspec.simulation.at_threshold import AtThreshold, Looked
from gpuspec.simulation.simulate import trace
from gpuspec.station.costs import costs
from gpuspec.station.station import Station
from gpuspec.sweeps.plan import with_part
from gpuspec.sweeps.rule import f1_of
from gpuspec.sweeps.trying.curves import KINDS
from gpuspec.sweeps.trying.found import smallest_found
from gpuspec.sweeps.trying.noise import Noise
from gpuspec.sweeps.trying.parts import geometry


@dataclass(frozen=True)
class Confirmed:
    """A design at its threshold, over all its parts.

    Attributes
    ----------
    station : Station
        With its threshold, and part 0.
    parts : tuple of AtThreshold
        One for each part under each draw of the noise.
    noise_dn : float
        Of the flawless surface; NaN: not known.
    seeds : int
        Draws of the noise on each part.
    """

    station: Station
    parts: tuple[AtThreshold, ...]
    noise_dn: float
    seeds: int = 1

    def faintest_dn(self, least_hits: int | None = None) -> float:
        """Return the level of the faintest defect of all parts that must be hit.

        Parameters
        ----------
        least_hits : int, optional
            So many must be, the brightest; None: all.

        Returns
        -------
        float
            Infinite if there is none.
        """
        peaks = sorted((peak for seen in self.parts for peak in seen.peaks_dn), reverse=True)
        needed = peaks if least_hits is None else peaks[:least_hits]
        return min(needed, default=math.inf)

    @property
    def flawless_dn(self) -> float:
        """Highest level of what is flawless, of all parts."""
        return max(seen.flawless_dn for seen in self.parts)

    @property
    def defects(self) -> int:
        """Defects in view, of all parts."""
        return sum(seen.defects for seen in self.parts)

    def values(self) -> dict[str, float]:
        """Return every measure of :mod:`gpuspec.sweeps.measures`; NaN: not known."""

        def total(name: str) -> int:
            return int(sum(getattr(seen, name) for seen in self.parts))

        p1 = float(precision(total("hit_px"), total("false_zone_px")))
        p2 = float(recall(total("hit_px"), total("zone_px")))
        margin = self.faintest_dn() - self.flawless_dn
        margin = margin if math.isfinite(margin) else math.nan
        there = [seen for seen in self.parts if seen.zone_px]
        peaks, sizes = (
            np.array([value for seen in self.parts for value in getattr(seen, name)])
            for name in ("peaks_dn", "sizes_mm")
        )
        smallest, _ = smallest_found(peaks[None], sizes, np.array([self.flawless_dn]))
        kinds = {
            f"hits.{kind}": float(
                sum(hit for seen in self.parts for k, hit in zip(seen.kinds, seen.hit, strict=True)
                    if k == kind)
            )
            for kind in KINDS
        }  # fmt: skip
        cost = {k: math.nan if v is None else float(v) for k, v in costs(self.station).items()}
        return {
            "p1": p1, "p2": p2, "f1": float(f1_of(np.array(p1), np.array(p2))),
            "hits": float(total("hits")), **kinds,
            "worst_hits": min((float(seen.hits) for seen in there), default=math.nan),
            "worst_p2": min((float(recall(s.hit_px, s.zone_px)) for s in there), default=math.nan),
            "sure_hit_share": float(
                least_share(total("hits") / self.seeds, self.defects / self.seeds)
            ),
            "false_px": float(total("false_px")),
            "false_blobs": float(total("false_blobs")), "margin_dn": margin,
            "margin_sigma": margin / self.noise_dn if self.noise_dn else math.nan,
            "noise_dn": self.noise_dn, "smallest_mm": float(smallest[0]), **cost,
        }  # fmt: skip

    def spread(self) -> dict[str, Any]:
        """Return what parts and noise make of it: mean and worst, and bounds of the hits.

        Returns
        -------
        dict
            ``hit_share`` with the interval of Clopper and Pearson at 95 %; of several parts mean
            and worst of P1, P2 and the share hit; with noise ``expected`` of each part.
        """
        hits, defects = sum(seen.hits for seen in self.parts), self.defects
        p1, p2, share = (
            [
                float(value)
                for seen in self.parts
                for value in [
                    precision(seen.hit_px, seen.false_zone_px) if name == "p1"
                    else recall(seen.hit_px, seen.zone_px) if name == "p2"
                    else seen.hits / max(seen.defects, 1)
                ]
            ]
            for name in ("p1", "p2", "hits")
        )  # fmt: skip
        found: dict[str, Any] = {
            "hit_share": hits / max(defects, 1),
            "hit_share_95": list(share_within(hits / self.seeds, defects / self.seeds)),
            "mean": {"p1": np.mean(p1), "p2": np.mean(p2), "hit_share": np.mean(share)},
            "worst": {"p1": min(p1), "p2": min(p2), "hit_share": min(share)},
        }
        found["mean"] = {name: float(value) for name, value in found["mean"].items()}
        noisy = [asdict(seen.expected) for seen in self.parts[:: self.seeds] if seen.expected]
        return {**found, "expected": noisy} if noisy else found


def confirm_all(
    stations: Sequence[Station], parts: int, backend: Backend, seeds: int = 1, *, drawn: bool = True
) -> list[Confirmed]:
    """Look at designs part by part, every pixel; those of one geometry are traced once.

    Parameters
    ----------
    stations : sequence of Station
        With their thresholds and size filters, and part 0.
    parts : int
        How many parts to look at.
    backend : Backend
    seeds : int
        Draws of the noise on each.
    drawn : bool
        Whether it is drawn; else its mean is looked at, where it has a closed form.

    Raises
    ------
    StationError
        If a station is impossible.
    BackendError
        If the device fails.
    """
    if not drawn and all(map(_has_one_mean, stations)):
        seeds = 1
    groups: dict[str, list[int]] = {}
    for place, station in enumerate(stations):
        groups.setdefault(geometry(station), []).append(place)
    found: dict[int, Confirmed] = {}
    for places in groups.values():
        seen: dict[int, list[AtThreshold]] = {place: [] for place in places}
        noise: Noise | None = None
        for number in range(parts):
            first = with_part(stations[places[0]], number)
            traced = trace(first, backend)
            noise = noise or Noise.traced(first, traced.relief)
            for alike, draw in product(_by_design(stations, places), range(seeds)):
                looked = Looked.of(traced, with_part(stations[alike[0]], number, draw), drawn=drawn)
                told = drawn and draw == 0  # of a part, whatever is drawn of it
                for place in alike:
                    own = with_part(stations[place], number, draw)
                    at = AtThreshold.of(traced, own, expected=told, looked=looked)
                    seen[place].append(at)
            traced.light_map.release()
        for place in places:
            deviation = noise.of(stations[place]) if noise else math.nan
            found[place] = Confirmed(stations[place], tuple(seen[place]), deviation, seeds)
    return [found[place] for place in range(len(stations))]


def _by_design(stations: Sequence[Station], places: Sequence[int]) -> list[list[int]]:
    """Return the places of some stations, neighbours together that differ in segmentation alone."""

    def bare(place: int) -> Station:
        return stations[place].model_copy(update={"segmentation": stations[0].segmentation})

    return [list(alike) for _, alike in groupby(places, bare)]


def _has_one_mean(station: Station) -> bool:
    """Whether the mean of a station's noise is known, and the same for every draw."""
    return has_noisy_form(station) and not (station.sensor.prnu or station.sensor.dsnu_e)


def held_window(
    confirmed: Sequence[Confirmed], least_hits: int | None = None
) -> tuple[float, float]:
    """Return between which thresholds every defect is hit and nothing else, under all of some.

    Parameters
    ----------
    confirmed : sequence of Confirmed
    least_hits : int, optional
        How many defects must be hit; None: all.

    Returns
    -------
    low, high : float
        DN: highest level of what is flawless, level of the faintest defect; low > high: there is
        none.
    """
    return max(c.flawless_dn for c in confirmed), min(c.faintest_dn(least_hits) for c in confirmed)
