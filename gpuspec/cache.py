"""Where gpuspec, and what it uses, keep what may be lost: a folder that this user can write."""

from __future__ import annotations

import os
import tempfile
from functools import cache
from pathlib import Path


@cache
def folder() -> Path | None:
    """Return a folder for what may be lost, made if missing; None where nothing can be written.

    It is the platform's own (``~/.cache/gpuspec`` on Linux) or, where that cannot be written, one
    that only this user can open among the temporary files.
    """
    return _usual() or _temporary()


def lend(variable: str, name: str) -> None:
    """Point an environment variable to a folder of ours where the usual caches cannot be written.

    Parameters
    ----------
    variable : str
        What another program looks at, e.g. ``POCL_CACHE_DIR``; left alone if it is set.
    name : str
        Of the folder.
    """
    if variable in os.environ or _usual() or not folder():
        return
    path = _made(Path(str(folder()), name))
    if path:
        os.environ[variable] = str(path)


@cache
def _usual() -> Path | None:
    import platformdirs  # slow to import

    try:
        return _made(platformdirs.user_cache_path("gpuspec", appauthor=False))
    except RuntimeError:  # no home folder can be found
        return None


def _temporary() -> Path | None:
    user = os.getuid() if hasattr(os, "getuid") else os.environ.get("USERNAME", "user")
    path = _made(Path(tempfile.gettempdir()) / f"gpuspec-{user}")
    if path is None or not hasattr(os, "getuid"):
        return path
    # In a folder that all can write, somebody else may have made one of this name.
    state = path.lstat()
    return path if state.st_uid == user and not state.st_mode & 0o077 else None


def _made(path: Path) -> Path | None:
    try:
        path.mkdir(mode=0o700, parents=True, exist_ok=True)
    except OSError:
        return None
    return path if os.access(path, os.W_OK | os.X_OK) else None
