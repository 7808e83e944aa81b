"""A design looked at at its threshold: what is hit and false there is what `simulate` finds."""

from __future__ import annotations

from typing import Any

import pytest

from gpuspec.simulation.at_threshold import AtThreshold
from gpuspec.simulation.simulate import simulate, trace
from gpuspec.station.station import Station
from gpuspec.studies import threshold, tolerance


def vignetted(**rule: Any) -> Station:
    """Two dents under a near camera, whose image is far brighter in the middle than at its ends."""
    station = Station.from_dict(
        {
            "part": {"length_mm": 60.0, "width_mm": 16.0},
            "tunnel": {"luminous_mm": 2.0, "dark_mm": 8.0, "dark_leak": 0.1},
            "camera": {"height_mm": 160.0, "sampling_mm": 0.2, "vignetting": "cos4"},
            "sensor": {"exposure": 4.0},
            "segmentation": rule,
            "populations": [{"kind": "dent", "count": 4, "seed": 1, "diameter_mm": 1.0,
                             "depth_um": 6.0}],
        },
        "s.toml",
    )  # fmt: skip
    return station.replace(segmentation__threshold=simulate(station).threshold)


RULES = [
    {}, {"background_mm": 6.0}, {"background_mm": 6.0, "smoothing_mm": 0.2}, {"polarity": "dark"},
    {"polarity": "both"}, {"polarity": "both", "background_mm": 6.0, "min_area_mm2": 0.1},
]  # fmt: skip


@pytest.mark.parametrize("rule", RULES, ids=str)
def test_what_is_hit_and_what_is_false_is_what_a_simulation_finds(opencl, rule):
    station = vignetted(**rule)
    traced, scored = trace(station, opencl), simulate(station, opencl).score
    seen = AtThreshold.of(traced, station)
    assert seen.hits == scored.defects_hit
    assert (seen.hit_px, seen.false_zone_px) == (scored.hit_px, scored.false_px)


def test_a_background_that_is_taken_off_is_no_false_blob_and_costs_no_room(opencl):
    station = vignetted(background_mm=6.0)
    found = tolerance.study(station, steps=3, offset_mm=0.2, backend=opencl)
    nominal = found.perturbations[0].seen[1]
    assert (nominal.hits, nominal.false_blobs) == (4, 0)
    assert found.perturbations[0].keeps.all()
    assert nominal.room_dn(found.threshold_dn) > 0
    over = threshold.study(station, 40, opencl).found
    assert nominal.flawless_dn == over.clean_dn
    assert min(nominal.peaks_dn) == over.found_dn


@pytest.mark.parametrize(
    "rule", [{"background_mm": 6.0}, {"polarity": "dark"}, {"min_area_mm2": 0.1}], ids=str
)
def test_nothing_is_expected_where_a_pixel_is_not_detected_by_its_own_level(opencl, rule):
    plain = vignetted().replace(sensor__noise=True)
    station = plain.replace(segmentation={"threshold": plain.segmentation.threshold, **rule})
    for one, none in ((plain, False), (station, True)):
        traced = trace(one, opencl)
        assert (AtThreshold.of(traced, one).expected is None) is none
        assert (traced.result().expected is None) is none
