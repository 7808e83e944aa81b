"""The way through: parts are traced one after another, and written beside it."""

from __future__ import annotations

import os
from collections import deque
from collections.abc import Callable, Iterator, Mapping
from concurrent.futures import Future, ThreadPoolExecutor
from contextlib import contextmanager
from dataclasses import dataclass
from numbers import Integral
from pathlib import Path
from typing import Any

from gpuspec.datasets import coco
from gpuspec.datasets.files import files
from gpuspec.datasets.folder import ANNOTATIONS, CHECKSUMS, PARTS, DataSetFolder, Record
from gpuspec.datasets.plan import PARTS_MAX, SPLITS, DataSetPlan, Format, Kept
from gpuspec.datasets.sample import Taken, known, taken
from gpuspec.datasets.sheet import write_sheet
from gpuspec.errors import StationError
from gpuspec.light.backend import Backend
from gpuspec.light.devices import open_backend
from gpuspec.shown import object_of
from gpuspec.station.station import Station
from gpuspec.station.toml import keep

Progress = Callable[[str, int, int], None]
"""Told what is being done, how many parts are done, and of how many."""


@dataclass(frozen=True)
class DataSetMade:
    """A data set in its folder.

    Attributes
    ----------
    folder : Path
    plan : DataSetPlan
    parts : dict of str to int
        How many there are in each split.
    defects : dict of str to int
        How many annotations there are of each category.
    found : int
        How many of them the station's own threshold finds.
    made : int
        Parts made now; the others were there.
    """

    folder: Path
    plan: DataSetPlan
    parts: dict[str, int]
    defects: dict[str, int]
    found: int
    made: int

    def __repr__(self) -> str:
        said = {
            "images": ", ".join(f"{count} to {split}" for split, count in self.parts.items()),
            "defects": ", ".join(f"{count} {name}" for name, count in self.defects.items()),
        }
        return object_of("DataSetMade", f"{self.folder}: {sum(self.parts.values())} parts", said)

    def annotations(self, split: str = "train") -> Path:
        """Return the path of a split's COCO file.

        Parameters
        ----------
        split : str
            ``"train"``, ``"validation"`` or ``"test"``.

        Raises
        ------
        StationError
            If there is no such split.
        """
        if split not in SPLITS:
            raise StationError(f"there is no split {split!r}, but {', '.join(SPLITS)}.")
        return self.folder / ANNOTATIONS[SPLITS.index(split)]

    @property
    def images(self) -> Path:
        """The folder in which the annotations' file names are."""
        return self.folder / "images"


def dataset(
    station: Station | str | Path | DataSetPlan,
    n: int,
    folder: str | Path,
    *,
    vary: Mapping[str, Any] | None = None,
    seed: int | None = None,
    format: Format = "png",
    bits: int = 8,
    fusions: bool = False,
    frames: bool = False,
    licence: str = "",
    backend: str | Backend = "auto",
    device: str | None = None,
    progress: Progress | None = None,
) -> DataSetMade:
    """Make a data set of images, masks and COCO annotations, or go on with one.

    Parameters
    ----------
    station : Station, str, Path or DataSetPlan
        A station, the path of its file, or a plan, which says the rest.
    n : int
        Parts, each with an image; more may be asked for later.
    folder : str or Path
        Of a new data set, or of this one to go on with.
    vary : mapping of str to str or list, optional
        What is drawn for each part, e.g. ``{"sensor.exposure": [2, 6]}``; None: the station's
        ``[dataset.vary]`` table.
    seed : int, optional
        Of the parts and draws; None: the table's.
    format : {"png", "tif"}
        Of the images.
    bits : {8, 16, 32}
        A pixel; 32: floats in DN, in a TIFF.
    fusions, frames : bool
        Whether the other fusions and every image of the sequence are written, too.
    licence : str
        Of the data set, e.g. ``"CC-BY-4.0"``; "": none is stated.
    backend : str or Backend
        A name for :func:`gpuspec.light.devices.open_backend`, or an open backend.
    device : str, optional
        Part of the device's name, or its number.
    progress : callable, optional

    Returns
    -------
    DataSetMade

    Raises
    ------
    StationError
        If no defect is random, a key or range is wrong, or a population does not fit.
    OutputError
        If the folder holds another data set, cannot be written, or the disk is too small.
    BackendError
        If the device is absent or fails.

    Examples
    --------
    >>> station = gpuspec.example("trim").replace(camera__sampling_mm=0.5)
    >>> made = gpuspec.dataset(station, 6, "learn", vary={"sensor.exposure": [2, 6]})
    >>> made
    DataSetMade(learn: 6 parts)
      images: 4 to train, 1 to validation, 1 to test
      defects: 86 dent, 65 scratch, 38 bump
    >>> made.annotations("test").as_posix()
    'learn/annotations/test.json'
    """
    plan = station if isinstance(station, DataSetPlan) else DataSetPlan.of(
        station, vary, seed, Kept(format, bits, fusions, frames, licence)
    )  # fmt: skip
    if not isinstance(n, Integral) or isinstance(n, bool) or not 1 <= n <= PARTS_MAX:
        raise StationError(f"a data set has 1 to {PARTS_MAX:,} parts, not {n!r}.")
    n = int(n)
    run = DataSetFolder(folder, plan)
    tell = progress or (lambda *_: None)
    run.check(n)
    plan.station_of(1)
    with run.writing(n):
        tell("looking at what is there", 0, n)
        with _threads() as threads:
            there = zip(run.numbers(), threads.map(run.sound, run.numbers()), strict=True)
            done = {number for number, sound in there if sound}
        missing = [number for number in range(1, n + 1) if number not in done]
        if missing:
            engine = open_backend(backend, device)
            tell("making parts", len(done), n)
            for count, _ in enumerate(_made(run, engine, missing), len(done) + 1):
                tell("making parts", count, n)
        tell("writing the annotations", n, n)
        return _finished(run, n, len(missing))


