"""Which keys of a station take numbers, and which of these make another design."""

from __future__ import annotations

import types
from typing import Annotated, Any, Literal, Union, get_args, get_origin

from pydantic import BaseModel

from gpuspec.errors import StationError
from gpuspec.station.defects import Distribution
from gpuspec.station.paths import places
from gpuspec.station.station import Station


def check_design(key: str) -> None:
    """Refuse keys that make no other design.

    Parameters
    ----------
    key : str
        Dotted path.

    Raises
    ------
    StationError
        If it is a seed, or of the segmentation.
    """
    if key.split(".")[0] == "segmentation":
        raise StationError(
            f"{key} is not varied: every design is scored at all 256 thresholds, without a size "
            f"filter."
        )
    if places(key)[-1] == "seed":
        raise StationError(
            f"{key} is not varied: another seed is another part or other noise, not another "
            f"design, and the luckiest would be chosen. --parts tries every design on several "
            f"parts, --seeds under several draws of the noise."
        )


def takes_whole_numbers(station: Station, key: str) -> bool:
    """Whether a numeric key takes whole numbers only.

    Parameters
    ----------
    station : Station
        Whose key it is.
    key : str
        Dotted path.

    Raises
    ------
    StationError
        If there is no such key, or it is not numeric.

    Examples
    --------
    >>> from gpuspec.station.numeric import takes_whole_numbers
    >>> takes_whole_numbers(gpuspec.example("trim"), "sequence.images")
    True
    """
    if "__" in key:
        raise StationError(f"{key} is not a known key (did you mean {key.replace('__', '.')}?).")
    found: Any = station
    kind: Any = type(station)
    for place in places(key):
        if isinstance(place, int):
            there = isinstance(found, tuple) and 0 <= place < len(found)
            found = found[place] if there else None
            kind = type(found)
            if found is None:
                raise StationError(f"{station.file}: there is no {key} to vary.")
            continue
        models = [m for m in _parts(kind) if isinstance(m, type) and issubclass(m, BaseModel)]
        field = next((m.model_fields[place] for m in models if place in m.model_fields), None)
        if field is None:
            # The station's own validation knows what to say of a key that is not there.
            station.replace(**{key: 0.0})
            raise StationError(f"{station.file}: {key} is not a number that can be varied.")
        found, kind = getattr(found, place, None), field.annotation
    kinds = _parts(kind)
    if int in kinds and float not in kinds:
        return True
    if float in kinds or any(isinstance(k, type) and issubclass(k, Distribution) for k in kinds):
        return False
    raise StationError(f"{station.file}: {key} is not a number, so it cannot be varied.")


def _parts(annotation: Any) -> list[Any]:
    """Return the types a field may hold: those of a union, without what annotates them."""
    if get_origin(annotation) is Annotated:
        return _parts(get_args(annotation)[0])
    if get_origin(annotation) is Literal:
        return [type(choice) for choice in get_args(annotation)]
    if get_origin(annotation) in (Union, types.UnionType):
        return [part for argument in get_args(annotation) for part in _parts(argument)]
    return [annotation]
