"""The part that comes with gpuspec, whole, on every device; NumPy's is in test_machines.py."""

from __future__ import annotations

import pytest

from gpuspec.light.backend import Backend
from gpuspec.light.opencl import OpenCLBackend
from gpuspec.simulation.result import Result
from gpuspec.simulation.simulate import simulate
from gpuspec.station.examples import example


@pytest.fixture(scope="module")
def first(opencl: OpenCLBackend) -> Result:
    return simulate(example("trim"), opencl)


@pytest.mark.slow
def test_the_demo_part_scores_the_same_on_every_device(device_backend: Backend, first: Result):
    result = simulate(example("trim"), device_backend)
    assert result.threshold == first.threshold
    assert result.score.as_dict() == first.score.as_dict()
    assert result.classes.tolist() == first.classes.tolist()


def test_all_defects_of_the_demo_part_are_hit_and_nothing_is_false(first: Result):
    assert len(first.defects) == 36
    assert first.score.defects_hit == 36
    assert first.score.false_blobs == 0
    # Just above the ceiling the bright rims are detected, too: more of the zones, and beside them.
    assert first.score.p1 > 0.55
    assert first.score.p2 is not None
    assert first.score.p2 > 0.9
