"""A sweep's folder: what the sweep is, and its table in parts, each whole or not there at all."""

from __future__ import annotations

import hashlib
import json
import os
import shutil
import tempfile
from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import contextmanager
from pathlib import Path
from typing import Any

import pyarrow as pa
import pyarrow.dataset as ds
import pyarrow.parquet as pq
from filelock import FileLock, Timeout

from gpuspec.errors import OutputError, StationError
from gpuspec.files import Space, folder_of
from gpuspec.shown import html_page, html_table
from gpuspec.sweeps.keeping import checksums
from gpuspec.sweeps.keeping.checksums import Checksums, checksum
from gpuspec.sweeps.plan import Plan
from gpuspec.sweeps.trying.rows import schema

BYTES_PER_ROW = 3_000  # about: 2.2 KB exact, 5 KB with bounds, measured on the trim part
_IDENTITY = "sweep.json"
_LOCK = "sweep.lock"
_TABLE = "designs"
_PARTIAL = ".partial-"


class RunFolder:
    """The folder of one sweep.

    ``sweep.json`` says which sweep it is; ``designs/`` holds the table, 512 rows a file, which
    pandas, Polars and DuckDB read as one; ``sweep.sha256`` the checksum of each file, a line each,
    as ``sha256sum --check`` reads them; ``sweep.lock`` is held while a sweep writes.

    Parameters
    ----------
    path : Path
    plan : Plan
    """

    rows_per_file = 512

    def __init__(self, path: Path, plan: Plan) -> None:
        self.path = path
        self.plan = plan
        self._schema = schema(plan)
        self._sound: dict[int, str] = {}  # files that hold what was written, and their checksums
        self._checksums = Checksums(path)

    def __repr__(self) -> str:
        there = self.there()
        done = "all there" if there == self.plan.designs else f"{there:,} there"
        return f"RunFolder({self.path}: {self.plan.designs:,} designs, {done})"

    def _repr_html_(self) -> str:
        """Show itself in a notebook: what is varied. What is best, :func:`gpuspec.choose` shows."""
        axes = [
            {"key": a.key, "from": a.values[0], "to": a.values[-1], "values": len(a.values)}
            for a in self.plan.axes
        ]
        return html_page(self) + html_table(axes, len(axes))

    @classmethod
    def read(cls, path: str | Path) -> RunFolder:
        """Open the folder of a sweep to read it.

        Raises
        ------
        OutputError
            If there is none.

        Examples
        --------
        >>> station = gpuspec.example("trim").replace(camera__sampling_mm=0.5)
        >>> _ = gpuspec.sweep(gpuspec.Plan.of(station, {"sensor.exposure": [2, 4]}), "sweep")
        >>> run = gpuspec.RunFolder.read("sweep")
        >>> run.plan.axes[0].key, run.there()
        ('sensor.exposure', 2)
        """
        if not isinstance(path, (str, Path)):
            raise OutputError(
                f"a sweep is a RunFolder or the path of its folder, not {type(path).__name__}."
            )
        path = Path(path)
        try:
            return cls(path, Plan.from_identity(_identity_in(path)))
        except (StationError, TypeError, ValueError, KeyError, AttributeError) as error:
            raise OutputError(f"{path / _IDENTITY} is not that of a sweep ({error}).") from None

    @classmethod
    @contextmanager
    def writing(cls, path: str | Path, plan: Plan) -> Iterator[RunFolder]:
        """Open a sweep's folder to write, a new one or one to go on with.

        Parameters
        ----------
        path : str or Path
        plan : Plan

        Yields
        ------
        RunFolder

        Raises
        ------
        OutputError
            If the folder holds another sweep, or anything else; another process is writing to it;
            or it cannot be written.
        """
        run = cls(folder_of(path), plan)
        run.check_folder()
        with writes_to(run.path):
            (run.path / _TABLE).mkdir(parents=True, exist_ok=True)
            lock = taken_lock(run.path, _LOCK)
        try:
            with writes_to(run.path):
                run._begin()
            yield run
        finally:
            lock.release()

    def check_folder(self) -> None:
        """Refuse a path that is not a new folder's, an empty one's, or this sweep's.

        Raises
        ------
        OutputError
            With what differs, if it holds another sweep.
        """
        with writes_to(self.path):
            if self.path.exists() and not self.path.is_dir():
                raise OutputError(f"{self.path} is a file; choose another folder with -o.")
            if (self.path / _IDENTITY).exists():
                differ = differences(_identity_in(self.path), self.plan.identity())
                if differ:
                    raise OutputError(
                        f"{self.path} holds another sweep: {'; '.join(differ)}. Choose another "
                        f"folder with -o, or the same sweep to go on with it."
                    )
                return
            table = self.path / _TABLE
            folders = [folder for folder in (self.path, table) if folder.is_dir()]
            others = [p.name for folder in folders for p in folder.iterdir()]
            others = [name for name in others if name not in (_LOCK, _TABLE, checksums.NAME)]
            if others or (table.exists() and not table.is_dir()):
                raise OutputError(
                    f"{self.path} holds other files ({', '.join([*others, _TABLE][:1])}) and no "
                    f"{_IDENTITY}; choose an empty folder, or that of the sweep to go on with, "
                    f"with -o."
                )

    def is_begun(self) -> bool:
        """Whether the folder holds this very sweep, begun or finished."""
        try:
            return not differences(_identity_in(self.path), self.plan.identity())
        except OutputError:
            return False

    def _begin(self) -> None:
        self.check_folder()
        if not (self.path / _IDENTITY).exists():
            text = json.dumps(self.plan.identity(), indent=1) + "\n"
            _write_whole(self.path / _IDENTITY, lambda file: file.write_text(text, "utf-8"))
        for left in self.path.rglob(f"{_PARTIAL}*"):  # of a killed run: the lock is ours
            shutil.rmtree(left) if left.is_dir() else left.unlink()

    @property
    def name(self) -> str:
        """A few words that tell this sweep from others."""
        text = (self.path / _IDENTITY).read_bytes()
        return f"{self.plan.designs:,} designs ({hashlib.sha256(text).hexdigest()[:8]})"

    def check_valid(self) -> None:
        """See that some design of the table is valid.

        Raises
        ------
        StationError
            With the first reason, if none is.
        """
        if all(not table["reason"].null_count for table in self.batches(["reason"])):
            reason = self.read_file(0, ["reason"])["reason"][0].as_py()
            raise StationError(f"no design of the sweep is a valid station, e.g.: {reason}")

    def invalid(self) -> tuple[int, str] | None:
        """Return how many designs are no valid station and why the first is none; None: none."""
        count, first = 0, ""
        for table in self.batches(["reason"]):
            reasons = table["reason"].drop_null()
            first = first or (reasons[0].as_py() if len(reasons) else "")
            count += len(reasons)
        return (count, first) if count else None

    def there(self) -> int:
        """Return how many designs the folder holds."""
        missing = sum(len(self.designs_of(number)) for number in self.missing())
        return self.plan.designs - missing

    @property
    def files(self) -> int:
        """Number of files of a finished table."""
        return -(-self.plan.designs // self.rows_per_file)

    def designs_of(self, number: int) -> range:
        """Return the designs of a file."""
        first = number * self.rows_per_file
        return range(first, min(first + self.rows_per_file, self.plan.designs))

    def file(self, number: int) -> Path:
        """Return the path of a file of the table."""
        return self.path / _TABLE / f"part-{number:08}.parquet"

    def damaged(self) -> list[int]:
        """Return the files that are there, but do not hold what was written."""
        found = []
        for number in self._there():
            try:
                self._verify(number)
            except OutputError:
                found.append(number)
        return found

    def _there(self) -> list[int]:
        return sorted(set(range(self.files)) - set(self.missing()))

    def missing(self) -> list[int]:
        """Return the files still to be written."""
        there = {path.name for path in (self.path / _TABLE).glob("part-*.parquet")}
        return [number for number in range(self.files) if self.file(number).name not in there]

    def write(self, number: int, table: pa.Table) -> None:
        """Write a file of the table, in place of an earlier one.

        Parameters
        ----------
        number : int
            Of the file.
        table : pyarrow.Table
            Its rows.

        Raises
        ------
        OutputError
            If the disk is full or the folder gone; the file is then as it was.
        """
        words = [f.name for f in self._schema if not pa.types.is_nested(f.type)]
        sink = pa.BufferOutputStream()
        pq.write_table(table.cast(self._schema), sink, compression="zstd", use_dictionary=words)
        data = sink.getvalue()
        found = checksum(data)
        with writes_to(self.path):
            _write_whole(
                self.file(number),
                lambda file: file.write_bytes(data),
                # Before the file has its name: with a new checksum an earlier file is sound, too.
                lambda: self._checksums.add(self.file(number), found),
            )
        self._sound[number] = found

    def read_file(self, number: int, columns: Sequence[str] | None = None) -> pa.Table:
        """Read a file of the table.

        Parameters
        ----------
        number : int
            Of the file.
        columns : sequence of str, optional
            None: all.

        Raises
        ------
        OutputError
            If it is damaged.
        """
        self._verify(number)
        try:
            table = pq.read_table(self.file(number), columns=columns, partitioning=None)
            self._check_rows(number, table)
            return table
        except (pa.ArrowException, OSError) as error:
            raise self._damage(number, str(error)) from None

    def batches(self, columns: Sequence[str] | None = None) -> Iterator[pa.Table]:
        """Yield the table file by file, those that are there, in their order.

        Examples
        --------
        >>> station = gpuspec.example("trim").replace(camera__sampling_mm=0.5)
        >>> run = gpuspec.sweep(gpuspec.Plan.of(station, {"sensor.exposure": [2, 4]}), "sweep")
        >>> for table in run.batches(["design", "best_hits"]):
        ...     print(table.to_pylist())
        [{'design': 0, 'best_hits': 33}, {'design': 1, 'best_hits': 33}]
        """
        for number in self._there():
            yield self.read_file(number, columns)

    def table(self, columns: Sequence[str] | None = None) -> pa.Table:
        """Return the whole table, or some columns of it.

        Raises
        ------
        OutputError
            If a file is damaged.
        """
        for number in self._there():
            self._verify(number)
        return ds.dataset(self.path / _TABLE, format="parquet").to_table(columns=columns)

    def repair(self) -> None:
        """Remove damaged files, so that they are missing; while nobody else writes.

        The files of a folder of before there were checksums get theirs: what reads whole is sound.

        Raises
        ------
        OutputError
            If the folder cannot be written.
        """
        with writes_to(self.path):
            for number in self.damaged():
                self.file(number).unlink()
        if not self._checksums.exist():
            self.seal()

    def seal(self) -> None:
        """Write the checksums anew: of the files as they are, once each.

        Raises
        ------
        OutputError
            If the disk is full, or a file is damaged.
        """
        for number in self._there():
            self._verify(number)
        found = {self.file(number): one for number, one in sorted(self._sound.items())}
        text = self._checksums.text(found)
        with writes_to(self.path):
            _write_whole(self._checksums.path, lambda file: file.write_text(text, "ascii"))

    def _verify(self, number: int) -> None:
        """Read a file and compare its checksum, once.

        Raises
        ------
        OutputError
            If it is not what was written.
        """
        if number in self._sound:
            return
        try:
            data = self.file(number).read_bytes()
            found = checksum(data)
            if not self._checksums.hold(self.file(number), found):
                if self._checksums.exist():
                    raise self._damage(number, "its checksum is not that of what was written")
                self._check_rows(number, pq.read_table(pa.BufferReader(data)))
        except (pa.ArrowException, OSError) as error:
            raise self._damage(number, str(error)) from None
        self._sound[number] = found

    def _check_rows(self, number: int, table: pa.Table) -> None:
        if len(table) != len(self.designs_of(number)):
            raise pa.ArrowInvalid(f"{len(table)} rows of {len(self.designs_of(number))}")

    def _damage(self, number: int, why: str) -> OutputError:
        return OutputError(
            f"{self.file(number)} is damaged ({why}); the same `gpuspec sweep` into the same "
            f"folder tries its designs again."
        )


def differences(old: Mapping[str, Any], new: Mapping[str, Any]) -> list[str]:
    """Return what differs between two sweeps' identities, a few words each.

    Parameters
    ----------
    old, new : mapping
        As :meth:`Plan.identity` gives them.
    """
    said = []
    for name in sorted({*old["vary"], *new["vary"]}):
        was, now = old["vary"].get(name), new["vary"].get(name)
        if was != now:
            said.append(f"{name} is {_values(was)} there and {_values(now)} here")
    for name in ("parts", "samples", "gpuspec"):
        if old[name] != new[name]:
            shown = "the number of pixels of --screen" if name == "samples" else name
            said.append(f"{shown} is {old[name]} there and {new[name]} here")
    for name in sorted({*old["files"], *new["files"]}):
        if old["files"].get(name) != new["files"].get(name):
            said.append(f"{name} holds something else than there")
    if old["station"] != new["station"]:
        lines = [set(one["station"].splitlines()) for one in (old, new)]
        only = [sorted(lines[0] - lines[1]), sorted(lines[1] - lines[0])]
        shown = " and ".join(
            f"{', '.join(part[:3]) or 'nothing'} {where}"
            for part, where in zip(only, ("there", "here"), strict=True)
        )
        said.append(f"the station has {shown}")
    return said


def _values(values: Sequence[Any] | None) -> str:
    if not values:
        return "not varied"
    shown = ", ".join(f"{v:g}" for v in values[:4])
    return f"{shown}, ... ({len(values)} values)" if len(values) > 4 else shown


def check_space(path: Path, plan: Plan) -> None:
    """Refuse a sweep whose table the disk cannot hold.

    Parameters
    ----------
    path : Path
        Of the sweep's folder.
    plan : Plan

    Raises
    ------
    OutputError
        With what there is and what it needs.
    """
    with writes_to(path):
        space(plan).check(path)


def space(plan: Plan) -> Space:
    """Return about what a sweep's table takes on disk."""
    return Space(table_bytes(plan), f"{plan.designs:,} designs", "vary fewer values")


def table_bytes(plan: Plan) -> int:
    """Return about how large a sweep's table is."""
    return plan.designs * BYTES_PER_ROW * (2 if plan.samples else 1)


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


def _write_whole(path: Path, write: Any, before: Callable[[], None] = lambda: None) -> None:
    """Write a file under another name and rename it; what is to be done `before` that is."""
    partial = Path(tempfile.mkdtemp(prefix=_PARTIAL, dir=path.parent))
    try:
        file = partial / path.name
        write(file)
        with file.open("rb") as written:  # a power cut must not leave an empty file of this name
            os.fsync(written.fileno())
        before()
        file.replace(path)
    finally:
        shutil.rmtree(partial, ignore_errors=True)


def _identity_in(path: Path) -> dict[str, Any]:
    try:
        found: dict[str, Any] = json.loads((path / _IDENTITY).read_text("utf-8"))
    except (FileNotFoundError, NotADirectoryError):
        raise OutputError(
            f"{path} holds no sweep; `gpuspec sweep STATION -o {path}` makes one."
        ) from None
    except OSError as error:
        raise OutputError(
            f"{path / _IDENTITY} cannot be read: {error.strerror or error}; make it readable."
        ) from None
    except ValueError:
        raise OutputError(
            f"{path / _IDENTITY} is damaged, and nothing else says which sweep {path} holds; put "
            f"it back from a copy, or sweep into another folder with -o."
        ) from None
    kinds = {
        "gpuspec": str,
        "station": str,
        "files": dict,
        "vary": dict,
        "parts": int,
        "samples": int,
    }
    if (
        not isinstance(found, dict)
        or set(found) != set(kinds)
        or not all(isinstance(found[name], kind) for name, kind in kinds.items())
        or not all(isinstance(values, list) for values in found["vary"].values())
    ):
        raise OutputError(
            f"{path / _IDENTITY} is not that of a sweep; choose another folder with -o."
        )
    return found
