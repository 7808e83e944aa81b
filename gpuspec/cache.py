"""Where gpuspec, and what it uses, keep what may be lost: a folder that this user can write."""

from __future__ import annotations

import os
import sys
import tempfile
from functools import cache
from pathlib import Path


@cache
def folder() -> Path | None:
    """Return a folder for what may be lost, made if missing; None where nothing can be written.

    It is the platform's own (``~/.cache/gpuspec`` on Linux) or, where that cannot be written, one
    among the temporary files that only this user can open.
    """
    return _usual() or _temporary()


def lend() -> None:
    """Lend that folder to the drivers and libraries of this process that would use ``~/.cache``.

    PoCL, pyopencl, Mesa and matplotlib look where ``XDG_CACHE_HOME`` points, and fail or complain
    where they cannot write. Call it before they are imported; it does nothing where they can.
    """
    if sys.platform == "linux" and not _usual():
        found = folder()
        if found:
            os.environ["XDG_CACHE_HOME"] = str(found.parent)


@cache
def _usual() -> Path | None:
    import platformdirs  # slow to import

    try:
        return _made(platformdirs.user_cache_path("gpuspec", appauthor=False))
    except RuntimeError:  # no home folder can be found
        return None


def _temporary() -> Path | None:
    user = os.getuid() if hasattr(os, "getuid") else os.environ.get("USERNAME", "user")
    above = _made(Path(tempfile.gettempdir()) / f"gpuspec-{user}")
    if above is None:
        return None
    state = above.lstat()
    # In a folder that all can write, somebody else may have made one of this name.
    if hasattr(os, "getuid") and (state.st_uid != user or state.st_mode & 0o077):
        return None
    return _made(above / "gpuspec")


def _made(path: Path) -> Path | None:
    try:
        path.mkdir(mode=0o700, parents=True, exist_ok=True)
    except OSError:
        return None
    return path if os.access(path, os.W_OK | os.X_OK) else None
