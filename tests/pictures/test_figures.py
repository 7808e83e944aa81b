"""The pictures: made for every kind of part, to scale, in the colours their legends say."""

from __future__ import annotations

import dataclasses
import io
import warnings

import numpy as np
import pytest
from legible import check_legible, pixels
from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.colors import to_rgb
from matplotlib.figure import Figure
from matplotlib.patches import Patch
from matplotlib.text import Text
from PIL import Image
from tolerances import POOLED, SHOWN_DN, TO_SCALE

from gpuspec.arrays import LOST, pooled
from gpuspec.detection.score import score
from gpuspec.light.float64 import ray_paths
from gpuspec.pictures import detection, page, place, sequence
from gpuspec.pictures.all import PICTURES, detection_picture
from gpuspec.pictures.aspect import aspect_picture
from gpuspec.pictures.histogram import histogram_picture
from gpuspec.pictures.lost import LOST_COLOURS, lost_picture
from gpuspec.pictures.page import MARGIN, SKY, VERMILION, WIDTH, YELLOW, png
from gpuspec.pictures.sequence import sequence_animation, sequence_strip
from gpuspec.pictures.station import station_drawing, station_picture
from gpuspec.simulation.result import Result
from gpuspec.simulation.simulate import simulate
from gpuspec.station.station import Station
from gpuspec.words import BEST, P1, P2

FIGURES = (
    station_picture,
    sequence_strip,
    aspect_picture,
    detection_picture,
    histogram_picture,
    lost_picture,
)

# A deep scratch that is hit, a dent too shallow to be seen, and both across more pixels than the
# page has, so that images are reduced.
REDUCED = """
part = { length_mm = 120.0, width_mm = 30.0 }
defects = [
    { kind = "scratch", points_mm = [[-30.0, -5.0], [-20.0, 5.0]], width_mm = 0.6, depth_um = 9.0 },
    { kind = "dent", x_mm = 40.0, y_mm = 6.0, diameter_mm = 0.8, depth_um = 0.02 },
]
"""
SMALL = "camera = { sampling_mm = 0.1 }\n"
DENT = '[[defects]]\nkind = "dent"\nx_mm = 1.0\ny_mm = 0.5\ndiameter_mm = 0.8\ndepth_um = 6.0\n'
STATIONS = {
    "normal": SMALL + "part = { length_mm = 24.0, width_mm = 8.0 }\n" + DENT,
    "flawless": SMALL + "part = { length_mm = 24.0, width_mm = 8.0 }\n",
    "nothing detected": SMALL
    + "part = { length_mm = 24.0, width_mm = 8.0 }\nsegmentation = { threshold = 254.5 }\n"
    + DENT.replace("6.0", "0.1"),
    "all detected": SMALL
    + "part = { length_mm = 24.0, width_mm = 8.0 }\nsegmentation = { threshold = 0.0 }\n"
    + DENT,
    "crowned in a box": SMALL.replace("}", ", columns = 300, rows = 120 }")
    + "part = { length_mm = 24.0, width_mm = 8.0, crown_radius_x_mm = 60.0 }\n"
    + 'tunnel = { section = "box", width_mm = 200.0, length_mm = 150.0, opening_length_mm = 4.0, '
    + "opening_width_mm = 3.0 }\n"
    + DENT,
    "tall in an arch": SMALL
    + "part = { length_mm = 6.0, width_mm = 40.0 }\n"
    + 'tunnel = { section = "arch", radius_mm = 60.0 }\n'
    + DENT,
    "square, noisy, 12 bit": SMALL
    + "part = { length_mm = 12.0, width_mm = 12.0 }\nsensor = { noise = true, bit_depth = 12 }\n"
    + DENT,
    "5 x 300 mm": SMALL + "part = { length_mm = 5.0, width_mm = 300.0 }\n" + DENT,
    "300 x 5 mm": SMALL + "part = { length_mm = 300.0, width_mm = 5.0 }\n" + DENT,
    "many digits": "camera = { sampling_mm = 0.0123456, pupil_mm = 2.345678 }\n"
    + "part = { length_mm = 3.456789, width_mm = 2.345678, crown_radius_x_mm = 9876.5432 }\n"
    + "tunnel = { luminous_mm = 1.000123, dark_mm = 3.333333 }\n"
    + "sensor = { exposure = 3.14159265, bit_depth = 16 }\n"
    + DENT.replace("0.8", "0.2"),
    "300 x 5 mm under a low camera": SMALL.replace("}", ", height_mm = 101.2345 }")
    + "part = { length_mm = 300.0, width_mm = 5.0, crown_radius_x_mm = 4000.0 }\n"
    + "tunnel = { height_mm = 95.4321 }\n"
    + DENT,
    "8 x 8 pixels": "camera = { sampling_mm = 0.1, columns = 8, rows = 8 }\n",
    "one line": "camera = { sampling_mm = 0.1, columns = 400, rows = 1 }\n",
    "one pixel": "camera = { columns = 1, rows = 1 }\n",
    "one image": SMALL
    + "part = { length_mm = 12.0, width_mm = 4.0 }\nsequence = { images = 1 }\n"
    + DENT,
    "far camera, fine stripes": SMALL.replace("}", ", height_mm = 5000.0, pupil_mm = 0.0 }")
    + "part = { length_mm = 24.0, width_mm = 8.0 }\n"
    + "tunnel = { luminous_mm = 0.2, dark_mm = 0.1 }\n",
}


