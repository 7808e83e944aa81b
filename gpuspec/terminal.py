"""What every command says and takes alike: options, changes to a station, terminal, progress."""

from __future__ import annotations

import errno
import io
import os
import sys
from collections.abc import Iterable, Iterator
from contextlib import contextmanager, suppress
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any, TextIO

import typer

if TYPE_CHECKING:
    from rich.console import Console

    from gpuspec.files import Outputs
    from gpuspec.station import Station

StationArgument = Annotated[Path, typer.Argument(help="Station file (TOML).")]
BackendOption = Annotated[
    str,
    typer.Option(
        "--backend", help="auto, opencl, opengl, vulkan or numpy; a named one is never swapped."
    ),
]
DeviceOption = Annotated[
    str | None, typer.Option("--device", help="Part of a device's name, or its number.")
]


def folder(given: str | Path) -> Path:
    """Return a folder for results as it was named; an empty name is an error."""
    from gpuspec.files import folder_of

    return folder_of(given)


OutputOption = Annotated[
    Path,
    typer.Option("-o", "--output", parser=folder, metavar="FOLDER", help="For the results."),
]
ForceOption = Annotated[
    bool,
    typer.Option("--force", help="Replace files that are not known to be an earlier run's, too."),
]
FramesOption = Annotated[bool, typer.Option("--frames", help="Write every image of the sequence.")]
PicturesOption = Annotated[bool, typer.Option("--pictures/--no-pictures", help="Draw pictures.")]
SetOption = Annotated[
    list[str] | None,
    typer.Option("--set", metavar="KEY=VALUE", help="Change a key, e.g. tunnel.dark_mm=8."),
]


def changed(station: Station, changes: list[str] | None) -> Station:
    """Apply KEY=VALUE changes; values are TOML."""
    import tomllib

    from gpuspec.errors import StationError

    values: dict[str, Any] = {}
    for change in changes or ():
        key, equals, value = change.partition("=")
        if not equals:
            raise StationError(f"--set {change}: write it as KEY=VALUE, e.g. tunnel.dark_mm=8.")
        try:
            values[key.strip()] = tomllib.loads(f"value = {value}")["value"]
        except tomllib.TOMLDecodeError:
            values[key.strip()] = value.strip()
        except RecursionError:
            raise StationError(f"--set {key}: the value is nested too deeply.") from None
    return station.replace(**values) if values else station


def print_notes(notes: Iterable[str]) -> None:
    """Print what is to be known before a result is trusted, a line each."""
    from rich.text import Text

    out = console()
    for note in notes:
        out.print(Text.assemble(("note: ", "yellow"), note), soft_wrap=True)


def print_assumptions(assumed: Iterable[str]) -> None:
    """Print what is taken as ideal, a line each."""
    from rich.text import Text

    out = console()
    for one in assumed:
        out.print(Text.assemble(("assumed: ", "dim"), one), soft_wrap=True)


@contextmanager
def progress() -> Iterator[Any]:
    """Say on the terminal what is being done; silent where nobody watches."""
    from rich.text import Text

    with console(stderr=True).status("starting") as status:
        yield lambda text: status.update(Text(text))


@contextmanager
def counted(total: int) -> Iterator[Any]:
    """Count on the terminal what is done, how fast, and how long it still takes."""
    from rich.progress import (
        BarColumn,
        MofNCompleteColumn,
        Progress,
        TextColumn,
        TimeElapsedColumn,
        TimeRemainingColumn,
    )

    bar = Progress(
        TextColumn("{task.description}"), BarColumn(), MofNCompleteColumn(),
        TimeElapsedColumn(), TextColumn("left"), TimeRemainingColumn(elapsed_when_finished=True),
        console=console(stderr=True), transient=True,
    )  # fmt: skip
    with bar:
        task = bar.add_task("starting", total=total)
        yield lambda text, done, of: bar.update(task, description=text, completed=done, total=of)


def note_space(*outputs: Outputs) -> None:
    """Say on the error stream, before the work, what will take much of the disk."""
    for note in (one.space.note for one in outputs if one.space):
        if note:
            console(stderr=True).print(f"note: {note}", soft_wrap=True)


def show_warnings_as_notes() -> None:
    """Print gpuspec's own warnings as a line that begins with "note:", on the error stream."""
    import warnings

    from gpuspec.errors import DeviceWarning

    usual = warnings.showwarning

    def show(message: Any, category: type[Warning], *where: Any, **more: Any) -> None:
        if issubclass(category, DeviceWarning):
            console(stderr=True).print(f"note: {message}", soft_wrap=True)
        else:
            usual(message, category, *where, **more)

    warnings.simplefilter("always", DeviceWarning)
    warnings.showwarning = show


@contextmanager
def extra(name: str) -> Iterator[None]:
    """Say which extra of gpuspec to install where one of its packages is missing.

    Raises
    ------
    ExtraError
        In place of ModuleNotFoundError.
    """
    from gpuspec.errors import ExtraError

    try:
        yield
    except ModuleNotFoundError as error:
        if (error.name or "").partition(".")[0] == "gpuspec":
            raise
        raise ExtraError(
            f'this needs {error.name}, which is not installed; pip install "gpuspec[{name}]" '
            f'(in a checkout: pip install ".[{name}]").'
        ) from None


def console(*, stderr: bool = False) -> Console:
    """Return a terminal that prints names as they are: ``[a]`` and ``:b:`` mean nothing in them."""
    from rich.console import Console

    return Console(stderr=stderr, markup=False, emoji=False, highlight=False)


class _Stdout:
    """Standard output; what cannot be written to it is a sentence, and a closed pipe no error."""

    def __init__(self, stream: TextIO) -> None:
        self._stream = stream

    def write(self, text: str) -> int:
        with self._told():
            return self._stream.write(text)

    def flush(self) -> None:
        with self._told():
            self._stream.flush()

    def __getattr__(self, name: str) -> Any:
        return getattr(self._stream, name)

    @contextmanager
    def _told(self) -> Iterator[None]:
        try:
            yield
        except OSError as error:
            with suppress(OSError, ValueError):  # else Python tries the rest again when it ends
                os.dup2(os.open(os.devnull, os.O_WRONLY), self._stream.fileno())
            if error.errno == errno.EPIPE:
                sys.exit(1)
            from gpuspec.errors import OutputError

            raise OutputError(
                f"standard output cannot be written: {error.strerror}; choose another place for "
                f"what is printed. Results in folders are not affected."
            ) from None


@contextmanager
def standard_output() -> Iterator[None]:
    """Print to standard output; what cannot be is an OutputError, before the context ends."""
    stdout = sys.stdout
    if stdout is None or stdout.closed:
        yield
        return
    if isinstance(stdout, io.TextIOWrapper):
        # A name that the terminal cannot show must not end a run.
        stdout.reconfigure(errors="backslashreplace")
    told = _Stdout(stdout)
    sys.stdout = told
    try:
        try:
            yield
        finally:
            told.flush()
    finally:
        sys.stdout = stdout
