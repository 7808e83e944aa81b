"""A part's outline against the nominal one: what is missing and what is extra."""

from __future__ import annotations

import csv
import json

import numpy as np
import pytest
from scipy import ndimage

import gpuspec
from gpuspec.errors import FrameError
from gpuspec.frames.silhouette import silhouette
from gpuspec.station.station import Station

SAMPLING = 0.05
EDGES = (
    {"kind": "chip", "side": "top", "at_mm": 3.0, "width_mm": 2.0, "depth_mm": 0.5},
    {"kind": "burr", "side": "left", "at_mm": -1.0, "width_mm": 1.5, "depth_mm": 0.4},
    {"kind": "chip", "side": "bottom", "at_mm": -3.0, "width_mm": 0.6, "depth_mm": 0.04},
)


def station(**changes: object) -> Station:
    """A chipped part; a dent at its edge is bright in every image. The last chip is too shallow."""
    made = Station(
        part={"length_mm": 12.0, "width_mm": 6.0},
        camera={"sampling_mm": SAMPLING, "columns": 300, "rows": 180},
        tunnel={"luminous_mm": 1.0, "dark_mm": 3.0},
        sensor={"noise": True},
        sequence={"images": 16},
        defects=[{"kind": "dent", "x_mm": -3, "y_mm": 2.95, "diameter_mm": 1.0, "depth_um": 9.0}],
        edges=EDGES,
    )
    return made.replace(**changes)


