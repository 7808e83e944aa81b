"""A station as text: written, read, with every key."""

from __future__ import annotations

import tomllib
from typing import Any

import pytest
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st
from stations import STATIONS

from gpuspec.errors import StationError
from gpuspec.station.examples import example, example_text, examples
from gpuspec.station.station import Station
from gpuspec.station.toml import to_toml


@settings(max_examples=150, deadline=None, suppress_health_check=list(HealthCheck))
@given(STATIONS, st.booleans())
def test_a_station_survives_being_written_and_read(data: dict[str, Any], comments: bool):
    station = Station.from_dict(data)
    text = to_toml(station, comments=comments)
    assert Station.parse(text) == station
    assert Station.from_dict(station.as_dict()) == station
    assert station.replace() == station


@pytest.mark.parametrize("name", examples())
def test_an_example_is_a_station_and_so_is_its_text(name: str):
    station = example(name)
    assert Station.parse(example_text(name), f"{name}.toml").as_dict() == station.as_dict()
    for comments in (True, False):
        again = Station.parse(to_toml(station, comments=comments), f"{name}.toml")
        assert again.as_dict() == station.as_dict()


TABLES = {"relief", "mesh", "waviness", "orange_peel", "pose"}
"""Of a part or a camera, which it need not have."""


def test_an_example_that_is_not_there_names_those_that_are():
    with pytest.raises(StationError, match=r"no example 'tirm'; choose one of .*trim.*\.$"):
        example("tirm")


def test_the_written_station_holds_every_key_and_every_default():
    written = tomllib.loads(to_toml(Station()))
    assert set(written) == {"part", "tunnel", "camera", "sensor", "sequence", "segmentation"}
    text = to_toml(Station())
    for section in written:
        for key in type(getattr(Station(), section)).model_fields:
            assert f"\n{key} = " in text or f"\n# {key} = (none)" in text or key in TABLES


def test_files_are_written_as_they_are_named_or_with_their_whole_path(tmp_path):
    station = Station.parse('[part.relief]\nfile = "x.sur"', "s.toml", tmp_path)
    assert Station.parse(to_toml(station)).part.relief.file == "x.sur"
    anchored = Station.parse(to_toml(station, absolute=True))
    assert anchored.part.relief.file == (tmp_path / "x.sur").resolve().as_posix()
