"""A random part, and which of its pixels are traced: what needs no device."""

from __future__ import annotations

from dataclasses import dataclass

from gpuspec.part.relief import Relief
from gpuspec.part.truth import Truth
from gpuspec.simulation.memory import check_memory
from gpuspec.station.station import Station
from gpuspec.sweeps.plan import with_part
from gpuspec.sweeps.trying.listing import Listing, crowd, listed


@dataclass(frozen=True)
class Laid:
    """A random part with the pixels of it that are to be traced.

    Attributes
    ----------
    number, part : int
        Of the station, and of the part.
    station : Station
        With that part.
    relief : Relief
    truth : Truth
    listing : Listing
    crowded : int
        See :func:`gpuspec.sweeps.trying.listing.crowd`.
    """

    number: int
    part: int
    station: Station
    relief: Relief
    truth: Truth
    listing: Listing
    crowded: int

    @classmethod
    def of(cls, number: int, first: Station, part: int, samples: int) -> Laid:
        """Place the part's defects, and list its pixels.

        Parameters
        ----------
        number : int
            Of the station.
        first : Station
            With its first part.
        part : int
        samples : int
            Pixels of the flawless surface.

        Raises
        ------
        StationError
            If a population does not fit, or the image exceeds the memory.
        """
        check_memory(first)
        station = with_part(first, part)
        relief = Relief.of(station)
        truth = Truth.of(station, relief)
        listing = listed(station, relief, truth, samples, part)
        return cls(number, part, station, relief, truth, listing, crowd(relief, station))
