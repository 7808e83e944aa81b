"""A simulated inspection, as it is handed on."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

from gpuspec.arrays import BESIDE, Image
from gpuspec.detection.classes import Confusion
from gpuspec.detection.expected import Expected, pixel_by_pixel
from gpuspec.detection.inspection import Found, Inspection
from gpuspec.detection.score import Score
from gpuspec.frames.silhouette import Silhouette, silhouette_of
from gpuspec.light.backend import DeviceInfo
from gpuspec.light.light_map import has_noisy_form
from gpuspec.light.refinement import counted
from gpuspec.part.relief import Relief
from gpuspec.part.truth import KnownDefect
from gpuspec.shown import array, html_page, object_of
from gpuspec.simulation.cautions.station import assumptions
from gpuspec.simulation.light_map import Progress, ScoredLightMap
from gpuspec.station.station import Station
from gpuspec.words import plural

if TYPE_CHECKING:
    from matplotlib.figure import Figure


@dataclass(frozen=True, eq=False)
class Result(Found):
    """A simulated inspection: images, what was found in them, and how good that is.

    It can be pickled; what stands on the device stays behind and is traced again when its images
    are asked for.

    Attributes
    ----------
    station : Station
    info : DeviceInfo
        Backend, device, driver and version that made the images.
    aspect : ndarray of float32, shape (M, N)
        Aspect image, DN.
    lost : ndarray of uint8, shape (M, N)
        Why a pixel sees no light, index into ``arrays.LOST``.
    truth : ndarray of int32, shape (M, N)
        Zones: 0 flawless, i the i-th of ``defects``.
    defects : tuple of KnownDefect
    inspection : Inspection
    score : Score
    confusion : Confusion
    light_map : ScoredLightMap
        For single images, ``result.light_map.image(k)``, and for other designs of the same
        geometry: ``result.light_map.score(station.replace(sensor__exposure=6))``.
    relief : Relief
    warnings : tuple of str
        What to know before trusting the score, see :mod:`gpuspec.simulation.cautions`.

    Examples
    --------
    >>> result = gpuspec.simulate(gpuspec.example("trim").replace(camera__sampling_mm=0.2))
    >>> round(result.score.p1, 2), round(result.score.p2, 2), result.score.defects_hit
    (0.36, 1.0, 36)
    >>> result.confusion
    Confusion(dent: 17 dent or bump; scratch: 11 scratch; bump: 8 dent or bump)
    >>> sorted(set(result.classes.tolist()))
    ['dent or bump', 'scratch']
    >>> result.light_map.image(3).shape
    (250, 1000)
    """

    station: Station
    info: DeviceInfo
    aspect: Image
    lost: NDArray[np.uint8]
    truth: NDArray[np.int32]
    defects: tuple[KnownDefect, ...]
    inspection: Inspection
    score: Score
    confusion: Confusion
    light_map: ScoredLightMap
    relief: Relief
    warnings: tuple[str, ...] = ()

    def __repr__(self) -> str:
        rows, columns = self.station.shape
        parts = {
            "score": str(self.score),
            "aspect": array(self.aspect, "grey levels in DN"),
            "labels": array(self.labels, f"{len(self.blobs)} blobs above {self.threshold:.1f} DN"),
            "truth": array(self.truth, f"zones of {len(self.defects)} defects"),
            "lost": array(self.lost, "why a pixel sees no light"),
            "light_map": "image(k), fuse(), score(station) of another design",
        }
        if self.station.camera.subsampling == "auto":
            pixels, rays = self.refined["pixels"], self.refined["sub_rays"]
            parts["refined"] = f"{plural(pixels, 'pixel')} of {plural(rays, 'sub-ray')}"
        if self.warnings:
            parts["warnings"] = f"{len(self.warnings)}, the first: {self.warnings[0]}"
        return object_of(
            "Result", f"{self.station.file}: {columns} x {rows} pixels, {self.info}", parts
        )

    @property
    def made(self) -> str:
        """How the aspect image was made, in a few words."""
        return f"{self.station.sequence.fusion} of {self.station.sequence.images} images"

    @property
    def about(self) -> str:
        """What matters most of the station, in a line."""
        from gpuspec.pictures.page import essentials

        return essentials(self.station, self.light_map.pattern)

    @property
    def refined(self) -> dict[str, int]:
        """How many pixels have sub-rays since one footprint does not tell them, as `score.json`."""
        return counted(self.light_map.refined)

    @cached_property
    def expected(self) -> Expected | None:
        """What noise makes of the score over all its draws, at this threshold.

        None without noise, and where it has no closed form or a pattern, a background, another
        polarity or a size filter is used.
        """
        told = pixel_by_pixel(self.station) and has_noisy_form(self.station)
        if self.light_map.pattern or not told:
            return None
        return self.light_map.expected(self.threshold)

    @cached_property
    def silhouette(self) -> Silhouette | None:
        """The outline that the sequence shows against that of the part without chips and burrs.

        None if the station has no ``edges``.

        Raises
        ------
        FrameError
            If the image does not show all of the part's outline.
        """
        if not self.station.edges:
            return None
        fused = self.light_map.fuse()
        return silhouette_of(self.station, fused["max"], fused["min"])

    @property
    def assumptions(self) -> tuple[str, ...]:
        """What is taken as ideal."""
        return assumptions(self.station)

    @cached_property
    def valid(self) -> NDArray[np.bool_]:
        """Pixels on the part, shape (M, N): the others are never scored."""
        on_part: NDArray[np.bool_] = self.lost != BESIDE
        return on_part

    @property
    def extent_mm(self) -> tuple[float, float, float, float]:
        """Left, right, bottom and top of the images in the part frame, as ``imshow`` takes them.

        Examples
        --------
        >>> import gpuspec as gs
        >>> result = gs.simulate(gs.example("trim").replace(camera__sampling_mm=0.5), "numpy")
        >>> result.extent_mm
        (-100.0, 100.0, -25.0, 25.0)
        """
        (rows, columns), p = self.station.shape, self.station.camera.sampling_mm
        right, top = columns * p / 2, rows * p / 2
        return -right, right, -top, top

    def picture(self, name: str) -> Figure:
        """Draw one of a run's pictures.

        Parameters
        ----------
        name : str
            ``"station"``, ``"sequence"``, ``"aspect"``, ``"detection"``, ``"histogram"``,
            ``"over_threshold"`` or ``"lost"``.

        Returns
        -------
        matplotlib.figure.Figure

        Raises
        ------
        StationError
            If there is none of that name.
        """
        from gpuspec.pictures.all import picture

        return picture(self, name)

    def save(
        self,
        folder: str | Path,
        *,
        frames: bool = False,
        pictures: bool = True,
        force: bool = False,
        progress: Progress | None = None,
    ) -> None:
        """Write the files of a run into a folder, from which :func:`gpuspec.load` reads it.

        Parameters and errors as :func:`gpuspec.write`.
        """
        from gpuspec.report.folder import write

        write(self, folder, frames=frames, pictures=pictures, force=force, progress=progress)

    def _repr_png_(self) -> bytes:
        """Show itself in a notebook: the detection over the truth."""
        from gpuspec.pictures.page import png

        return png(self.picture("detection"))

    def _repr_html_(self) -> str:
        """Show itself in a notebook: what it is, the detection and the aspect image."""
        from gpuspec.pictures.page import png

        return html_page(self, *(png(self.picture(name)) for name in ("detection", "aspect")))
