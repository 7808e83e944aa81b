"""Files that are written: whole or not at all, and never over what is not gpuspec's own."""

from __future__ import annotations

import errno
import glob
import hashlib
import json
import os
import platform
import shutil
import stat
import sys
import tempfile
from collections.abc import Iterable, Iterator, Mapping
from contextlib import contextmanager, suppress
from dataclasses import dataclass, field, replace
from itertools import count
from pathlib import Path
from typing import Any

from gpuspec.errors import OutputError

if sys.platform != "win32":
    import fcntl

MANIFEST = ".gpuspec.json"
"""Hidden file of a folder that tells what gpuspec wrote there, and what it held."""

# Of hidden folders; a process number tells nothing about another machine on a shared disk.
_PREFIX = f".gpuspec-{platform.node() or 'local'}-"
# A larger file is known by its size and its ends: it is not read twice.
_LARGE, _END = 64 * 2**20, 2**20
_MUCH = 10**9

Known = dict[str, set[str]]
"""Names of files, and the digests of what gpuspec wrote into them."""


@dataclass(frozen=True)
class Space:
    """What a command will write, about.

    Attributes
    ----------
    bytes : int
        All files together.
    what : str
        What takes so much, e.g. "100,000 images of 600 x 300 pixels".
    way : str
        What to do about it, e.g. "take fewer images with --set sequence.images=N".
    """

    bytes: int
    what: str
    way: str

    @property
    def note(self) -> str | None:
        """What to say before the work is begun; None: it is little."""
        if self.bytes < _MUCH:
            return None
        return f"{self.what} will take about {_gigabytes(self.bytes)} on disk."

    def check(self, folder: Path) -> None:
        """Refuse what the disk cannot hold, before any work.

        Raises
        ------
        OutputError
            With what there is and what it needs.
        """
        above = _nearest(folder)
        disk = shutil.disk_usage(above)
        free = disk.free
        if disk.total and self.bytes > free:  # one without a size tells nothing
            raise OutputError(
                f"{self.what} need about {_gigabytes(self.bytes)} on disk and "
                f"{_gigabytes(free)} are free at {above}; {self.way}, or choose another folder "
                f"with -o."
            )


class InTheWayError(OutputError):
    """A folder holds what is not to be replaced."""