@pytest.fixture(scope="module", params=STATIONS)
def result(request: pytest.FixtureRequest) -> Result:
    return simulate(Station.parse(STATIONS[request.param]))


@pytest.fixture(scope="module")
def reduced() -> Result:
    return simulate(Station.parse(REDUCED))


@pytest.mark.parametrize("draw", [aspect_picture, detection_picture])
def test_what_is_wrong_stands_at_the_foot_of_a_picture(draw):
    sound = simulate(Station.parse(STATIONS["crowned in a box"]))
    wrong = dataclasses.replace(
        sound, warnings=("half of the part is dark. " * 20, "another note.")
    )
    sound = dataclasses.replace(sound, warnings=())
    height = [draw(found).get_size_inches()[1] for found in (sound, wrong)]
    assert height[1] == pytest.approx(height[0] + page.NOTES / page.DPI)
    texts = [text for text in draw(wrong).texts if text.get_text().startswith("note: half")]
    (note,) = texts
    canvas = FigureCanvasAgg(note.figure)
    assert note.get_text().endswith("… (1 of 2 notes in score.json)")
    box = note.get_window_extent(canvas.get_renderer())
    assert 0 < box.x0 < box.x1 < 1500
    assert 0 < box.y0 < box.y1 < page.NOTES
    assert not any("note: " in text.get_text() for text in draw(sound).texts)


def is_colour(image: np.ndarray, colour: str) -> np.ndarray:
    return (image == np.round(255 * np.array(to_rgb(colour)))).all(axis=-1)


def whole_image_axes(figure: Figure, result: Result):
    half = result.station.shape[1] * result.station.camera.sampling_mm / 2
    return next(ax for ax in figure.axes if ax.images and ax.get_xlim()[1] == pytest.approx(half))


def colour_at(figure: Figure, result: Result, x_mm: float, y_mm: float) -> np.ndarray:
    """What is drawn at a point of the part: 3 x 3 pixels round it."""
    image = pixels(figure)
    x, y = whole_image_axes(figure, result).transData.transform((x_mm, y_mm))
    row, column = image.shape[0] - 1 - int(y), int(x)
    return image[row - 1 : row + 2, column - 1 : column + 2]


@pytest.mark.slow
@pytest.mark.parametrize("draw", FIGURES, ids=lambda draw: draw.__name__)
def test_every_picture_of_every_station_is_legible_and_without_a_warning(
    draw, result: Result
) -> None:
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        figure = draw(result)
        image = pixels(figure)
    assert image.shape[1] == WIDTH
    assert (image[0] == 255).all(), "the page is white"
    assert not (image == 255).all()
    check_legible(figure)


@pytest.mark.slow
@pytest.mark.parametrize("draw", [aspect_picture, detection_picture, lost_picture, sequence_strip])
@pytest.mark.parametrize("part", [(5.0, 300.0), (300.0, 5.0), (24.0, 8.0)], ids=str)
def test_a_part_of_any_proportions_is_drawn_to_scale(draw, part) -> None:
    station = Station.parse(SMALL).replace(part__length_mm=part[0], part__width_mm=part[1])
    result = simulate(station)
    box = whole_image_axes(draw(result), result).get_window_extent()
    # Sides are whole pixels.
    assert abs(box.width * part[1] / part[0] - box.height) < max(1, part[1] / part[0])


