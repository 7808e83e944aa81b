"""Prints by how much the level of a flawless pixel ripples as the stripes' phase moves under it.

    python tests/benchmarks/rules.py

Of the example `trim`, seen by its own lens of 3 mm and by others. "disc" is the true kernel, pixel
and pupil, integrated numerically; "two boxes" what the kernels compute; "one box" that of the same
variance, which they took. Ripple: highest less lowest mean over a scan, as a share of what one
image adds, full scale over their number; the median and the largest of stripes and exposures.
"""

from __future__ import annotations

import itertools

import numpy as np

from gpuspec.light.devices import open_backend
from gpuspec.light.float64_stripes import mean_over_scan
from gpuspec.station.examples import example
from gpuspec.station.station import Station

STEPS = (0.25, 0.5, 0.75, 1.0, 1.25, 1.5, 2.0, 3.0)
"""Of the tunnel from image to image, in rises: see `rise`."""
LUMINOUS, DARK, EXPOSURES = (1.0, 2.0, 4.0), (4.0, 6.0, 8.0, 12.0), (2.0, 3.0, 4.0, 6.0, 8.0)
PHASES = 64
CELLS = 1 << 14  # of the true kernel, along a period


def widths(station: Station) -> tuple[float, float]:
    """Return the two boxes of the pixel below the camera, mm."""
    rows, columns = station.shape
    middle = np.array([rows // 2 * columns + columns // 2], np.uint32)
    arrays = open_backend("numpy").trace(station, pixels=middle).read()
    return float(arrays.wide_mm[0, 0, 0]), float(arrays.narrow_mm[0, 0, 0])


def by_boxes(station: Station, wide: float, narrow: float) -> np.ndarray:
    """Return the level at each phase, DN, of a footprint of two boxes."""
    light = np.arange(PHASES) / PHASES * station.step_mm
    one = np.ones(PHASES)
    return 255 * mean_over_scan(light, wide * one, narrow * one, one, station)


def by_disc(station: Station, pixel: float, radius: float) -> np.ndarray:
    """Return the same of the true kernel: a disc seen edge-on, averaged over the pixel."""
    period, luminous = station.tunnel.period_mm, station.tunnel.luminous_mm
    x = (np.arange(CELLS) - CELLS / 2) * period / CELLS
    stripe = np.fft.rfft(np.fft.ifftshift(np.abs(x) < luminous / 2).astype(float))
    seen = stripe * np.sinc(np.fft.rfftfreq(CELLS, period / CELLS) * pixel)
    if radius > 0:
        ends = np.clip(np.append(x, x[-1] + period / CELLS) / radius, -1, 1)
        below = (ends * np.sqrt(1 - ends**2) + np.arcsin(ends)) / np.pi
        seen = seen * np.fft.rfft(np.fft.ifftshift(np.diff(below)))
    lit = np.minimum(station.sensor.exposure * np.fft.irfft(seen, CELLS), 1)
    images = station.sequence.images
    at = (np.arange(images)[:, None] / images + np.arange(PHASES) / PHASES / images) * CELLS
    return 255 * np.interp(at, np.arange(CELLS + 1), np.append(lit, lit[0])).mean(axis=0)


def rise(wide: float, narrow: float, exposure: float) -> float:
    """Return the stretch of light over which a stripe's edge saturates a pixel, mm."""
    if exposure * narrow > 2 * wide:
        return float(np.sqrt(2 * wide * narrow / exposure))
    return wide / exposure + narrow / 2


def main() -> None:
    """Measure and print the tables."""
    for pupil in (3.0, 1.0, 5.0):
        given = example("trim").replace(camera__pupil_mm=pupil, defects=[], populations=[])
        wide, narrow = widths(given.replace(camera__subsampling=1))
        one = float(np.hypot(wide, narrow))
        share = given.tunnel.top_mm / given.camera.height_mm
        pixel, radius = given.camera.sampling_mm * (1 + share), pupil / 2 * share
        rises = (f"{rise(wide, narrow, g):.2f} mm at exposure {g:g}" for g in EXPOSURES)
        print(f"pupil {pupil:g} mm: boxes of {wide:.3f} and {narrow:.3f} mm, one of {one:.3f} mm")
        print(f"rise: {', '.join(rises)}")
        print(f"{'step':>10}{'disc':>10}{'max':>6}{'two boxes':>12}{'max':>6}"
              f"{'one box':>12}{'max':>6}")  # fmt: skip
        for step in STEPS:
            shares = []
            for luminous, dark, exposure in itertools.product(LUMINOUS, DARK, EXPOSURES):
                images = round((luminous + dark) / (step * rise(wide, narrow, exposure)))
                station = given.replace(
                    tunnel__luminous_mm=luminous, tunnel__dark_mm=dark,
                    sensor__exposure=exposure, sequence__images=images,
                )  # fmt: skip
                levels = (
                    by_disc(station, pixel, radius),
                    by_boxes(station, wide, narrow),
                    by_boxes(station, one, 0.0),
                )
                shares.append([np.ptp(level) * images / 255 for level in levels])
            found = zip(np.median(shares, axis=0), np.max(shares, axis=0), strict=True)
            row = "".join(f"{median:12.2f}{largest:6.2f}" for median, largest in found)
            print(f"{step:5.2f} rises{row[3:]}", flush=True)
        print()


if __name__ == "__main__":
    main()