@dataclass(frozen=True)
class Outputs:
    """Files for a folder: checked before the work, moved there whole after it.

    What gpuspec wrote earlier and nobody changed since is replaced; nothing else is, unless forced.

    Attributes
    ----------
    folder : Path
        Made if missing.
    kind : str
        What the files are, e.g. "run": only files of the same kind are replaced.
    names : tuple of str
        Every file that may be written, relative to the folder.
    inputs : tuple of Path
        What is read meanwhile: never replaced, not even by force.
    force : bool
        Whether files are replaced that are not known to be of this kind.
    of : mapping of str to str
        What the files belong to, e.g. a rule: those of another are not replaced.
    over : tuple of str
        Other kinds whose files are replaced, too.
    space : Space, optional

    Examples
    --------
    >>> from pathlib import Path
    >>> from gpuspec.files import Outputs
    >>> with Outputs(Path("out"), "run", ("score.json",), ()).writing() as folder:
    ...     _ = (folder / "score.json").write_text("{}")
    >>> Path("out/score.json").read_text()
    '{}'
    """

    folder: Path
    kind: str
    names: tuple[str, ...]
    inputs: tuple[Path, ...] = ()
    force: bool = False
    of: Mapping[str, str] = field(default_factory=dict)
    over: tuple[str, ...] = ()
    space: Space | None = None

    def check(self) -> None:
        """Refuse what could not be written at the end, or would replace what is not gpuspec's own.

        Raises
        ------
        OutputError
            With the file in the way.
        """
        with _told(self.folder):
            above = _nearest(self.folder)
            if not above.is_dir():
                raise OutputError(f"{above} is a file; choose another folder with -o.")
            if self.space:
                self.space.check(self.folder)
            if self.folder.is_dir():
                with _alone(self.folder):
                    self._check_folder()
            _try_writing(self.folder, above)

    def apart(self) -> Outputs:
        """Return these outputs in the first of folder, folder-2 ... with nothing in the way.

        Raises
        ------
        OutputError
            As :meth:`check`, for other reasons.
        """
        for number in count(1):
            one = self if number == 1 else self._numbered(number)
            try:
                one.check()
            except InTheWayError:
                continue
            return one
        raise AssertionError

    @contextmanager
    def writing(self) -> Iterator[Path]:
        """Give a hidden folder to write in; on success its files move, else it vanishes.

        Files of an earlier run that this one did not write are removed with the move, so that a
        folder never mixes two runs. What a killed run left hidden is removed by the next one
        beside it.

        Raises
        ------
        OutputError
            As :meth:`check`, before anything is done; or if the folder cannot be written, or the
            disk is full.
        """
        self.check()
        partial: Path | None = None
        try:
            with _told(self.folder):
                above = _nearest(self.folder)
                _remove_left_behind(above)
                partial = Path(tempfile.mkdtemp(prefix=f"{_PREFIX}{os.getpid()}-", dir=above))
                partial.chmod(0o755)
                yield partial
                self._publish(partial)
        finally:
            if partial is not None:
                shutil.rmtree(partial, ignore_errors=True)

    def _check_folder(self) -> None:
        manifest = _manifest(self.folder)
        names = dict.fromkeys((*self.names, *self._known(manifest)))
        for name in (*names, MANIFEST):
            self._check_place(self.folder / name)
        if not self.force:
            self._check_known(manifest, names)

    def _check_place(self, path: Path) -> None:
        if path.parent != self.folder and os.path.lexists(path.parent) and not path.parent.is_dir():
            raise OutputError(f"{path.parent} is a file; choose another folder with -o.")
        if path.is_dir():
            raise OutputError(f"{path} is a folder; choose another folder with -o.")
        if any(_same(path, one) for one in self.inputs):
            raise OutputError(
                f"{path} is read here, and results would replace it; choose another folder with -o."
            )

    def _check_known(self, manifest: Mapping[str, Any], names: Iterable[str]) -> None:
        known = self._known(manifest)
        reasons: dict[str, str] = {}
        for name in names:
            path = self.folder / name
            if not os.path.lexists(path):
                continue
            others = (kind for kind, entry in manifest.items() if name in entry["files"])
            if name not in known:
                owner = next(others, None)
                earlier = f"it is not known to be of an earlier {self.kind}"
                reasons[name] = f"it belongs to a {owner}" if owner else earlier
            elif not path.is_file() or digest(path) not in known[name]:
                reasons[name] = "it was changed since gpuspec wrote it"
        if reasons:
            name, reason = next(iter(reasons.items()))
            more = f" ({len(reasons) - 1} more files, too)" if len(reasons) > 1 else ""
            raise InTheWayError(
                f"{self.folder / name} is in the way: {reason}{more}. Choose another folder with "
                f"-o, or --force to write there all the same."
            )
        held = manifest.get(self.kind, _NOTHING)["of"]
        if any(os.path.lexists(self.folder / name) for name in known):
            for word in sorted({*held, *self.of}):
                if held.get(word) != self.of.get(word):
                    raise InTheWayError(
                        f"{self.folder} holds a {self.kind} of another {word}: "
                        f"{held.get(word, 'none')} there and {self.of.get(word, 'none')} here; "
                        f"choose another folder with -o, or --force to replace it."
                    )

    def _known(self, manifest: Mapping[str, Any]) -> Known:
        """Return the files of the folder that these may replace."""
        known: Known = {}
        for kind in (self.kind, *self.over):
            for name, digests in manifest.get(kind, _NOTHING)["files"].items():
                known.setdefault(name, set()).update(digests)
        return known

    def _publish(self, partial: Path) -> None:
        digests = {
            path.relative_to(partial).as_posix(): digest(path)
            for path in sorted(partial.rglob("*"))
            if path.is_file()
        }
        self.folder.mkdir(parents=True, exist_ok=True)
        with _alone(self.folder):
            try:
                self._check_folder()
            except OutputError as error:
                there = self._beside()
                there._move(partial, digests)
                raise OutputError(
                    f"{error} As the work was done already, the results are in {there.folder}."
                ) from None
            try:
                self._move(partial, digests)
            except OSError:
                raise
            except BaseException:  # Ctrl-C: all is there, so finish what takes no time
                self._move(partial, digests)
                raise

    def _beside(self) -> Outputs:
        """Return these outputs in a new folder beside, where nothing is in the way."""
        for number in count(2):
            beside = self._numbered(number)
            try:
                beside.folder.mkdir()
            except FileExistsError:
                continue
            return beside
        raise AssertionError

    def _numbered(self, number: int) -> Outputs:
        folder = self.folder if self.folder.name not in ("", "..") else self.folder.resolve()
        return replace(self, folder=folder.with_name(f"{folder.name}-{number}"))

    def _move(self, partial: Path, digests: Mapping[str, str]) -> None:
        """Move files from the hidden folder, and remove those of an earlier run.

        In between the manifest knows both: a killed run leaves no file that is not known.
        """
        manifest = _manifest(self.folder)
        known = self._known(manifest)
        for kind in self.over:
            manifest.pop(kind, None)
        for entry in manifest.values():
            for name in digests:
                entry["files"].pop(name, None)
        entry = manifest[self.kind] = {"of": dict(self.of), "files": {}}
        for name in {*known, *digests}:
            own = {digests[name]} if name in digests else set()
            entry["files"][name] = sorted(known.get(name, set()) | own)
        _write_manifest(self.folder, manifest, partial)
        for path in sorted(partial.rglob("*")):
            if path.is_file() and path.name != MANIFEST:
                target = self.folder / path.relative_to(partial)
                target.parent.mkdir(exist_ok=True)
                path.replace(target)
        for name in known.keys() - digests.keys():
            path = self.folder / name
            if path.is_file() and digest(path) in known[name]:
                path.unlink()
                if path.parent != self.folder:
                    with suppress(OSError):  # something else is in it
                        path.parent.rmdir()
        entry["files"] = {name: [one] for name, one in sorted(digests.items())}
        _write_manifest(self.folder, manifest, partial)