def test_a_picture_says_that_not_every_defect_is_in_a_box(
    reduced: Result, monkeypatch: pytest.MonkeyPatch
) -> None:
    def legend() -> str:
        figure = detection_picture(reduced)
        return " ".join(text.get_text() for text in figure.legends[0].get_texts())

    assert "boxes" not in legend()
    monkeypatch.setattr(detection, "BOXES_MAX", 0)
    assert "defect hit (1 of 2, 0 of them in boxes)" in legend()


@pytest.mark.parametrize("scale", [1, 1000])
def test_the_histogram_s_labels_are_on_the_page_whatever_the_counts(
    reduced: Result, scale: int, monkeypatch: pytest.MonkeyPatch
) -> None:
    real = np.bincount
    monkeypatch.setattr(np, "bincount", lambda *a, **k: real(*a, **k) * scale)
    figure = histogram_picture(reduced)
    pixels(figure)
    (ax,) = figure.axes
    assert ax.yaxis.label.get_window_extent().x0 >= 0
    assert figure.legends[0].get_window_extent().x1 <= WIDTH


def test_long_headings_and_legends_end_on_the_page() -> None:
    sheet = page.Sheet(WIDTH, 300)
    sheet.heading("a long title " * 12, "short", "words " * 200)
    names = [f"a name of some length, {n}" for n in range(6)]
    sheet.legend([Patch(label=name) for name in names], 100)
    pixels(sheet.figure)
    for text in sheet.figure.findobj(Text):
        assert text.get_window_extent().x1 <= WIDTH, text.get_text()
    assert page.text_width("short", 10.0) == pytest.approx(
        next(t for t in sheet.figure.texts if t.get_text() == "short").get_window_extent().width,
        rel=0.05,
    )


def test_pictures_leave_no_trace_in_matplotlib(reduced: Result) -> None:
    import matplotlib

    before = dict(matplotlib.rcParams)
    png(detection_picture(reduced))
    assert dict(matplotlib.rcParams) == before


def test_a_missed_defect_and_a_hit_one_have_their_own_colours(reduced: Result) -> None:
    assert [n > 0 for n in reduced.score.defect_hit_px] == [True, False]
    figure = detection_picture(reduced)
    assert is_colour(colour_at(figure, reduced, -25.0, 0.0), SKY).all()
    assert is_colour(colour_at(figure, reduced, 40.0, 6.0), VERMILION).all()
    assert not is_colour(colour_at(figure, reduced, 0.0, 0.0), VERMILION).any()


def test_without_a_missed_defect_its_colour_is_only_in_the_legend(reduced: Result) -> None:
    hit = dataclasses.replace(
        reduced, score=dataclasses.replace(reduced.score, defect_hit_px=(1, 1), defects_hit=2)
    )
    image = pixels(detection_picture(hit))
    assert not is_colour(image[MARGIN + 20 :], VERMILION).any()
    assert is_colour(image[MARGIN + 20 :], SKY).any()


@pytest.mark.parametrize("offset", range(3))
def test_a_zone_of_one_pixel_survives_the_reduction(reduced: Result, offset: int) -> None:
    row, column = 150, 700 + offset
    truth = np.zeros_like(reduced.truth)
    truth[row, column] = 1
    no_labels = np.zeros_like(reduced.labels)
    lone = dataclasses.replace(
        reduced, truth=truth, score=score(no_labels, truth, reduced.valid, 2)
    )
    rows, columns = reduced.station.shape
    p = reduced.station.camera.sampling_mm
    x, y = (column + 0.5 - columns / 2) * p, (rows / 2 - row - 0.5) * p
    assert is_colour(colour_at(detection_picture(lone), lone, x, y), VERMILION).any()


def test_a_false_blob_has_its_own_colour(reduced: Result) -> None:
    none = dataclasses.replace(
        reduced,
        truth=np.zeros_like(reduced.truth),
        score=score(reduced.labels, np.zeros_like(reduced.truth), reduced.valid, 2),
    )
    image = pixels(detection_picture(none))
    assert is_colour(image[MARGIN + 20 :], YELLOW).any()
    assert not is_colour(image[MARGIN + 20 :], SKY).any()


