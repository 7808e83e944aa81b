"""The part's relief, resolved: its grooves and maps, and which of them reach which block."""

from __future__ import annotations

from dataclasses import dataclass

from gpuspec.part.grooves import Grooves
from gpuspec.part.maps import TopographyMap, read_maps
from gpuspec.part.placement import Progress, place
from gpuspec.station.defects import Defect
from gpuspec.station.station import Station


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
        The part's measured relief, if any, then the measured patches.
    """

    defects: tuple[Defect, ...]
    grooves: Grooves
    maps: tuple[TopographyMap, ...]

    @classmethod
    def of(cls, station: Station, progress: Progress | None = None) -> Relief:
        """Place the station's populations and read its topographies.

        Parameters
        ----------
        station : Station
        progress : callable, optional
            See :func:`gpuspec.part.placement.place`.

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
        defects = place(station, progress)
        return cls(defects, Grooves.of(defects), read_maps(station))

    @property
    def remarks(self) -> tuple[str, ...]:
        """What was done to the maps: filled, left out, cropped; a sentence each."""
        return tuple(remark for m in self.maps for remark in m.remarks)

    def __repr__(self) -> str:
        maps = "".join(f", {m!r}" for m in self.maps)
        return f"Relief({len(self.defects)} defects, {len(self.grooves)} grooves{maps})"
