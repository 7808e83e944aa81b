"""A part as triangles: near the sphere that they approximate, and what is refused."""

from __future__ import annotations

import numpy as np
import pytest
import tolerances
import trimesh

import gpuspec
from gpuspec.errors import GpuspecError

RADIUS = 300.0


def cap(points: int = 60, size: float = 24.0) -> trimesh.Trimesh:
    """Part of a sphere, seen from above, as triangles."""
    u = np.linspace(-size / 2, size / 2, points)
    x, y = np.meshgrid(u, u)
    z = np.sqrt(RADIUS**2 - x**2 - y**2) - RADIUS
    k = np.arange(points * points).reshape(points, points)
    a, b, c, d = (part.ravel() for part in (k[:-1, :-1], k[:-1, 1:], k[1:, :-1], k[1:, 1:]))
    faces = np.concatenate([np.stack([a, b, d], 1), np.stack([a, d, c], 1)])
    return trimesh.Trimesh(np.stack([x, y, z], -1).reshape(-1, 3), faces, process=False)


def station(**part):
    part = {"length_mm": 20.0, "width_mm": 20.0, "surface": "height", **part}
    return gpuspec.Station(part=part, camera={"sampling_mm": 0.2}, tunnel={"length_mm": 400.0})


@pytest.mark.parametrize("kind", ["stl", "obj", "ply"])
def test_a_tessellated_sphere_looks_like_the_sphere(kind, tmp_path):
    cap().export(tmp_path / f"cap.{kind}")
    mesh = {"file": str(tmp_path / f"cap.{kind}"), "unit": "mm"}
    found = gpuspec.simulate(station(mesh=mesh)).aspect
    expected = gpuspec.simulate(station(sphere_radius_mm=RADIUS)).aspect
    assert np.sqrt(np.mean((found - expected) ** 2)) < tolerances.MESH_DN


def inside_out() -> trimesh.Trimesh:
    mesh = cap()
    mesh.invert()
    return mesh


def metres() -> trimesh.Trimesh:
    mesh = cap()
    mesh.apply_scale(1e-3)
    return mesh


def holed() -> trimesh.Trimesh:
    mesh = cap()
    mesh.update_faces(np.abs(mesh.triangles_center[:, :2]).max(axis=1) > 4)
    return mesh


@pytest.mark.parametrize("made", [inside_out, metres, holed])
def test_a_mesh_that_cannot_be_meant_is_refused(made, tmp_path):
    made().export(tmp_path / "bad.stl")
    with pytest.raises(GpuspecError, match=r"bad\.stl"):
        gpuspec.simulate(station(mesh={"file": str(tmp_path / "bad.stl"), "unit": "mm"}), "numpy")


def test_a_file_that_is_no_mesh_is_refused(tmp_path):
    (tmp_path / "bad.stl").write_bytes(b"solid nothing")
    with pytest.raises(GpuspecError, match=r"bad\.stl"):
        gpuspec.simulate(station(mesh={"file": str(tmp_path / "bad.stl"), "unit": "mm"}), "numpy")
