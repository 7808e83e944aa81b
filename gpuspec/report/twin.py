"""What a fit leaves behind: the twin's station file, its numbers and its picture."""

from __future__ import annotations

import json
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Any, Protocol

from gpuspec.errors import OutputError
from gpuspec.files import Outputs
from gpuspec.frames.fringes import Measured
from gpuspec.frames.texture import Texture
from gpuspec.light.backend import DeviceInfo
from gpuspec.pictures.twin import Fitted
from gpuspec.station.station import Station
from gpuspec.version import __version__


@dataclass(frozen=True)
class Number:
    """One thing that was found.

    Attributes
    ----------
    name, unit : str
    measured : Measured
        With its standard uncertainty.
    meaning : str
        The station's key that it stands in, or what it is.
    """

    name: str
    unit: str
    measured: Measured
    meaning: str


class Defects(Protocol):
    """Which defects a station finds; as :class:`gpuspec.captured.smallest.Smallest` explains."""

    def as_dict(self) -> list[dict[str, Any]]:
        """Return it as JSON holds it."""


class Reported(Fitted, Protocol):
    """A fit with all that is written of it; as :class:`gpuspec.captured.fit.Fit` explains."""

    @property
    def station(self) -> Station:
        """The twin."""

    @property
    def numbers(self) -> tuple[Number, ...]:
        """What was found."""

    @property
    def unknown(self) -> tuple[str, ...]:
        """What was not."""

    @property
    def smallest(self) -> Defects | None:
        """Which defects it finds."""

    @property
    def info(self) -> DeviceInfo:
        """What simulated it."""

    @property
    def warnings(self) -> tuple[str, ...]:
        """What to know before."""


def outputs(path: str | Path, read: tuple[Path, ...] = (), *, force: bool = False) -> Outputs:
    """Return what a fit will write, to be checked before it and written after it.

    Parameters
    ----------
    path : str or Path
        Of the station file.
    read : tuple of Path
        Files that are never replaced.
    force : bool
        Whether files are replaced that are not known to be of an earlier fit of this name.

    Raises
    ------
    OutputError
        If it is no name of a TOML file.
    """
    path = Path(path)
    if path.suffix != ".toml":
        raise OutputError(f"a twin is written to a station file, NAME.toml, not to {str(path)!r}.")
    names = tuple(f"{path.stem}{end}" for end in (".toml", ".json", ".png"))
    return Outputs(path.parent, f"twin {path.stem}", names, read, force=force)


def write_files(result: Reported, folder: Path, name: str) -> None:
    """Write a fit's files straight into an existing folder.

    Parameters
    ----------
    result : Reported
    folder : Path
    name : str
        Of the files, without their ends.
    """
    from gpuspec.pictures.page import png
    from gpuspec.pictures.twin import twin_picture

    result.station.write(folder / f"{name}.toml")
    text = json.dumps(summary(result), indent=2, ensure_ascii=False) + "\n"
    (folder / f"{name}.json").write_text(text, "utf-8")
    (folder / f"{name}.png").write_bytes(png(twin_picture(result)))


def summary(result: Reported) -> dict[str, Any]:
    """Return the content of the JSON: numbers, what is unknown, real against twin, defects.

    Parameters
    ----------
    result : Reported
    """
    return {
        "gpuspec": __version__,
        "device": result.info.as_dict(),
        "frames": result.about,
        "light": result.kind,
        "numbers": {
            one.name: {
                "value": one.measured.value, "uncertainty": one.measured.uncertainty,
                "unit": one.unit, "meaning": one.meaning,
            }
            for one in result.numbers
        },
        "unknown": list(result.unknown),
        "real": asdict(result.real),
        "twin": asdict(result.twin),
        "smallest_defects": result.smallest.as_dict() if result.smallest else None,
        "warnings": list(result.warnings),
    }  # fmt: skip


def compared(real: Texture, twin: Texture) -> list[tuple[str, str, str]]:
    """Return rows that hold the frames' aspect image against the twin's.

    Parameters
    ----------
    real, twin : Texture
    """
    return [
        ("flawless level, DN", f"{real.level_dn:.2f}", f"{twin.level_dn:.2f}"),
        ("ripple with the light's phase, DN rms", f"{real.ripple_dn:.3f}", f"{twin.ripple_dn:.3f}"),
        ("noise, 1.5 to 25 px, DN", f"{real.noise_dn:.3f}", f"{twin.noise_dn:.3f}"),
        ("noise of a pixel, DN", f"{real.pixel_noise_dn:.3f}", f"{twin.pixel_noise_dn:.3f}"),
    ]
