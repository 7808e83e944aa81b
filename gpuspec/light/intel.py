"""Intel's OpenCL runtime for CPUs, as pip installs it: made known to the OpenCL loader.

Its own `.icd` file holds a placeholder in place of the library's path, so the loader looks past it.
"""

from __future__ import annotations

import os
import shutil
import sys
import tempfile
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

_FOLDER = "OCL_ICD_VENDORS"  # of .icd files, in place of the system's
_SYSTEM = Path("/etc/OpenCL/vendors")
_FILES = "OCL_ICD_FILENAMES"  # libraries beside those of Windows' registry


def library() -> Path | None:
    """Return the runtime below ``sys.prefix``; None if it is not installed there."""
    places = {"linux": "lib/libintelocl.so", "win32": "Library/bin/intelocl64.dll"}
    place = places.get(sys.platform)
    return path if place and (path := Path(sys.prefix) / place).is_file() else None


@contextmanager
def known_to_loader() -> Iterator[None]:
    """Make the runtime known while the loader looks for platforms, which it does once a process.

    Where the user has chosen the platforms by the loader's own variable, nothing is changed.
    """
    found = library()
    variable = _FILES if sys.platform == "win32" else _FOLDER
    if found is None or os.environ.get(variable):
        yield
        return
    with tempfile.TemporaryDirectory(prefix="gpuspec-") as folder:
        if sys.platform != "win32":
            for icd in _SYSTEM.glob("*.icd"):  # this folder stands in for the system's
                shutil.copy(icd, folder)
            Path(folder, "gpuspec-intel.icd").write_text(f"{found}\n", encoding="utf-8")
        os.environ[variable] = str(found) if sys.platform == "win32" else folder
        try:
            yield
        finally:
            del os.environ[variable]