def test_details_show_missed_defects_first_then_false_blobs_then_hits() -> None:
    station = Station.parse(
        STATIONS["normal"]
        + DENT.replace("1.0", "-8.0").replace("6.0", "0.02").replace("dent", "bump")
        + DENT.replace("1.0", "8.0")
    )
    made = simulate(station)
    truth = np.where(made.truth == 3, 0, made.truth)
    made = dataclasses.replace(made, truth=truth, score=score(made.labels, truth, made.valid, 3))
    titles = [ax.get_title(loc="left") for ax in detection_picture(made).axes]
    kinds = [title.split(":")[0] for title in titles if ":" in title]
    assert kinds == ["missed", "false", "hit"]
    assert any("bump 2\n⌀ 0.8 mm, ↑ 0.02 µm" in title for title in titles)


def test_a_caption_has_no_exponent() -> None:
    made = simulate(Station.parse(STATIONS["normal"].replace("6.0", "123.0")))
    titles = [ax.get_title(loc="left") for ax in detection_picture(made).axes]
    assert any("↓ 120 µm" in title for title in titles), titles


def test_the_title_gives_the_score(reduced: Result) -> None:
    words = " ".join(text.get_text() for text in detection_picture(reduced).texts)
    assert f"{P1} {reduced.score.p1:.3f}" in words
    assert f"{P2} {reduced.score.p2:.3f}" in words
    assert BEST in words


def test_on_a_flawless_part_p2_is_called_undefined() -> None:
    flawless = simulate(Station.parse(STATIONS["flawless"]))
    assert f"{P2} undefined" in " ".join(t.get_text() for t in detection_picture(flawless).texts)


@pytest.mark.parametrize("draw", [aspect_picture, detection_picture, lost_picture])
def test_axes_are_in_mm_of_the_part_frame(draw, result: Result) -> None:
    rows, columns = result.station.shape
    p = result.station.camera.sampling_mm
    ax = whole_image_axes(draw(result), result)
    assert ax.get_xlim() == pytest.approx((-columns * p / 2, columns * p / 2))
    assert ax.get_ylim() == pytest.approx((-rows * p / 2, rows * p / 2))
    assert ax.get_xlabel().startswith("x, mm")
    assert ax.get_ylabel().startswith("y, mm")


@pytest.mark.parametrize("draw", [aspect_picture, detection_picture, lost_picture])
def test_images_are_reduced_before_they_are_drawn(draw, reduced: Result) -> None:
    for ax in draw(reduced).axes:
        for image in ax.images:
            assert image.get_array().shape[1] <= WIDTH


def test_reducing_keeps_the_mean_and_the_maximum_where_the_image_does_not_divide() -> None:
    image = np.random.default_rng(1).random((7, 11)).astype(np.float32)
    blocks = [[image[r : r + 3, c : c + 3] for c in range(0, 11, 3)] for r in range(0, 7, 3)]
    for by, expected in ((np.add, np.mean), (np.maximum, np.max), (np.minimum, np.min)):
        wanted = [[expected(block) for block in row] for row in blocks]
        np.testing.assert_allclose(pooled(image, 3, by), wanted, rtol=POOLED)


def test_the_scale_bar_has_the_length_it_says(reduced: Result) -> None:
    ax = whole_image_axes(aspect_picture(reduced), reduced)
    start, end = ax.lines[-1].get_xdata()
    assert ax.texts[-1].get_text() == f"{end - start:g} mm"


def test_lost_pixels_are_in_the_colour_of_their_reason() -> None:
    made = simulate(Station.parse(STATIONS["crowned in a box"]))
    image = pixels(lost_picture(made))
    present = np.unique(made.lost)
    assert len(present) >= 3
    for reason, colour in enumerate(LOST_COLOURS):
        if LOST[reason] != "beside the part":
            assert is_colour(image[MARGIN + 20 :], colour).any() == (reason in present)


def test_the_histogram_counts_every_pixel_on_the_part(reduced: Result) -> None:
    # Each count is drawn twice, filled and as an outline.
    outside, _, inside, _ = (
        patch.get_data().values.sum() for patch in histogram_picture(reduced).axes[0].patches
    )
    assert inside == reduced.score.zone_px
    assert outside + inside == reduced.valid.sum()


def test_the_histogram_holds_the_threshold_against_the_levels_that_are_detected() -> None:
    bright = simulate(Station.parse(STATIONS["normal"], "s.toml"), "numpy")
    level, deep = bright.flawless_dn, float(bright.aspect.max())
    dark = bright.station.replace(segmentation={"polarity": "dark", "threshold": level + 3.0})
    # A part that is the other way round: its dent is as dark as it was bright.
    turned = dataclasses.replace(
        simulate(dark, "numpy"), aspect=2 * np.float32(level) - bright.aspect
    )
    heading = " ".join(text.get_text() for text in histogram_picture(turned).texts)
    assert "as the threshold is held against it" in heading
    inside = histogram_picture(turned).axes[0].patches[2].get_data()
    highest = inside.edges[:-1][inside.values > 0].max()
    assert highest == pytest.approx(deep, abs=np.diff(inside.edges)[0])