def check_together(*outputs: Outputs) -> None:
    """Check the outputs of one command, and that none of them is written twice.

    Raises
    ------
    OutputError
        As :meth:`Outputs.check`.
    """
    seen: set[Path] = set()
    for one in outputs:
        one.check()
        places = {one.folder.resolve() / name for name in one.names}
        for path in sorted(places & seen):
            raise OutputError(f"{path} would be written twice; choose another name for one of the "
                              f"two.")  # fmt: skip
        seen |= places


def folder_of(given: str | Path) -> Path:
    """Return a folder for results as it was named.

    Raises
    ------
    OutputError
        If it is no path, or the name is empty or blank, which Python takes for the current folder.
    """
    if not isinstance(given, (str, Path)):
        raise OutputError(f"a folder for results is named by its path, not {given!r}.")
    if not str(given).strip():
        raise OutputError("the folder for results has no name; write -o . for the current folder.")
    return Path(given)


def check_new(path: Path, *, force: bool = False, inputs: Iterable[Path] = ()) -> None:
    """Refuse a new file's name before any work.

    Parameters
    ----------
    path : Path
    force : bool
        Whether an existing file is replaced.
    inputs : iterable of Path
        Never replaced, not even by force.

    Raises
    ------
    OutputError
        If something of this name is there, or the file could not be written.
    """
    with _told_of(path):
        if not stat.S_ISDIR(path.parent.stat().st_mode):
            raise NotADirectoryError(errno.ENOTDIR, os.strerror(errno.ENOTDIR))
        if not os.access(path.parent, os.W_OK):
            raise PermissionError(errno.EACCES, os.strerror(errno.EACCES))
        try:
            path.lstat()
        except FileNotFoundError:
            return
    if path.is_dir():
        raise OutputError(f"{path} is a folder; name a file in it.")
    if any(_same(path, one) for one in inputs):
        raise OutputError(f"{path} is read here, and would be replaced; choose another name.")
    if not force:
        raise OutputError(f"{path} exists already; choose another name, or --force to replace it.")


def write_new(
    path: Path, text: str, *, force: bool = False, inputs: Iterable[Path] = ()
) -> None:  # fmt: skip
    """Write a new text file whole; parameters and refusals as :func:`check_new`.

    Parameters
    ----------
    path : Path
    text : str
        Written as UTF-8.
    force : bool
        Whether a file that is there is replaced.
    inputs : iterable of Path
        Files that are never replaced.

    Raises
    ------
    OutputError
        If it exists, or cannot be written.
    """
    check_new(path, force=force, inputs=inputs)
    partial: Path | None = None
    try:
        with _told_of(path):
            with tempfile.NamedTemporaryFile(
                "w", prefix=".gpuspec-", dir=path.parent, delete=False, encoding="utf-8"
            ) as file:
                partial = Path(file.name)
                file.write(text)
            partial.chmod(0o644)
            partial.replace(path)
    finally:
        if partial is not None:
            partial.unlink(missing_ok=True)


def digest(path: Path) -> str:
    """Return the SHA-256 of a file; of a large one that of its size and ends."""
    with path.open("rb") as file:
        size = os.fstat(file.fileno()).st_size
        if size <= _LARGE:
            return hashlib.file_digest(file, "sha256").hexdigest()
        found = hashlib.sha256(f"{size} bytes".encode())
        found.update(file.read(_END))
        file.seek(-_END, os.SEEK_END)
        found.update(file.read())
        return found.hexdigest()


