"""What every command says and takes alike: options, changes to a station, terminal, progress."""

from __future__ import annotations

import errno
import io
import os
import re
import sys
from collections.abc import Iterable, Iterator
from contextlib import contextmanager, suppress
from typing import TYPE_CHECKING, Any, TextIO

if TYPE_CHECKING:
    from pathlib import Path

    from rich.console import Console
    from rich.text import Text

    from gpuspec.files import Outputs


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


@contextmanager
def kept_in(output: Path) -> Iterator[None]:
    """Say where what was finished is, when Ctrl-C ends it."""
    try:
        yield
    except BaseException as error:
        if not isinstance(error, Exception):
            console(stderr=True).print(
                f"what was finished is in {output}; the same command goes on with it.",
                soft_wrap=True,
            )
        raise


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
        raise ExtraError.of(error, name) from None


def console(*, stderr: bool = False) -> Console:
    """Return a terminal that prints names as they are: ``[a]`` and ``:b:`` mean nothing in them.

    What is printed with ``soft_wrap`` is one line in a file or a pipe. On a terminal its lines end
    between words, and what is longer than a line, say a path, is left whole.
    """
    from rich.console import Console
    from rich.text import Text

    class Terminal(Console):
        def print(self, *objects: Any, **style: Any) -> None:
            if style.get("soft_wrap") and self.is_terminal:
                objects = tuple(
                    _between_words(Text(thing) if isinstance(thing, str) else thing, self.width)
                    for thing in objects
                )
            super().print(*objects, **style)

    return Terminal(stderr=stderr, markup=False, emoji=False, highlight=False)


def _between_words(text: Text, width: int) -> Text:
    """Break a text into lines of so many letters, each of whole words."""
    from rich.text import Text

    start, breaks = 0, []
    for word in re.finditer(r"\S+\s*", text.plain):
        if word.start() > start and len(text.plain[start : word.end()].rstrip()) > width:
            start = word.start()
            breaks.append(start)
    lines = text.divide(breaks)
    for line in lines[:-1]:
        line.rstrip()
    return Text("\n").join(lines)


class _Stdout:
    """Standard output; what cannot be written to it is a sentence, and a closed pipe no error."""

    def __init__(self, stream: TextIO) -> None:
        self._stream = stream
        self._failure: Exception | None = None

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
        if self._failure:  # whoever tried the stream first may have kept it to himself
            raise self._failure
        try:
            yield
        except OSError as error:
            with suppress(OSError, ValueError):  # else Python tries the rest again when it ends
                os.dup2(os.open(os.devnull, os.O_WRONLY), self._stream.fileno())
            if error.errno == errno.EPIPE:
                sys.exit(1)
            from gpuspec.errors import OutputError

            self._failure = OutputError(
                f"standard output cannot be written: {error.strerror}; choose another place for "
                f"what is printed. Results in folders are not affected."
            )
            raise self._failure from None


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
