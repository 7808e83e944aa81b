"""Random stations without a defect: of every section, with and without noise."""

from __future__ import annotations

from typing import Any

import numpy as np

from gpuspec.station.station import Station


def flawless(seed: int, *, noise: bool) -> Station:
    """A random station without a defect, of some 10,000 pixels."""
    rng = np.random.default_rng(seed)

    def among(low: float, high: float) -> float:
        return float(np.exp(rng.uniform(np.log(low), np.log(high))))

    section = ("ceiling", "box", "arch")[seed % 3]
    own = {"ceiling": {}, "box": {"width_mm": among(60, 200)}, "arch": {"radius_mm": 120.0}}[
        section
    ]
    crown = {"crown_radius_x_mm": among(200, 2000)} if seed % 4 == 1 else {}
    sequence: dict[str, Any] = {"images": int(rng.choice([3, 8, 12, 20, 40]))}
    if seed % 8 == 7:
        sequence["step_mm"] = 0.37  # no whole period
    return Station.from_dict(
        {
            "part": {
                "length_mm": 24.0, "width_mm": 16.0, **crown,
                "surface": ("orientation", "height")[seed % 2],
                "material": ("ideal", "aluminium")[seed // 2 % 2],
            },
            "tunnel": {
                "section": section, **own, "luminous_mm": among(0.5, 8), "dark_mm": among(2, 24),
                "dark_leak": (0.0, 0.05)[seed % 2],
                "profile": "sinusoid" if seed % 8 == 6 else "stripes",
            },
            "camera": {
                "sampling_mm": 0.2, "pupil_mm": float(rng.choice([0.0, 2.0, 6.0])),
                "vignetting": ("none", "cos4")[seed % 2],
                **({"subsampling": 2} if seed % 8 == 5 else {}),
            },
            "sensor": {
                "exposure": among(0.8, 8), "noise": noise, "saturation_e": among(500, 20000),
                "prnu": (0.0, 0.01)[seed % 2], "dsnu_e": (0.0, 5.0)[seed // 2 % 2], "seed": seed,
            },
            "sequence": sequence,
        }
    )  # fmt: skip
