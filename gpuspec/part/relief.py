"""The part's relief, resolved: its grooves and maps, and which of them reach which block."""

from __future__ import annotations

from dataclasses import dataclass, field

import numpy as np
from numpy.typing import NDArray

from gpuspec.part.edges import NO_EDGES, Edges
from gpuspec.part.grooves import Grooves, blocks
from gpuspec.part.maps import TopographyMap, read_maps
from gpuspec.part.meshes import mesh_map
from gpuspec.part.placement import Progress, place
from gpuspec.part.textures import textures
from gpuspec.station.defects import Defect
from gpuspec.station.station import Station

Blocks = tuple[NDArray[np.int32], NDArray[np.int32]]
"""What :func:`gpuspec.part.grooves.blocks` returns."""


@dataclass(frozen=True)
class Relief:
    """All that stands out of a part's shape, populations placed and topographies read.

    Attributes
    ----------
    defects : tuple of Defect
        Explicit defects first, then the populations'.
    grooves : Grooves
        Of the dents, bumps and scratches.
    maps : tuple of TopographyMap
        The part's mesh and measured relief, if any, measured patches, then waves and orange peel.
    edges : Edges
        Chips and burrs, which are no relief but go the same way to a device.
    """

    defects: tuple[Defect, ...]
    grooves: Grooves
    maps: tuple[TopographyMap, ...]
    edges: Edges = NO_EDGES
    _known: list[tuple[str, Blocks]] = field(
        default_factory=list, init=False, repr=False, compare=False
    )

    @classmethod
    def of(
        cls,
        station: Station,
        progress: Progress | None = None,
        placed: tuple[Defect, ...] | None = None,
    ) -> Relief:
        """Place the station's populations and read its topographies.

        Parameters
        ----------
        station : Station
            Of the part.
        progress : callable, optional
            See :func:`gpuspec.part.placement.place`.
        placed : tuple of Defect, optional
            What that function gave for a part of the same outline, defects and populations.

        Raises
        ------
        StationError
            If a population does not fit.
        TopographyError
            If a topography cannot be read.

        Examples
        --------
        >>> from gpuspec.part.relief import Relief
        >>> relief = Relief.of(gpuspec.example("trim"))
        >>> len(relief.defects), len(relief.grooves)
        (36, 47)
        """
        defects = place(station, progress) if placed is None else placed
        mesh = mesh_map(station)
        maps = (*([mesh] if mesh else []), *read_maps(station), *textures(station))
        return cls(defects, Grooves.of(defects), maps, Edges.of(station))

    def blocks(self, station: Station) -> Blocks:
        """Return what reaches each block of the image, see :func:`gpuspec.part.grooves.blocks`.

        Of one ray a pixel, whose grooves are the widest: the same for all light maps of a camera,
        and asked once.

        Parameters
        ----------
        station : Station
            The part's.
        """
        camera = station.camera.model_copy(update={"subsampling": 1})
        station = station.model_copy(update={"camera": camera})
        key = f"{station.part!r} {camera!r}"
        for known, found in self._known:
            if known == key:
                return found
        found = blocks(self.grooves, station, self.edges)
        self._known[:] = [(key, found)]
        return found

    def __getstate__(self) -> dict[str, object]:
        """Leave behind what can be asked again."""
        return {**self.__dict__, "_known": []}

    @property
    def remarks(self) -> tuple[str, ...]:
        """What was done to the maps: filled, left out, cropped; a sentence each."""
        return tuple(remark for m in self.maps for remark in m.remarks)

    def __repr__(self) -> str:
        maps = "".join(f", {m!r}" for m in self.maps)
        edges = f", {self.edges!r}" if len(self.edges) else ""
        return f"Relief({len(self.defects)} defects, {len(self.grooves)} grooves{maps}{edges})"
