"""How a folder that is filled little by little is written: one process at a time, files whole."""

from __future__ import annotations

import os
import shutil
import tempfile
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any

from filelock import FileLock, Timeout

from gpuspec.errors import OutputError

PARTIAL = ".partial-"
"""How a folder begins in which a file is written before it has its name."""


def taken_lock(folder: Path, name: str) -> FileLock:
    """Return the lock of a folder, taken; a killed process leaves it free.

    Parameters
    ----------
    folder : Path
        An existing one.
    name : str
        Of the lock's file in it.

    Raises
    ------
    OutputError
        If another process holds it.
    """
    lock = FileLock(folder / name, timeout=0)
    try:
        lock.acquire()
    except Timeout:
        raise OutputError(
            f"{folder} is being written by another gpuspec; wait for it, or choose another folder "
            f"with -o."
        ) from None
    return lock


@contextmanager
def writes_to(path: Path, what: str = "the sweep") -> Iterator[None]:
    """Say what cannot be written where, why, and what next.

    Parameters
    ----------
    path : Path
    what : str
        Is written.

    Raises
    ------
    OutputError
        In place of an OSError.
    """
    try:
        yield
    except OSError as error:
        reason = error.strerror or str(error)
        raise OutputError(
            f"{what} cannot be written to {path}: {reason}. Free some space or make the folder "
            f"writable and run the same command again: it goes on where it was."
        ) from None


def write_whole(path: Path, write: Any, before: Callable[[], None] = lambda: None) -> None:
    """Write a file under another name and rename it.

    Parameters
    ----------
    path : Path
    write : callable
        Given the other name, writes it.
    before : callable
        Called when it is written and not yet renamed.
    """
    partial = Path(tempfile.mkdtemp(prefix=PARTIAL, dir=path.parent))
    try:
        file = partial / path.name
        write(file)
        with file.open("rb") as written:  # a power cut must not leave an empty file of this name
            os.fsync(written.fileno())
        before()
        file.replace(path)
    finally:
        shutil.rmtree(partial, ignore_errors=True)
