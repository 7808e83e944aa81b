"""A data set's folder: filled part by part, each whole or not there, and gone on with."""

from __future__ import annotations

import hashlib
import json
import shutil
import tempfile
from collections import Counter
from collections.abc import Iterable, Iterator, Mapping
from contextlib import contextmanager, suppress
from pathlib import Path
from typing import Any

from gpuspec.datasets.plan import SPLITS, DataSetPlan
from gpuspec.errors import OutputError
from gpuspec.files import MANIFEST, Outputs, Space, folder_of
from gpuspec.station.toml import copies
from gpuspec.sweeps.keeping.writing import PARTIAL, taken_lock, write_whole, writes_to

KIND = "data set"
IDENTITY = "dataset.json"
LOCK = "dataset.lock"
CHECKSUMS = "dataset.sha256"
PARTS = "parts"
ANNOTATIONS = tuple(f"annotations/{split}.json" for split in SPLITS)
PICTURES = ("contact.png", "histograms.png")
SHEET = "README.md"
_OF_PARTS = ("images", "masks", "fusions", "frames", PARTS)
_MASK_BYTES = 0.05  # a pixel, about, with a part's record
Record = dict[str, Any]


class DataSetFolder:
    """The folder of one data set.

    ``dataset.json`` says which one; ``parts/`` holds a record of each part: what is known of it
    and the SHA-256 of its files, written after them. The annotations are made of the records.

    Parameters
    ----------
    path : Path
    plan : DataSetPlan
    """

    def __init__(self, path: str | Path, plan: DataSetPlan) -> None:
        self.path = folder_of(path)
        self.plan = plan

    def __repr__(self) -> str:
        return f"DataSetFolder({self.path}: {len(self.numbers())} parts)"

    def outputs(self, parts: int) -> Outputs:
        """Return what is written when all parts are there.

        Parameters
        ----------
        parts : int
            Of the whole data set.
        """
        names = (SHEET, CHECKSUMS, *PICTURES, *ANNOTATIONS)
        own = ("station.toml", *copies(self.plan.station, "station").values())
        station = self.plan.station
        return Outputs(self.path, KIND, (*names, *own), station.inputs, space=self._space(parts))

    def _space(self, parts: int) -> Space:
        station, kept = self.plan.station, self.plan.kept
        rows, columns = station.shape
        bytes_ = kept.bits / 8 if kept.format == "tif" else kept.bits / 16  # a PNG packs
        images = 1 + 4 * kept.fusions
        pixel = images * bytes_ + _MASK_BYTES + kept.frames * station.sequence.images
        left = max(parts - len(self.numbers()), 0)
        return Space(
            round(left * rows * columns * pixel),
            f"{left:,} parts of {columns:,} x {rows:,} pixels",
            "make fewer with -n" + (", or leave --frames out" if kept.frames else ""),
        )

    def check(self, parts: int) -> None:
        """Refuse a folder that is neither new, nor empty, nor this data set's.

        Parameters
        ----------
        parts : int
            Of the whole data set.

        Raises
        ------
        OutputError
            With what is in the way.
        """
        with writes_to(self.path, "the data set"):
            self._check_path()
            more = [number for number in self.numbers() if number > parts]
        if more:
            raise OutputError(
                f"{self.path} holds {max(more)} parts of this data set already; ask for as many or "
                f"more, or choose another folder with -o."
            )
        self.outputs(parts).check()

    def _check_path(self) -> None:
        if self.path.exists() and not self.path.is_dir():
            raise OutputError(f"{self.path} is a file; choose another folder with -o.")
        if (self.path / IDENTITY).exists():
            differ = _differences(self._identity(), self.plan.identity())
            if differ:
                raise OutputError(
                    f"{self.path} holds another data set: {'; '.join(differ)}. Choose another "
                    f"folder with -o, or the same data set to go on with it."
                )
        elif self.path.is_dir():
            others = sorted(p.name for p in self.path.iterdir() if p.name not in (LOCK, MANIFEST))
            if others:
                raise OutputError(
                    f"{self.path} holds other files ({others[0]}) and no {IDENTITY}; choose an "
                    f"empty folder, or that of the data set to go on with, with -o."
                )

    def _identity(self) -> Record:
        try:
            found = json.loads((self.path / IDENTITY).read_text("utf-8"))
        except ValueError:
            found = None
        if not isinstance(found, dict) or set(found) != set(self.plan.identity()):
            raise OutputError(
                f"{self.path / IDENTITY} is not that of a data set; choose another folder with -o."
            )
        return found

    @contextmanager
    def writing(self, parts: int) -> Iterator[None]:
        """Hold the folder to write parts into it; what a killed process left half is removed.

        Parameters
        ----------
        parts : int
            Of the whole data set.

        Raises
        ------
        OutputError
            As :meth:`check`, or if another process writes there or it cannot be written.
        """
        self.check(parts)
        with writes_to(self.path, "the data set"):
            self.path.mkdir(parents=True, exist_ok=True)
            lock = taken_lock(self.path, LOCK)
        try:
            with writes_to(self.path, "the data set"):
                self._check_path()
                for left in self.path.glob(f"{PARTIAL}*"):
                    shutil.rmtree(left)
                for name in _OF_PARTS:
                    (self.path / name).mkdir(exist_ok=True)
                if not (self.path / IDENTITY).exists():
                    text = json.dumps(self.plan.identity(), indent=1) + "\n"
                    write_whole(self.path / IDENTITY, lambda file: file.write_text(text, "utf-8"))
            yield
        finally:
            for name in _OF_PARTS:
                with suppress(OSError):  # something is in it
                    (self.path / name).rmdir()
            lock.release()

    def numbers(self) -> list[int]:
        """Return the numbers of the parts that are there."""
        names = (path.stem for path in (self.path / PARTS).glob("*.json"))
        return sorted(int(name) for name in names if name.isdecimal())

    def sound(self, number: int) -> bool:
        """Whether a part is there, and its files are as they were written.

        Parameters
        ----------
        number : int
            Of the part.
        """
        try:
            held = self.record(number)["files"]
            return all(
                _digest((self.path / name).read_bytes()) == sha for name, sha in held.items()
            )
        except (OSError, OutputError):
            return False

    def record(self, number: int) -> Record:
        """Return the record of a part.

        Parameters
        ----------
        number : int

        Raises
        ------
        OutputError
            If it is damaged.
        """
        path = self._record(number)
        try:
            found: Record = json.loads(path.read_text("utf-8"))
            if {"image", "annotations", "files"} <= set(found):
                return found
        except (OSError, ValueError, TypeError):
            pass
        raise OutputError(
            f"{path} is damaged; the same command into the same folder makes the part again."
        )

    def _record(self, number: int) -> Path:
        return self.path / PARTS / f"{number:06}.json"

    def add(self, record: Record, files: Iterable[tuple[str, bytes]]) -> None:
        """Write a part: its files, then the record that tells they are whole.

        Parameters
        ----------
        record : dict
            Its ``image`` and ``annotations``.
        files : iterable of tuple of str and bytes
            Their names in the folder and what they hold.

        Raises
        ------
        OutputError
            If the disk is full; the part is then not there.
        """
        number = record["image"]["id"]
        with writes_to(self.path, "the data set"):
            self._record(number).unlink(missing_ok=True)  # of files that are not whole any more
            partial = Path(tempfile.mkdtemp(prefix=PARTIAL, dir=self.path))
            try:
                digests = {}
                for name, data in files:
                    digests[name] = _digest(data)
                    (partial / "file").write_bytes(data)
                    (partial / "file").replace(self.path / name)
                text = json.dumps({**record, "files": digests}) + "\n"
                (partial / "file").write_text(text, "utf-8")
                (partial / "file").replace(self._record(number))
            finally:
                shutil.rmtree(partial, ignore_errors=True)


def _digest(data: bytes) -> str:
    return hashlib.sha256(data).hexdigest()


def _differences(old: Mapping[str, Any], new: Mapping[str, Any]) -> list[str]:
    """Return what differs between two data sets, a few words each."""
    plain = [name for name in new if name not in ("station", "files")]
    said = [
        f"{name} is {_shown(old[name])} there and {_shown(new[name])} here"
        for name in plain
        if old[name] != new[name]
    ]
    said += [
        f"{name} holds something else than there"
        for name in sorted({*old["files"], *new["files"]})
        if old["files"].get(name) != new["files"].get(name)
    ]
    if old["station"] != new["station"]:
        there, here = (Counter(one["station"].splitlines()) for one in (old, new))
        only = [list((there - here).elements()), list((here - there).elements())]
        shown = " and ".join(
            f"{', '.join(part[:3]) or 'nothing'} {where}"
            for part, where in zip(only, ("there", "here"), strict=True)
        )
        said.append(f"the station has {shown}")
    return said


def _shown(value: object) -> str:
    if isinstance(value, bool):
        return "written" if value else "left out"
    return str(value) or "none"
