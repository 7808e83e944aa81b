"""Which defects, how small, a station would find: a ladder of sizes and depths on a flat part.

Each defect of the ladder is laid several times, at other phases of the light. The threshold is the
station's own, taken on the flawless part. A defect counts as found at a depth if most of its copies
are hit there and at the next depth.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from gpuspec.light.backend import Backend
from gpuspec.simulation.simulate import simulate
from gpuspec.station.station import Station

SIZES_PX = {"dent": (3.0, 5.0, 8.0, 12.0, 20.0), "scratch": (1.5, 2.0, 3.0, 5.0, 8.0)}
"""Diameters of dents and widths of scratches, in pixels."""
DEPTHS_UM = (0.02, 0.05, 0.1, 0.2, 0.5, 1.0, 2.0, 5.0, 10.0)
ANGLES_DEG = (45.0, 75.0, 105.0, 135.0)
"""Of a scratch's copies to the direction in which the light moves; a dent has as many copies."""
LENGTH_PX = 24.0
"""Of a scratch."""
SHARE = 0.75
"""Of the copies that are to be hit."""
SATURATING = 4.0
"""Exposure over saturation at which a station that does not saturate is asked once more."""
_APART_PX = 16.0
_WIDE_PX = 900.0  # of the part that is tried
_FLAWLESS_PX = 400.0


@dataclass(frozen=True)
class Found:
    """The shallowest defect found of one kind and size.

    Attributes
    ----------
    kind : str
    exposure : float
        Of the station that was tried.
    size_mm : float
        Diameter, or width.
    depth_um : float or None
        None: none of the depths was found.
    """

    kind: str
    exposure: float
    size_mm: float
    depth_um: float | None


@dataclass(frozen=True, eq=False)
class Smallest:
    """Which defects a station finds.

    Attributes
    ----------
    threshold_dn : dict of float to float
        Of each exposure.
    false_blobs : dict of float to int
        On the flawless part, at each exposure.
    rows : tuple of Found
    """

    threshold_dn: dict[float, float]
    false_blobs: dict[float, int]
    rows: tuple[Found, ...]

    def of(self, kind: str, exposure: float) -> Found | None:
        """Return the smallest defect found of a kind, at any depth; None: none was.

        Parameters
        ----------
        kind : str
        exposure : float
        """
        rows = (one for one in self.rows if (one.kind, one.exposure) == (kind, exposure))
        found = [one for one in rows if one.depth_um is not None]
        return min(found, key=lambda one: one.size_mm) if found else None

    def as_dict(self) -> list[dict[str, Any]]:
        """Return what is written as JSON."""
        return [
            {
                "exposure": exposure,
                "threshold_dn": self.threshold_dn[exposure],
                "false_blobs_on_a_flawless_part": self.false_blobs[exposure],
                "least_depth_um": {
                    kind: {f"{one.size_mm:.4g} mm": one.depth_um for one in self.rows
                           if (one.kind, one.exposure) == (kind, exposure)}
                    for kind in SIZES_PX
                },
            }
            for exposure in self.threshold_dn
        ]  # fmt: skip


def smallest(
    station: Station, backend: str | Backend = "auto", device: str | None = None
) -> Smallest:
    """Ask a station which dents and scratches it finds.

    Parameters
    ----------
    station : Station
        Its light, camera, sensor and segmentation are used, and none of its defects.
    backend, device
        As of :func:`gpuspec.simulate`.
    """
    own = station.sensor.exposure
    exposures = (own,) if own > 1.05 else (own, SATURATING)
    p = station.camera.sampling_mm
    cells = [
        (kind, size * p, depth, copy)
        for kind, sizes in SIZES_PX.items() for size in sizes for depth in DEPTHS_UM
        for copy in range(len(ANGLES_DEG))
    ]  # fmt: skip
    wide = max(station.part.length_mm, _WIDE_PX * p)
    defects, tall = _laid(cells, p, wide)
    reach = wide * (1 + station.tunnel.top_mm / station.camera.height_mm)
    plain = station.replace(defects=(), populations=(), sensor__noise=True)
    thresholds: dict[float, float] = {}
    false: dict[float, int] = {}
    rows: list[Found] = []
    for exposure in exposures:
        lit = plain.replace(
            sensor__exposure=exposure,
            tunnel__length_mm=max(
                station.tunnel.length_mm, round(1.2 * reach + 4 * station.tunnel.period_mm, 3)
            ),
        )
        side = _FLAWLESS_PX * p
        flawless = simulate(
            lit.replace(part={"length_mm": side, "width_mm": side}), backend, device
        )
        tried = simulate(
            lit.replace(
                part={"length_mm": wide, "width_mm": tall},
                defects=tuple(defects),
                segmentation__threshold=flawless.threshold,
            ),
            backend,
            device,
        )
        thresholds[exposure], false[exposure] = flawless.threshold, len(flawless.blobs)
        hit = np.array(tried.score.defect_hit_px) > 0
        rows += _least(cells, hit, exposure)
    return Smallest(thresholds, false, tuple(rows))


def _laid(
    cells: list[tuple[str, float, float, int]], p: float, wide: float
) -> tuple[list[dict[str, Any]], float]:
    """Return the defects in lines, one after another, and how wide the part has to be."""
    places: list[tuple[float, float]] = []
    x, y, high = 0.0, 0.0, 0.0
    for kind, size, _, _ in cells:
        side = 2 * size + _APART_PX * p + (LENGTH_PX * p if kind == "scratch" else 0)
        if x + side > wide:
            x, y, high = 0.0, y + high, 0.0
        places.append((x + side / 2 - wide / 2, y + side / 2))
        x, high = x + side, max(high, side)
    tall = round(y + high, 6)
    defects = []
    for (kind, size, depth, copy), (left, down) in zip(cells, places, strict=True):
        top = tall / 2 - down
        if kind == "dent":
            defects.append({"kind": kind, "x_mm": left, "y_mm": top, "diameter_mm": size,
                            "depth_um": depth})  # fmt: skip
        else:
            angle = np.radians(ANGLES_DEG[copy])
            dx, dy = (float(part(angle)) * LENGTH_PX * p / 2 for part in (np.cos, np.sin))
            ends = [[left - dx, top - dy], [left + dx, top + dy]]
            defects.append({"kind": kind, "points_mm": ends, "width_mm": size, "depth_um": depth})
    return defects, tall


def _least(
    cells: list[tuple[str, float, float, int]], hit: NDArray[np.bool_], exposure: float
) -> Iterator[Found]:
    copies = len(ANGLES_DEG)
    shares = hit.reshape(-1, len(DEPTHS_UM), copies).mean(axis=2) >= SHARE
    for found, first in zip(shares, range(0, len(cells), len(DEPTHS_UM) * copies), strict=True):
        kind, size, _, _ = cells[first]
        also = np.append(found[1:], True)
        at = np.flatnonzero(found & also)
        yield Found(kind, exposure, size, DEPTHS_UM[int(at[0])] if at.size else None)