def changed(folder: Path, kind: str, names: Iterable[str]) -> list[str]:
    """Return which files of a folder no longer hold what gpuspec wrote into them.

    Parameters
    ----------
    folder : Path
    kind : str
        Of the files, see :class:`Outputs`; of those that are not known nothing is said.
    names : iterable of str
        Relative to the folder.
    """
    known = _manifest(folder).get(kind, _NOTHING)["files"]
    there = (name for name in names if name in known and (folder / name).is_file())
    return [name for name in there if digest(folder / name) not in known[name]]


_NOTHING: dict[str, dict[str, Any]] = {"of": {}, "files": {}}


def _manifest(folder: Path) -> dict[str, dict[str, Any]]:
    """Return what gpuspec wrote into a folder: by kind, what it is of, and names with digests.

    A manifest that is none tells nothing, so that nothing is replaced.
    """
    try:
        found = json.loads((folder / MANIFEST).read_text("utf-8"))
        return {
            str(kind): {
                "of": {str(word): str(value) for word, value in entry["of"].items()},
                "files": {
                    str(name): {str(one) for one in digests}
                    for name, digests in entry["files"].items()
                    if _inside(name)
                },
            }
            for kind, entry in found.items()
        }
    except (OSError, ValueError, TypeError, KeyError, AttributeError, RecursionError):
        return {}


def _inside(name: str) -> bool:
    """Whether a name stays in its folder, or in one of that."""
    places = name.split("/")
    return len(places) <= 2 and all(one not in ("", ".", "..") for one in places)


def _write_manifest(folder: Path, manifest: Mapping[str, Any], partial: Path) -> None:
    kept = {kind: entry for kind, entry in sorted(manifest.items()) if entry["files"]}
    text = json.dumps(kept, indent=1, default=sorted) + "\n"
    (partial / MANIFEST).write_text(text, "utf-8")
    (partial / MANIFEST).replace(folder / MANIFEST)


def _nearest(folder: Path) -> Path:
    """Return the folder, or the nearest one above it that is there."""
    for place in (folder.absolute(), *folder.absolute().parents):
        try:
            place.lstat()
        except (FileNotFoundError, NotADirectoryError):
            continue
        return place
    raise FileNotFoundError(errno.ENOENT, os.strerror(errno.ENOENT))


def _try_writing(folder: Path, above: Path) -> None:
    """Make what is missing of a folder once, hidden, and remove it; OSError if it cannot be."""
    with tempfile.TemporaryDirectory(prefix=f"{_PREFIX}{os.getpid()}-", dir=above) as trial:
        missing = folder.absolute().relative_to(above).parts
        if ".." not in missing:
            Path(trial, *missing).mkdir(parents=True, exist_ok=True)


def _same(path: Path, other: Path) -> bool:
    """Whether two names are of one file, through links too."""
    try:
        return path.samefile(other)
    except OSError:
        return False


@contextmanager
def _told(folder: Path) -> Iterator[None]:
    """Say what cannot be written where, why, and what next."""
    try:
        yield
    except OSError as error:
        # NumPy reports a short write without its reason.
        reason = error.strerror or f"the disk may be full ({error})"
        full = error.errno in (None, errno.ENOSPC, errno.EDQUOT, errno.EFBIG)
        way = "Free some space or choose" if full else "Choose"
        raise OutputError(
            f"results cannot be written to {folder}: {reason}. {way} another folder "
            f"with -o; nothing half-written was left."
        ) from None


@contextmanager
def _told_of(path: Path) -> Iterator[None]:
    """Say why one file cannot be written, and what next."""
    try:
        yield
    except OSError as error:
        raise OutputError(
            f"{path} cannot be written: {error.strerror or error}; choose another place."
        ) from None


@contextmanager
def _alone(folder: Path) -> Iterator[None]:
    """Let other processes wait while this one looks at a folder's files or moves some there."""
    if sys.platform == "win32":
        yield
        return
    handle = os.open(folder, os.O_RDONLY)
    try:
        with suppress(OSError):  # a disk without locks
            fcntl.flock(handle, fcntl.LOCK_EX)
        yield
    finally:
        os.close(handle)


def _remove_left_behind(above: Path) -> None:
    """Remove the hidden folders of this machine's runs that were killed: their process is gone."""
    if os.name != "posix":  # there, signal 0 would end the process it asks about
        return
    for left in above.glob(f"{glob.escape(_PREFIX)}*-*"):
        number = left.name.removeprefix(_PREFIX).partition("-")[0]
        if not number.isdecimal():
            continue
        try:
            os.kill(int(number), 0)
        except ProcessLookupError:
            shutil.rmtree(left, ignore_errors=True)
        except (OSError, OverflowError):
            continue


def _gigabytes(size: int) -> str:
    return f"{size / 1e9:,.1f} GB" if size > 1e8 else f"{size / 1e6:,.1f} MB"