def lit(part: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Brightest and darkest level of a part on which the light passes."""
    rng = np.random.default_rng(1)
    dark = rng.normal(6, 1, part.shape).astype(np.float32)
    return dark + 190 * part, dark


def rectangle() -> np.ndarray:
    part = np.zeros((120, 200), bool)
    part[30:90, 40:160] = True
    return part


@pytest.fixture(scope="module")
def simulated():
    return gpuspec.simulate(station())


def test_a_simulated_sequence_shows_the_chips_and_burrs_that_are_there_and_no_other(simulated):
    found = simulated.silhouette
    assert [one.kind for one in found.finds] == ["missing", "extra"]
    for one, edge, (x, y) in zip(found.finds, EDGES, ((3.0, 3.0), (-6.0, -1.0)), strict=False):
        ellipse = np.pi / 4 * edge["width_mm"] * edge["depth_mm"]
        assert one.area_mm2 == pytest.approx(ellipse, rel=0.15)
        assert one.area_mm2 == pytest.approx(one.area_px * SAMPLING**2)
        assert one.width_mm == pytest.approx(edge["width_mm"], abs=3 * SAMPLING)
        assert one.depth_mm == pytest.approx(edge["depth_mm"], abs=2 * SAMPLING)
        assert (one.x_mm, one.y_mm) == pytest.approx((x, y), abs=edge["depth_mm"])
    score = found.score
    assert (score.defects, score.defects_hit, score.false_blobs) == (3, 2, 0)
    assert found.scored == "2 of 3 edge defects hit, 0 false"


def test_a_part_whose_outline_is_whole_has_no_finds():
    assert gpuspec.simulate(station(edges=())).silhouette is None
    part = rectangle()
    assert silhouette(*lit(part), part, sampling_mm=SAMPLING).finds == ()


def test_a_run_and_an_inspection_of_its_frames_write_the_same_finds(simulated, tmp_path):
    simulated.save(tmp_path / "run", frames=True)
    found = gpuspec.inspect(
        tmp_path / "run/frames.tif", tmp_path / "run/station.toml", silhouette="part"
    )
    found.save(tmp_path / "found")
    tables = [
        list(csv.DictReader((tmp_path / folder / "silhouette.csv").open(encoding="utf-8")))
        for folder in ("run", "found")
    ]
    assert [row["kind"] for row in tables[0]] == ["missing", "extra"]
    for one, other in zip(*tables, strict=True):
        assert one["kind"] == other["kind"]
        assert int(one["area_px"]) == pytest.approx(int(other["area_px"]), rel=0.1)
        assert float(one["x_mm"]) == pytest.approx(float(other["x_mm"]), abs=2 * SAMPLING)
    for folder in ("run", "found"):
        told = json.loads((tmp_path / folder / "score.json").read_text("utf-8"))["silhouette"]
        assert told["score"] == {"defects": 3, "defects_hit": 2, "finds": 2, "false_finds": 0}
        assert (tmp_path / folder / "silhouette.png").stat().st_size > 10_000
    assert gpuspec.load(tmp_path / "run").silhouette.told == "1 missing, 1 extra"


@pytest.mark.parametrize("turn", [-3.0, 0.0, 2.5])
def test_the_nominal_part_is_laid_on_the_one_that_is_seen(turn):
    part = rectangle()
    part[30:38, 100:116] = False  # a chip, which is to draw it but little
    moved = ndimage.shift(ndimage.rotate(part.astype(float), turn, reshape=False, order=1), (4, -7))
    found = silhouette(*lit(moved > 0.5), rectangle(), sampling_mm=SAMPLING, laid=False)
    assert found.turn_deg == pytest.approx(turn, abs=0.25)
    assert found.shift_mm == pytest.approx((-7 * SAMPLING, -4 * SAMPLING), abs=0.5 * SAMPLING)
    assert [one.kind for one in found.finds] == ["missing"]
    assert found.finds[0].area_px == pytest.approx(8 * 16, rel=0.15)


def test_a_bright_defect_at_the_edge_is_no_chip_and_a_bright_mount_no_burr():
    part = rectangle()
    bright, dark = lit(part)
    dark[30:40, 60:80] = bright[30:40, 60:80]  # bright in every frame, on the part
    bright[20:30, 100:130] = dark[20:30, 100:130] = 220.0  # and beside it
    assert silhouette(bright, dark, part, sampling_mm=SAMPLING).finds == ()


def test_what_is_not_deeper_than_the_tolerance_is_no_find():
    part = rectangle()
    chipped = part.copy()
    chipped[30:33, 60:90] = False
    for tolerance, count in ((2.5, 1), (3.0, 0)):
        found = silhouette(
            *lit(chipped), part, sampling_mm=SAMPLING, tolerance_px=tolerance
        )  # fmt: skip
        assert len(found.finds) == count
    assert found.told == "no difference"


@pytest.mark.parametrize(
    ("nominal", "words"),
    [
        (np.ones((120, 200), bool), "the nominal part reaches the left edge of the image"),
        (np.zeros((120, 200), bool), "the nominal part has no pixel in the image"),
        (np.pad(np.ones((60, 60), bool), ((30, 30), (40, 100))), "50% of both is common"),
    ],
    ids=["too large", "nothing", "another"],
)
def test_a_nominal_part_that_cannot_be_compared_is_refused(nominal, words):
    with pytest.raises(FrameError, match=words):
        silhouette(*lit(rectangle()), nominal, sampling_mm=SAMPLING)


def test_a_part_that_fills_the_image_is_refused():
    part = np.ones((120, 200), bool)
    part[:, :40] = False
    with pytest.raises(FrameError, match="as the light shows it, reaches the right edge"):
        silhouette(*lit(part), rectangle(), sampling_mm=SAMPLING)
    with pytest.raises(FrameError, match=r"camera\.columns"):
        _ = gpuspec.simulate(station(camera__columns=None, camera__rows=None)).silhouette


def test_an_inspection_names_what_the_nominal_part_lacks(simulated, tmp_path):
    frames = np.zeros((4, 60, 80), np.uint8)
    with pytest.raises(FrameError, match="name its file"):
        gpuspec.inspect(frames, silhouette="part")
    with pytest.raises(FrameError, match=r"write e\.g\. part:2\.5"):
        gpuspec.inspect(frames, station(), silhouette="part:deep")
    shots = np.stack([simulated.light_map.image(k) for k in range(16)]).astype(np.uint8)
    plain = Station(camera={"sampling_mm": SAMPLING})
    found = gpuspec.inspect(shots, plain, silhouette="30,30,270,150:2")
    assert found.silhouette.told == "1 missing, 1 extra"
    assert found.silhouette.tolerance_px == 2
    assert found.silhouette.score is None
