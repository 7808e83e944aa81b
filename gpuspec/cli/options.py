"""What commands take alike: arguments, options, and changes to a station."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer

from gpuspec import words
from gpuspec.cli import completion

if TYPE_CHECKING:
    from gpuspec.station.station import Station

StationArgument = Annotated[Path, typer.Argument(help="Station file (TOML).")]
BackendOption = Annotated[
    str,
    typer.Option(
        "--backend",
        help="auto, opencl, opengl, vulkan or numpy; a named one is never swapped.",
        autocompletion=completion.backends,
    ),
]
DeviceOption = Annotated[
    str | None, typer.Option("--device", help="Part of a device's name, or its number.")
]
FramesArgument = Annotated[
    list[str], typer.Argument(help="A folder, a pattern in quotes, or files: PNG, TIFF.")
]
WorkersOption = Annotated[
    int, typer.Option("--workers", min=0, help="Local processes to share the work; 0: none.")
]
SchedulerOption = Annotated[
    str, typer.Option("--scheduler", help="A Dask scheduler, e.g. tcp://host:8786.")
]
DarkOption = Annotated[
    str | None, typer.Option("--dark", help="Frames without light: a folder, pattern or file.")
]
ColourOption = Annotated[
    str | None, typer.Option("--colour", help="Of coloured frames: luminance, red, green or blue.")
]
GapsOption = Annotated[
    bool, typer.Option("--gaps", help="Take a series in which numbers are missing.")
]


def folder(given: str | Path) -> Path:
    """Return a folder for results as it was named; an empty name is an error."""
    from gpuspec.files import folder_of

    return folder_of(given)


def output_option(said: str) -> Any:
    """Return the option that names the folder for the results, with what is said of it."""
    return typer.Option("-o", "--output", parser=folder, metavar="FOLDER", help=said)


OutputOption = Annotated[Path, output_option("For the results.")]
ForceOption = Annotated[
    bool,
    typer.Option("--force", help="Replace files that are not known to be an earlier run's, too."),
]
FramesOption = Annotated[bool, typer.Option("--frames", help="Write every image of the sequence.")]
PicturesOption = Annotated[bool, typer.Option("--pictures/--no-pictures", help="Draw pictures.")]
SetOption = Annotated[
    list[str] | None,
    typer.Option(
        "--set",
        metavar="KEY=VALUE",
        help="Change a key, e.g. tunnel.dark_mm=8; none unsets it.",
        autocompletion=completion.changes,
    ),
]
GOAL_HELP = (
    f"What is to be the best: p1, {words.P1}; p2, {words.P2}; f1, of both, by the paper's rule; or "
    f"margin_dn, margin_sigma, images, light_e, cycle_s, ..., beside what --require asks for."
)
REQUIRE_HELP = (
    'What a design must have, e.g. "hits = all", "false_blobs = 0", "margin_sigma >= 6", '
    '"images <= 16".'
)
P1_FLOOR_HELP, P2_FLOOR_HELP = (f"Least {name}; {words.BEST}." for name in (words.P1, words.P2))


def changed(station: Station, changes: list[str] | None) -> Station:
    """Apply KEY=VALUE changes; values are TOML, text without quotes, or none to unset a key.

    Parameters
    ----------
    station : Station
    changes : list of str or None
        Each KEY=VALUE.

    Raises
    ------
    StationError
        If one has another form, a key stands twice, or the changed station is invalid.
    """
    from gpuspec.errors import StationError
    from gpuspec.station.mistakes import choices
    from gpuspec.station.paths import places
    from gpuspec.station.station import Station

    values: dict[str, Any] = {}
    for change in changes or ():
        key, equals, text = (part.strip() for part in change.partition("="))
        if not equals:
            raise StationError(
                f"--set {_short(change)}: write it as KEY=VALUE, e.g. tunnel.dark_mm=8."
            )
        if not text:
            raise StationError(
                f"--set {_short(key)}= has no value; KEY=none unsets a key, KEY='\"\"' is an empty "
                f"text."
            )
        if any(places(key) == places(other) for other in values):
            raise StationError(f"--set {_short(key)} stands twice; set each key once.")
        if text == "none" and text not in choices(Station, places(key)):
            values[key] = None
        else:
            values[key] = _value(key, text)
    return station.replace(**values) if values else station


def _value(key: str, text: str) -> Any:
    """Return a TOML value, or the text itself where it is none."""
    import tomllib

    from gpuspec.errors import StationError

    try:
        table = tomllib.loads(f"value = {text}")
    except tomllib.TOMLDecodeError:
        return text
    except ValueError:  # Python reads no integer of more than 4,300 digits
        raise StationError(f"--set {_short(key)}: the number is too long.") from None
    except RecursionError:
        raise StationError(f"--set {_short(key)}: the value is nested too deeply.") from None
    return table["value"] if len(table) == 1 else text


def _short(text: str) -> str:
    return text if len(text) <= 60 else text[:57] + "..."