@pytest.mark.parametrize("threshold", [0.0, 262.0, 394.0])
def test_the_threshold_lies_in_the_histogram_wherever_it_is(reduced: Result, threshold) -> None:
    found = dataclasses.replace(reduced.inspection, threshold=threshold)
    (ax,) = histogram_picture(dataclasses.replace(reduced, inspection=found)).axes
    low, high = ax.get_xlim()
    assert low < threshold < high


@pytest.mark.parametrize("threshold", [262.0, 394.0])
def test_full_scale_is_white_and_no_scale_passes_it(reduced: Result, threshold) -> None:
    found = dataclasses.replace(reduced.inspection, threshold=threshold, flawless_dn=255.0)
    saturated = dataclasses.replace(
        reduced, inspection=found, aspect=np.full_like(reduced.aspect, 255)
    )
    low, high = place.grey_range(saturated)
    assert low < high == 255
    assert place.range_up_to(255.0, saturated, 0.05)[1] == 255


def test_the_strip_spreads_over_one_period(reduced: Result) -> None:
    words = [text.get_text() for text in sequence_strip(reduced, 4).texts]
    assert [w for w in words if w.startswith("k =")] == [
        f"k = {k}    shift {0.4 * k:.2f} mm" for k in (0, 10, 20, 30)
    ]


def test_a_sequence_of_many_periods_still_shows_one() -> None:
    station = Station.parse("sequence = { images = 40, step_mm = 17.0 }")
    shifts = np.array(sequence._spread(station, 4)) * 17.0 % 16
    np.testing.assert_allclose(shifts, [0, 4, 8, 12])


@pytest.mark.parametrize(("frames", "expected"), [(24, 24), (7, 7), (1, 1), (100, 40)])
def test_the_animation_has_a_frame_for_each_image(
    reduced: Result, frames: int, expected: int
) -> None:
    file = io.BytesIO()
    sequence_animation(reduced, file, frames=frames, width=300)
    with Image.open(file) as animation:
        assert animation.n_frames == expected
        assert animation.width <= 360


def test_the_animation_shows_the_image_in_grey(reduced: Result) -> None:
    file = io.BytesIO()
    sequence_animation(reduced, file, frames=1, width=600)
    with Image.open(file) as animation:
        shown = np.asarray(animation.convert("L"), float)[28:-28]
    image = reduced.light_map.image(0)
    mean = image.reshape(150, 4, 600, 4).mean(axis=(1, 3))
    inner = np.s_[1:-1, 1:-1]
    np.testing.assert_allclose(shown[inner], mean[inner], atol=SHOWN_DN)


@pytest.mark.slow
def test_every_file_of_a_run_is_written(reduced: Result, tmp_path) -> None:
    for name, draw in PICTURES.items():
        draw(reduced)(tmp_path / name)
        with Image.open(tmp_path / name) as image:
            assert image.format == name.rpartition(".")[2].upper()


def test_the_station_is_drawn_to_scale() -> None:
    station = Station.parse(STATIONS["crowned in a box"])
    made = simulate(station)
    x, zero = np.linspace(-10, 10, 5), np.zeros(5)
    side = ray_paths(station, made.relief, x, zero)
    front = ray_paths(station, made.relief, zero, x / 4)
    figure = station_drawing(station, side, front)
    whole, across, closer, _ = figure.axes
    scales = []
    for ax in (whole, across, closer):
        box = ax.get_window_extent()
        (left, right), (low, high) = ax.get_xlim(), ax.get_ylim()
        assert box.width / (right - left) == pytest.approx(box.height / (high - low), rel=TO_SCALE)
        scales.append(box.width / (right - left))
    assert scales[0] == pytest.approx(scales[1])
    assert whole.get_ylim()[1] > station.camera.height_mm
    words = " ".join(text.get_text() for ax in figure.axes for text in ax.texts)
    for dimension in ("camera height 800 mm", "tunnel height 150 mm", "a = 4 mm", "b = 12 mm",
                      "sampling 0.1 mm/px", "pupil ⌀ 3 mm", "opening 4 × 3 mm"):  # fmt: skip
        assert dimension in words
