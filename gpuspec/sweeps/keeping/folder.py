"""A sweep's folder: what the sweep is, and its table in parts, each whole or not there at all."""

from __future__ import annotations

import hashlib
import json
import shutil
from collections.abc import Iterator, Mapping, Sequence
from contextlib import contextmanager
from pathlib import Path
from typing import Any, Self

import pyarrow as pa
import pyarrow.parquet as pq

from gpuspec.errors import OutputError, StationError
from gpuspec.files import Space, folder_of
from gpuspec.shown import html_page, html_table
from gpuspec.sweeps.keeping.checksums import Checksums, checksum
from gpuspec.sweeps.keeping.writing import PARTIAL, taken_lock, write_whole, writes_to
from gpuspec.sweeps.plan import Plan
from gpuspec.sweeps.trying.rows import schema

BYTES_PER_ROW = 3_000  # about: 2.2 KB exact, 5 KB with bounds, measured on the trim part


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
    word = "sweep"
    """Of what it holds, and the command that writes it."""
    stem = "sweep"
    """Of the names of its files beside the table."""
    table_name = "designs"
    """Folder of the table's files."""

    def __init__(self, path: Path, plan: Any) -> None:
        self.path = path
        self.plan: Plan = plan
        self._schema = self.schema()
        self._sound: dict[int, str] = {}  # files that hold what was written, and their checksums
        self._checksums = Checksums(path, f"{self.stem}.sha256")

    def schema(self) -> pa.Schema:
        """Return the columns of its table."""
        return schema(self.plan)

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
            return cls(path, Plan.from_identity(cls._identity_in(path)))
        except (StationError, TypeError, ValueError, KeyError, AttributeError) as error:
            raise OutputError(f"{path / 'sweep.json'} is not that of a sweep ({error}).") from None

    @classmethod
    @contextmanager
    def writing(cls, path: str | Path, plan: Any) -> Iterator[Self]:
        """Open a sweep's folder to write, a new one or one to go on with.

        Parameters
        ----------
        path : str or Path
        plan : Plan
            Or what a folder of another kind is of.

        Yields
        ------
        RunFolder
            Of this class.

        Raises
        ------
        OutputError
            If the folder holds another sweep, or anything else; another process is writing to it;
            or it cannot be written.
        """
        run = cls(folder_of(path), plan)
        run.check_folder()
        with writes_to(run.path, f"the {cls.word}"):
            (run.path / cls.table_name).mkdir(parents=True, exist_ok=True)
            lock = taken_lock(run.path, f"{cls.stem}.lock")
        try:
            with writes_to(run.path, f"the {cls.word}"):
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
        with writes_to(self.path, f"the {self.word}"):
            if self.path.exists() and not self.path.is_dir():
                raise OutputError(f"{self.path} is a file; choose another folder with -o.")
            if self.identity_file.exists():
                differ = differences(self._identity_in(self.path), self.plan.identity())
                if differ:
                    raise OutputError(
                        f"{self.path} holds another {self.word}: {'; '.join(differ)}. Choose "
                        f"another folder with -o, or the same {self.word} to go on with it."
                    )
                return
            table = self.path / self.table_name
            own = (f"{self.stem}.lock", self.table_name, self._checksums.path.name)
            folders = [folder for folder in (self.path, table) if folder.is_dir()]
            others = [p.name for folder in folders for p in folder.iterdir()]
            others = [name for name in others if name not in own]
            if others or (table.exists() and not table.is_dir()):
                raise OutputError(
                    f"{self.path} holds other files ({[*others, self.table_name][0]}) and no "
                    f"{self.stem}.json; choose an empty folder, or that of the {self.word} to go "
                    f"on with, with -o."
                )

    def is_begun(self) -> bool:
        """Whether the folder holds this very sweep, begun or finished."""
        try:
            return not differences(self._identity_in(self.path), self.plan.identity())
        except OutputError:
            return False

    def _begin(self) -> None:
        self.check_folder()
        if not self.identity_file.exists():
            text = json.dumps(self.plan.identity(), indent=1) + "\n"
            write_whole(self.identity_file, lambda file: file.write_text(text, "utf-8"))
        for left in self.path.rglob(f"{PARTIAL}*"):  # of a killed run: the lock is ours
            shutil.rmtree(left) if left.is_dir() else left.unlink()

    @property
    def identity_file(self) -> Path:
        """Path of the file that says what it holds."""
        return self.path / f"{self.stem}.json"

    @property
    def name(self) -> str:
        """A few words that tell this sweep from others."""
        text = self.identity_file.read_bytes()
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
        return self.path / self.table_name / f"part-{number:08}.parquet"

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
        there = {path.name for path in (self.path / self.table_name).glob("part-*.parquet")}
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
        with writes_to(self.path, f"the {self.word}"):
            write_whole(
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
            table = pq.ParquetFile(self.file(number)).read(columns)
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
        import pyarrow.dataset as ds  # slow to import

        return ds.dataset(self.path / self.table_name, format="parquet").to_table(columns=columns)

    def repair(self) -> None:
        """Remove damaged files, so that they are missing; while nobody else writes.

        The files of a folder of before there were checksums get theirs: what reads whole is sound.

        Raises
        ------
        OutputError
            If the folder cannot be written.
        """
        with writes_to(self.path, f"the {self.word}"):
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
        with writes_to(self.path, f"the {self.word}"):
            write_whole(self._checksums.path, lambda file: file.write_text(text, "ascii"))

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
                self._check_rows(number, pq.ParquetFile(pa.BufferReader(data)).read())
        except (pa.ArrowException, OSError) as error:
            raise self._damage(number, str(error)) from None
        self._sound[number] = found

    def _check_rows(self, number: int, table: pa.Table) -> None:
        if len(table) != len(self.designs_of(number)):
            raise pa.ArrowInvalid(f"{len(table)} rows of {len(self.designs_of(number))}")

    def _damage(self, number: int, why: str) -> OutputError:
        return OutputError(
            f"{self.file(number)} is damaged ({why}); the same `gpuspec {self.word}` into the "
            f"same folder tries its designs again."
        )

    @classmethod
    def _identity_in(cls, path: Path) -> dict[str, Any]:
        file, word = path / f"{cls.stem}.json", cls.word
        try:
            found: dict[str, Any] = json.loads(file.read_text("utf-8"))
        except (FileNotFoundError, NotADirectoryError):
            raise OutputError(
                f"{path} holds no {word}; `gpuspec {word} STATION -o {path}` makes one."
            ) from None
        except OSError as error:
            raise OutputError(
                f"{file} cannot be read: {error.strerror or error}; make it readable."
            ) from None
        except ValueError:
            raise OutputError(
                f"{file} is damaged, and nothing else says which {word} {path} "
                f"holds; put it back from a copy, or choose another folder with -o."
            ) from None
        kinds = {
            "gpuspec": str,
            "station": str,
            "files": dict,
            "vary": dict,
            "parts": int,
            "samples": int,
            "seeds": int,
        }
        if (
            not isinstance(found, dict)
            or set(found) != set(kinds)
            or not all(isinstance(found[name], kind) for name, kind in kinds.items())
            or not all(isinstance(values, list) for values in found["vary"].values())
        ):
            raise OutputError(f"{file} is not that of a {word}; choose another folder with -o.")
        return found


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
    for name in ("parts", "seeds", "samples", "gpuspec"):
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
