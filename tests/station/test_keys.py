"""The reference of the station file: complete, and as the models have it."""

from __future__ import annotations

from pathlib import Path

import pytest
from commandline import said
from pydantic import BaseModel

from gpuspec.errors import StationError
from gpuspec.station.keys import keys, markdown
from gpuspec.station.station import Station

WRITTEN = Path(__file__).parents[2] / ".readme" / "station.md"

TABLES = {
    "part.relief", "part.mesh", "part.waviness", "part.orange_peel", "part.pose", "camera.pose"
}  # fmt: skip
"""Of their own."""


def key(path):
    (found,) = keys(path)
    return found


def test_the_written_reference_is_that_of_the_models():
    assert WRITTEN.read_text("utf-8") == markdown(keys()), (
        "run: gpuspec reference > .readme/station.md"
    )


def test_every_key_of_a_whole_station_is_there_with_its_default():
    paths = {found.path: found for found in keys()}

    def walk(section: BaseModel, path: str) -> None:
        for name in type(section).model_fields:
            value = getattr(section, name)
            if isinstance(value, BaseModel):
                walk(value, f"{path}{name}.")
            elif path and isinstance(value, (int, float)) and not isinstance(value, bool):
                assert float(paths[path + name].default.replace(",", "")) == value
            elif path and path + name not in TABLES:
                assert path + name in paths

    walk(Station(), "")
    for path in ("part.relief.pitch_um", "defects.points_mm", "populations.bend_rad",
                 "classes.area_min_mm2", "sweep.vary"):  # fmt: skip
        assert path in paths


def test_a_key_says_unit_range_choices_and_meaning():
    found = key("camera.sampling_mm")
    assert (found.unit, found.takes, found.default) == ("mm", "number 0.00001 to 1,000", "0.05")
    assert found.meaning == "distance of two pixels on z = 0"
    assert key("tunnel.section").takes == '"ceiling", "box", "arch"'
    assert key("tunnel.dark_leak").takes == "number 0 to < 1"
    assert key("sequence.images").takes == "whole number 1 to 100,000"
    assert key("sensor.bit_depth").takes == "8, 10, 12, 16"
    assert key("segmentation.threshold").takes == '"auto" or number 0 to 65,535'
    assert key("populations.vertices").section == "populations: scratch"
    assert key("populations.diameter_mm").takes == (
        "number > 0 to 100,000, or [from, to], or {median, spread, low, high}"
    )
    assert key("defects.points_mm").takes == (
        "list of a pair of number -100,000 to 100,000, at least 2"
    )
    assert {found.default for found in keys("defects[2].depth_um")} == {"required"}


def test_every_key_says_what_it_means():
    assert all(found.meaning and found.takes for found in keys())


def test_a_section_is_shown_with_the_tables_in_it():
    of_part = {table for table in TABLES if table.startswith("part.")}
    assert {found.section for found in keys("part")} == {"part", *of_part}
    with pytest.raises(StationError, match="tunel is no section or key"):
        keys("tunel")


def test_the_command_prints_markdown_where_nobody_watches(gpuspec_):
    assert gpuspec_("reference").out == WRITTEN.read_text("utf-8")
    part = gpuspec_("reference", "sensor").out
    assert part.startswith("## `[sensor]`\n\n| key | unit |")
    assert "tunnel" not in part
    assert (
        "sections: part, part.waviness, part.orange_peel, part.relief, part.mesh, part.pose, tunnel"
        in said(gpuspec_("reference", "tunel"))
    )


def test_a_terminal_gets_lines_that_fit_it(gpuspec_, monkeypatch):
    monkeypatch.setenv("FORCE_COLOR", "1")
    monkeypatch.setenv("NO_COLOR", "1")
    monkeypatch.setenv("COLUMNS", "60")
    shown = gpuspec_("reference").out
    assert "| --- |" not in shown
    assert max(map(len, shown.splitlines())) < 90  # what makes text bold included
    assert "sampling_mm" in shown