@contextmanager
def _threads() -> Iterator[ThreadPoolExecutor]:
    """Give threads for what needs no device; what has not begun when the block fails is left."""
    with ThreadPoolExecutor(min(os.cpu_count() or 1, 8), "gpuspec-dataset") as threads:
        try:
            yield threads
        except BaseException:
            threads.shutdown(cancel_futures=True)
            raise


def _made(run: DataSetFolder, engine: Backend, numbers: list[int]) -> Iterator[int]:
    """Make parts and yield the number of each that is written.

    The device takes the next images while threads inspect, pack and write the last ones; no more
    are held than there are threads, and one.
    """
    with _threads() as threads:
        begun: deque[Future[int]] = deque()
        for number in numbers:
            begun.append(threads.submit(_write, run, taken(run.plan, number, engine)))
            while len(begun) > threads._max_workers:
                yield begun.popleft().result()
        for one in begun:
            yield one.result()


def _write(run: DataSetFolder, of: Taken) -> int:
    record = {**known(of, run.plan), "made_by": of.info.as_dict()}
    run.add(record, files(of, run.plan.kept))
    return of.number


def _finished(run: DataSetFolder, n: int, made: int) -> DataSetMade:
    """Write what is told of all parts together."""
    records = [run.record(number) for number in range(1, n + 1)]
    tables = coco.tables(run.plan, records)
    with run.outputs(n).writing() as partial:
        coco.write(partial, tables)
        keep(run.plan.station, partial / "station.toml")
        write_sheet(partial, run, records)
        _write_checksums(partial, records, run)
    names = dict(enumerate(run.plan.categories, 1))
    every = [annotation for record in records for annotation in record["annotations"]]
    return DataSetMade(
        run.path, run.plan, {split: len(tables[split]["images"]) for split in SPLITS},
        {name: sum(a["category_id"] == number for a in every) for number, name in names.items()},
        sum(a["attributes"]["found"] for a in every), made,
    )  # fmt: skip


def _write_checksums(partial: Path, records: list[Record], run: DataSetFolder) -> None:
    """Write the SHA-256 of every file, as ``sha256sum --check`` reads them."""
    from gpuspec.files import digest

    lines = {name: sha for record in records for name, sha in record["files"].items()}
    for record in records:
        name = f"{PARTS}/{record['image']['id']:06}.json"
        lines[name] = digest(run.path / name)
    for path in sorted(partial.rglob("*")):
        if path.is_file():
            lines[path.relative_to(partial).as_posix()] = digest(path)
    text = "".join(f"{sha}  {name}\n" for name, sha in sorted(lines.items()))
    (partial / CHECKSUMS).write_text(text, "utf-8")
