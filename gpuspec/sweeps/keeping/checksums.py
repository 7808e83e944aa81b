"""What the files of a sweep's table held when they were written."""

from __future__ import annotations

import hashlib
import os
from collections.abc import Mapping
from pathlib import Path


def checksum(data: bytes) -> str:
    """Return the SHA-256 of a file's bytes."""
    return hashlib.sha256(data).hexdigest()


class Checksums:
    """A line for each file, as ``sha256sum --check`` reads them.

    A file's line is added before the file gets its name: with a new line an earlier file is still
    known, so that a process may be killed at any time.

    Parameters
    ----------
    folder : Path
        Of the sweep.
    name : str
        Of the file that holds the lines.
    """

    def __init__(self, folder: Path, name: str = "sweep.sha256") -> None:
        self.path = folder / name
        self._lines: set[str] = set()

    def exist(self) -> bool:
        """Whether there are any: not in a sweep of before there were checksums."""
        return self.path.exists()

    def hold(self, file: Path, found: str) -> bool:
        """Whether a file was written with this checksum; parameters as :meth:`add`."""
        line = self._line(file, found)
        if line not in self._lines and self.exist():  # another process may have written since
            self._lines = set(self.path.read_text("ascii", errors="replace").splitlines())
        return line in self._lines

    def add(self, file: Path, found: str) -> None:
        """Add a file's checksum.

        Parameters
        ----------
        file : Path
        found : str
            Its checksum.
        """
        with self.path.open("ab+") as lines:
            if lines.tell():
                lines.seek(-1, os.SEEK_END)
                if lines.read() != b"\n":  # a killed process left half a line
                    lines.write(b"\n")
            lines.write(f"{self._line(file, found)}\n".encode())

    def text(self, found: Mapping[Path, str]) -> str:
        """Return the lines of some files, which are to stand in place of all."""
        return "".join(f"{self._line(file, one)}\n" for file, one in found.items())

    def _line(self, file: Path, found: str) -> str:
        return f"{found}  {file.relative_to(self.path.parent).as_posix()}"
