"""What a sweep will do: every design of its grid by number, and on which parts each is tried."""

from __future__ import annotations

import hashlib
import math
from collections.abc import Mapping
from dataclasses import dataclass
from functools import cached_property
from numbers import Integral
from pathlib import Path
from typing import Any

from gpuspec import words
from gpuspec.errors import StationError
from gpuspec.station.corners import stated
from gpuspec.station.paths import places
from gpuspec.station.seeds import NOISE, seeds_of, with_seeds
from gpuspec.station.station import Station
from gpuspec.station.toml import to_toml
from gpuspec.sweeps.axes import Axis, axis, varied
from gpuspec.version import __version__

# From one part to the next; odd, so that seeds repeat after 2^32 parts, and no small multiple of it
# is near another: populations with seeds 1 and 2 never meet.
SEED_STEP = 0x9E3779B1
# Of the noise alone, from one draw of it to the next on the same part.
DRAW_STEP = 0x85EBCA6B
PARTS_MAX = 1000
SEEDS_MAX = 1000
DESIGNS_MAX = 10**12
_SEARCHED = 512


@dataclass(frozen=True)
class Plan:
    """A grid of designs and the parts each is tried on.

    Designs are numbered like the digits of a number, the last axis fastest; axes that need a new
    light map come first, so that designs of one light map are neighbours.

    Attributes
    ----------
    station : Station
        What is not varied.
    axes : tuple of Axis
    parts : int
        Part 0 is the station's own; part k has every seed k times `SEED_STEP` further.
    samples : int
        Strata of the screening sample per part; 0: every pixel of every design is counted.
    seeds : int
        Draws of the noise on each part; draw k has the noise's seed k times `DRAW_STEP` further.

    Examples
    --------
    >>> vary = {"tunnel.height_mm": [200, 300], "sensor.exposure": "1:4:4"}
    >>> plan = gpuspec.Plan.of(gpuspec.example("trim"), vary)
    >>> plan
    Plan(trim.toml: 8 designs, 2 of tunnel.height_mm, 4 of sensor.exposure; 1 part)
    >>> plan.geometries, plan.values(5)
    (2, {'tunnel.height_mm': 300.0, 'sensor.exposure': 2.0})
    >>> plan.station_of(5).tunnel.height_mm
    300.0
    """

    station: Station
    axes: tuple[Axis, ...]
    parts: int = 1
    samples: int = 0
    seeds: int = 1

    def __repr__(self) -> str:
        keys = ", ".join(f"{len(a.values)} of {a.key}" for a in self.axes)
        sampled = f", screened by {self.samples:,} pixels" if self.samples else ""
        return f"Plan({self.station.file}: {self.designs:,} designs, {keys}; {self.tries}{sampled})"

    @property
    def tries(self) -> str:
        """On what each design is tried, in words."""
        draws = f", {self.seeds} draws of the noise on each" if self.seeds > 1 else ""
        return words.plural(self.parts, "part") + draws

    @property
    def inspections(self) -> int:
        """Of each design: of every part under every draw of the noise."""
        return self.parts * self.seeds

    @classmethod
    def of(
        cls,
        station: Station | str | Path,
        vary: Mapping[str, Any] | None = None,
        parts: int | None = None,
        samples: int = 0,
        seeds: int | None = None,
    ) -> Plan:
        """Plan a sweep.

        Parameters
        ----------
        station : Station, str or Path
            Or the path of a station file. Its ``[sweep]`` table is taken
            where the other parameters are None.
        vary : mapping of str to str, number or list, optional
            Keys and what :func:`gpuspec.sweeps.axes.axis` takes.
        parts : int, optional
            Number of parts each design is tried on.
        samples : int
            See :class:`Plan`.
        seeds : int, optional
            Draws of the noise on each part.

        Raises
        ------
        StationError
            Nothing to vary or to detect, a wrong key or range, a tolerance of no number, or too
            many designs.

        Examples
        --------
        >>> station = gpuspec.example("trim")
        >>> gpuspec.Plan.of(station)  # its own [sweep] table
        Plan(trim.toml: 15,360 designs, 16 of tunnel.luminous_mm, 12 of tunnel.dark_mm, 8 of
            sensor.exposure, 10 of sequence.images; 1 part)
        >>> gpuspec.Plan.of(station, {"tunnel.dark_mm": "2:8:4"}, parts=3).designs
        4
        >>> gpuspec.Plan.of(station, {"tunnel.dark": "2:8:4"})
        Traceback (most recent call last):
            ...
        gpuspec.errors.StationError: trim.toml: tunnel.dark is not a known key (did you mean
            dark_mm?).
        """
        station = Station.of(station)
        one_level(station)
        table = station.sweep
        vary = varied(vary if vary is not None else table.vary if table else {})
        parts = parts if parts is not None else table.parts if table else 1
        seeds = seeds if seeds is not None else table.seeds if table else 1
        for name, count in (("parts", parts), ("samples", samples), ("seeds", seeds)):
            if not isinstance(count, Integral) or isinstance(count, bool) or count < 0:
                raise StationError(f"{name} is {count!r}; it must be a whole number, at least 0.")
        if not vary:
            raise StationError(
                f"{station.file}: nothing to vary; give --vary KEY=FROM:TO:COUNT, or a table "
                f"[sweep.vary] in the station file."
            )
        if not 1 <= parts <= PARTS_MAX:
            raise StationError(f"designs are tried on 1 to {PARTS_MAX} parts, not {parts}.")
        if not 1 <= seeds <= SEEDS_MAX:
            raise StationError(f"noise is drawn 1 to {SEEDS_MAX} times, not {seeds}.")
        if not (station.defects or station.populations or station.part.relief):
            raise StationError(
                f"{station.file}: the part has no defects, so there is nothing to score; add "
                f"[[defects]] or [[populations]]."
            )
        random = station.populations or station.part.orange_peel or station.sensor.noise
        if parts > 1 and not random:
            raise StationError(
                f"{station.file}: the part has no random [[populations]] and no orange peel, so "
                f"{parts} parts would be {parts} times the same; take one."
            )
        if seeds > 1 and not station.sensor.noise and "sensor.noise" not in vary:
            raise StationError(
                f"{station.file}: the sensor has no noise, so {seeds} seeds would be {seeds} times "
                f"the same; take one, or set sensor.noise = true."
            )
        axes = [axis(station, key, given) for key, given in vary.items()]
        for number, one in enumerate(axes):
            if any(places(one.key) == places(other.key) for other in axes[:number]):
                raise StationError(f"{one.key} is varied twice; vary each key once.")
        stated(station, [a.key for a in axes])  # what may be off is asked when the sweep is done
        axes.sort(key=lambda a: not a.retraces)
        base = station.replace(sweep=None, dataset=None)
        if base.segmentation.threshold != "auto":
            base = base.replace(segmentation__threshold="auto")
        plan = cls(base, tuple(axes), int(parts), int(samples), int(seeds))
        if plan.designs > DESIGNS_MAX:
            raise StationError(
                f"{plan.designs:.3g} designs are more than could ever be done or stored; vary "
                f"fewer keys, or take fewer values of each."
            )
        return plan

    @cached_property
    def designs(self) -> int:
        """Number of designs."""
        return math.prod(len(a.values) for a in self.axes)

    @cached_property
    def designs_per_geometry(self) -> int:
        """Number of designs that share a light map."""
        return math.prod(len(a.values) for a in self.axes if not a.retraces)

    @property
    def geometries(self) -> int:
        """Number of distinct geometries, each traced for every part."""
        return self.designs // self.designs_per_geometry

    def values(self, design: int) -> dict[str, float | int]:
        """Return the varied keys of a design and their values."""
        found = {}
        for a in reversed(self.axes):
            design, place = divmod(design, len(a.values))
            found[a.key] = a.values[place]
        return {a.key: found[a.key] for a in self.axes}

    def geometry_of(self, design: int) -> int:
        """Return the number of a design's geometry: equal for those that share a light map."""
        return design // self.designs_per_geometry

    def station_of(self, design: int, base: Station | None = None) -> Station:
        """Return a design's station with part 0.

        Parameters
        ----------
        design : int
        base : Station, optional
            Another design's station of the same geometry: only what differs is checked anew.

        Raises
        ------
        StationError
            If these values make no valid station: why not.
        """
        values = self.values(design)
        if base is None:
            return self.station.replace(**values)
        quick = _with_design(base, {a.key: values[a.key] for a in self.axes if not a.retraces})
        return quick or self.station.replace(**values)

    def first_valid(self) -> int | None:
        """Return the first valid of 512 designs spread over the grid; None if none is."""
        for design in range(0, self.designs, max(self.designs // _SEARCHED, 1)):
            try:
                self.station_of(design)
            except StationError:
                continue
            return design
        return None

    def check_some_valid(self) -> None:
        """See that some design is valid, if the grid is small.

        Raises
        ------
        StationError
            With the first reason, if none is.
        """
        if self.designs <= _SEARCHED and self.first_valid() is None:
            try:
                self.station_of(0)
            except StationError as error:
                message = f"no design of the sweep is a valid station, e.g.: {error}"
                raise StationError(message) from None

    def identity(self) -> dict[str, Any]:
        """Return what makes this sweep this one, as JSON holds it."""
        return {
            "gpuspec": __version__,
            "station": to_toml(self.station, comments=False, absolute=True),
            "files": digests(self.station),
            "vary": {a.key: list(a.values) for a in self.axes},
            "parts": self.parts,
            "samples": self.samples,
            "seeds": self.seeds,
        }

    @classmethod
    def from_identity(cls, identity: Mapping[str, Any]) -> Plan:
        """Return the plan of an :meth:`identity`.

        Raises
        ------
        StationError, TypeError, ValueError, KeyError
            If it is none.
        """
        station = Station.parse(identity["station"], "station.toml")
        axes = tuple(axis(station, key, values) for key, values in identity["vary"].items())
        parts, samples, seeds = (int(identity[name]) for name in ("parts", "samples", "seeds"))
        if not axes or parts < 1 or samples < 0 or seeds < 1:
            raise ValueError("nothing is varied, or there are no parts")
        return cls(station, axes, parts, samples, seeds)


def digests(station: Station) -> dict[str, str]:
    """Return what the files named in a station hold, as SHA-256."""
    found = {}
    for name in station.files:
        path = station.locate(name)
        try:
            found[name] = hashlib.sha256(path.read_bytes()).hexdigest()
        except OSError:  # whoever needs it says so
            found[name] = "not there"
    return found


def _with_design(station: Station, changes: Mapping[str, float | int]) -> Station | None:
    """Return a valid station with other stripes, sensor or sequence, or None if there is none.

    An eighth of the time of :meth:`Station.replace`, which tells what is wrong. Sections in which
    nothing changes are those of the other station.
    """
    sections: dict[str, dict[str, Any]] = {}
    for key, value in changes.items():
        section, name = key.split(".")
        own = getattr(station, section).__dict__
        if own[name] != value:
            sections.setdefault(section, {**own})[name] = value
    try:
        made = {
            section: type(getattr(station, section)).model_validate(values)
            for section, values in sections.items()
        }
        return station.model_copy(update=made).possible(part_is=True)
    except ValueError:
        return None


def with_part(station: Station, part: int, draw: int = 0) -> Station:
    """Return a station with another random part, its defects and orange peel, and other noise.

    Parameters
    ----------
    station : Station
    part : int
        From 0, which is its own.
    draw : int
        Of the noise on this part, from 0.
    """
    if part == draw == 0:
        return station

    later = {key: seed + part * SEED_STEP for key, seed in seeds_of(station).items()}
    later[NOISE] += draw * DRAW_STEP
    return with_seeds(station, {key: seed % 2**32 for key, seed in later.items()})


def scored_at(station: Station, threshold_dn: float) -> Station:
    """Return a design's station as its row is scored: at a threshold, pixel by pixel.

    Parameters
    ----------
    station : Station
    threshold_dn : float
    """
    return station.replace(segmentation__threshold=threshold_dn, segmentation__min_area_mm2=0.0)


def one_level(station: Station) -> None:
    """See that pixels above one grey level are what is detected: levels are counted, not images.

    Parameters
    ----------
    station : Station

    Raises
    ------
    StationError
        If it takes a local background, detects what is dark, or has chips and burrs.
    """
    if station.edges:
        raise StationError(
            f"{station.file}: a sweep scores what is on the part and not its outline, which "
            f"[[edges]] change; leave them out of what is swept (--set edges=none)."
        )
    rule = station.segmentation
    for key, asked in (("background_mm", rule.background_mm), ("polarity", rule.polarity)):
        if asked not in (None, "bright"):
            raise StationError(
                f"{station.file}: segmentation.{key} = {asked} needs whole images, and a sweep "
                f"counts the pixels above a grey level; leave it out of what is swept."
            )
