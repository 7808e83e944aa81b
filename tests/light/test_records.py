"""The structs of `kernels/station.h`: told once there, and filled by name."""

from __future__ import annotations

import re

import numpy as np
import pytest
from scenes import check_station, members

from gpuspec.light.records import design_block, geometry_block, packed
from gpuspec.light.sources import folder, structs

HEADER = (folder("kernels") / "station.h").read_text(encoding="utf-8")


def test_every_struct_of_the_header_is_read_member_by_member():
    bare = re.sub(r"/\*.*?\*/", "", HEADER, flags=re.DOTALL)
    told = re.findall(r"RECORD\((\w+)\)", bare)
    assert told == list(structs()) == ["Geometry", "Design", "Groove", "Map"]
    # One float a line, and nothing else: what is read is what a compiler lays out.
    bodies = [line.strip() for line in bare.splitlines() if line.startswith("    ")]
    assert bodies == [f"float {name};" for names in structs().values() for name in names]


@pytest.mark.parametrize("name", structs())
def test_a_struct_is_a_whole_number_of_four_floats_of_different_names(name):
    # std140 rounds a struct up to 16 bytes, OpenCL C and numpy do not.
    assert len(structs()[name]) % 4 == 0
    assert len(set(structs()[name])) == len(structs()[name])


def test_members_stand_where_their_name_does():
    station = check_station(sensor__seed=70_003, sensor__exposure=2.5, camera__pupil_mm=4.0)
    design, geometry = design_block(station), geometry_block(station)
    assert design.dtype == geometry.dtype == np.float32
    d, g = members("Design", design), members("Geometry", geometry)
    assert (d["seed_low"], d["seed_high"], d["exposure"]) == (70_003 - 65_536, 1, 2.5)
    assert (g["camera_height"], g["pupil"], g["columns"]) == (800, 4, 32)


def test_records_of_many_are_rows():
    values = {name: np.arange(3) + i for i, name in enumerate(structs()["Map"][:-2])}
    rows = packed("Map", **values)
    assert rows.shape == (3, 12)
    assert rows.flags.c_contiguous
    assert rows[1].tolist() == [*range(1, 11), 0, 0]


@pytest.mark.parametrize("wrong", [{"luminous": 1.0}, {"lag": 1.0, "step": 2.0}])
def test_a_member_left_out_or_unknown_is_refused(wrong):
    with pytest.raises(TypeError, match="Design: its members are"):
        packed("Design", **wrong)
