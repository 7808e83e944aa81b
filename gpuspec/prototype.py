"""Prototype a light: a user's pattern, run in a process of its own that may fail or hang."""

from __future__ import annotations

import multiprocessing
import time
import warnings
from collections.abc import Callable, Iterator
from contextlib import ExitStack, contextmanager
from dataclasses import dataclass, replace
from multiprocessing.connection import Connection
from pathlib import Path
from typing import TYPE_CHECKING, Any

from gpuspec.errors import DeviceWarning, GpuspecError, OutputError, PatternError
from gpuspec.files import Outputs, Space, check_together
from gpuspec.light.patterns import Pattern
from gpuspec.station.station import Station

if TYPE_CHECKING:
    from gpuspec.simulation.result import Result

POLL_S = 0.05
_GIF = ".gif"


@dataclass(frozen=True)
class Rendered:
    """What one run of a pattern gave.

    Attributes
    ----------
    summary : dict
        As in `score.json`.
    seconds : float
        From the pattern's text to the files.
    """

    summary: dict[str, Any]
    seconds: float


@dataclass(frozen=True)
class Planned:
    """Where a pattern's files go.

    Attributes
    ----------
    results : Outputs
        Score, arrays and pictures.
    sequence : Outputs or None
        Of a GIF, or of the images as PNG.
    preview : Outputs or None
        Of what is seen first: of a glance, which is score and detection alone, in well under a
        second; None: every file is written.
    """

    results: Outputs
    sequence: Outputs | None
    preview: Outputs | None

    @property
    def animation(self) -> bool:
        """Whether the sequence is a GIF."""
        return self.sequence is not None and self.sequence.names[0].lower().endswith(_GIF)


def planned(
    station: Station,
    folder: Path,
    pattern: Path,
    frames: str = "",
    *,
    glance: bool = False,
    force: bool = False,
) -> Planned:
    """Plan where a pattern's files go, and check it before any work.

    Parameters
    ----------
    station : Station
    folder : Path
        For score, images and pictures. A glance never replaces those of a whole run.
    pattern : Path
        The pattern's file, or the name of a shipped one.
    frames : str
        A ``.gif`` to write the sequence to, or a folder for its images as PNG; "": neither.
    glance : bool
        Score and detection alone, and a preview before.
    force : bool
        Whether files are replaced that are not known to be of an earlier run.

    Raises
    ------
    OutputError
        If something is in the way or cannot be written, or `frames` is neither.
    """
    from gpuspec.report.folder import GLANCE, PREVIEW, outputs

    results = outputs(station, folder, force=force, also_read=(pattern,))
    preview = None
    if glance:
        results = replace(results, kind="glance", names=GLANCE, over=(), space=None)
        preview = replace(results, kind="preview", names=PREVIEW)
    sequence = _sequence(station, Path(frames), results) if frames else None
    check_together(results, *filter(None, (sequence, preview)))
    return Planned(results, sequence, preview)


def _sequence(station: Station, path: Path, results: Outputs) -> Outputs:
    rows, columns = station.shape
    images = station.sequence.images
    if path.suffix.lower() == _GIF:
        return replace(
            results, folder=path.parent, kind=f"sequence {path.name}", names=(path.name,),
            over=(), space=None,
        )  # fmt: skip
    if path.suffix and not path.is_dir():
        raise OutputError(
            f"--frames {path}: the sequence is written as a {_GIF}, or as PNGs into a "
            f"folder; write a folder's name without an ending."
        )
    size = rows * columns * images
    what = f"{images:,} images of {columns:,} x {rows:,} pixels"
    return replace(
        results, folder=path, kind="sequence", over=(),
        names=tuple(_image_name(k) for k in range(images)),
        space=Space(size, what, "take a .gif, or set fewer sequence.images"),
    )  # fmt: skip


class Bench:
    """A worker process that keeps the traced station and runs patterns on it.

    A pattern that loops for ever, or kills the driver, takes the worker along and nothing else: the
    next one starts a new worker.

    Parameters
    ----------
    station : Station
    backend, device : str
        As in :func:`gpuspec.light.devices.open_backend`.
    limit_s : float
        Longest a pattern may run.
    """

    def __init__(
        self, station: Station, backend: str, device: str | None = None, limit_s: float = 20.0
    ) -> None:
        self._job = (station.as_dict(), station.file, str(station.locate(".")), backend, device)
        self.limit_s = limit_s
        self._process: multiprocessing.process.BaseProcess | None = None
        self._pipe: Connection | None = None

    def written(self, pattern: Pattern, plan: Planned) -> Rendered:
        """Run a pattern and write its files where they are planned; errors as :meth:`render`.

        Parameters
        ----------
        pattern : Pattern
        plan : Planned

        Raises
        ------
        OutputError
            If they cannot be written, or something is in the way.
        """
        with ExitStack() as stack:
            folder = stack.enter_context(plan.results.writing())
            frames = None
            if plan.sequence:
                frames = stack.enter_context(plan.sequence.writing())
                if plan.animation:
                    frames /= plan.sequence.names[0]
            return self.render(pattern, folder, glance=plan.preview is not None, frames=frames)

    def previewed(self, pattern: Pattern, plan: Planned) -> None:
        """Run a pattern on some pixels and write what is seen, if that is planned.

        Parameters and errors as :meth:`written`.
        """
        if plan.preview:
            with plan.preview.writing() as folder:
                self._asked(self._worker(), ("preview", pattern, folder, None), pattern)

    def render(
        self, pattern: Pattern, folder: Path, *, glance: bool, frames: Path | None = None
    ) -> Rendered:
        """Run a pattern and write its files into an existing folder.

        Parameters
        ----------
        pattern : Pattern
        folder : Path
        glance : bool
            Score and detection alone, in well under a second; else every file.
        frames : Path, optional
            A ``.gif`` to write the sequence to, or an existing folder for its images as PNG.

        Raises
        ------
        PatternError
            If it does not compile, or runs longer than the limit.
        GpuspecError
            If the station or the backend cannot be used.
        """
        job = "glance" if glance else "whole", pattern, folder, frames
        answer = self._asked(self._worker(), job, pattern)
        assert isinstance(answer, Rendered)
        return answer

    def faulty(self, pattern: Pattern) -> float:
        """Return the share of samples that are none, of the pattern rendered last.

        They are NaN or outside [0, 1], and count as 0 or as the nearer bound. To know it takes as
        long as some images: it is asked when the picture is there.

        Parameters
        ----------
        pattern : Pattern
            Named in messages.

        Raises
        ------
        PatternError
            As of `render`; also if none was rendered.
        """
        if self._process is None or self._pipe is None:
            raise PatternError(f"{pattern.file} was not rendered.")
        return float(self._asked(self._pipe, None, pattern))

    def _asked(self, pipe: Connection, job: Any, pattern: Pattern) -> Any:
        """Return what the worker answers, or raise it."""
        pipe.send(job)
        answer = self._answer(pipe, f"{pattern.file} ran for more than {self.limit_s:g} s and was "
                                    f"stopped; does it loop for ever?")  # fmt: skip
        if isinstance(answer, Exception):
            raise answer
        return answer

    def close(self) -> None:
        """End the worker."""
        if self._process is not None:
            self._process.kill()
            self._process.join()
        self._process = self._pipe = None

    def _worker(self) -> Connection:
        if self._process is not None and self._process.is_alive() and self._pipe is not None:
            return self._pipe
        context = multiprocessing.get_context("spawn")
        self._pipe, far = context.Pipe()
        self._process = context.Process(target=_work, args=(far, *self._job), daemon=True)
        self._process.start()
        far.close()
        ready = self._answer(self._pipe, "the backend did not open in time.", start=True)
        if isinstance(ready, GpuspecError):
            self.close()
            raise ready
        return self._pipe

    def _answer(self, pipe: Connection, late: str, *, start: bool = False) -> Any:
        limit = max(self.limit_s, 120.0) if start else self.limit_s
        end = time.monotonic() + limit
        while time.monotonic() < end:
            try:
                if pipe.poll(POLL_S):
                    answer = pipe.recv()
                    if not isinstance(answer, Warning):
                        return answer
                    warnings.warn(answer, stacklevel=2)
            except (EOFError, OSError):
                self.close()
                raise PatternError(
                    "the graphics driver ended the run; the pattern is too much for it."
                ) from None
        self.close()
        raise PatternError(late)


@contextmanager
def bench(station: Station, backend: str, device: str | None, limit_s: float) -> Iterator[Bench]:
    """Give a bench and end its worker afterwards.

    Parameters
    ----------
    station : Station
    backend : str
        One that runs patterns, or "auto".
    device : str or None
        Part of the device's name, or its number.
    limit_s : float
        After how many seconds a pattern is stopped.

    Yields
    ------
    Bench
    """
    made = Bench(station, backend, device, limit_s)
    try:
        yield made
    finally:
        made.close()


def watch(
    path: Path, changed: Callable[[], None], stop: Callable[[], bool] = lambda: False
) -> None:
    """Call a function now and after each save of a file, until told to stop or Ctrl-C.

    Editors replace files: one that is away or empty for a moment is waited for.

    Parameters
    ----------
    path : Path
    changed : callable
        Without arguments.
    stop : callable
        Without arguments; true ends it.
    """
    seen: tuple[int, int] | None = None
    while not stop():
        try:
            state = path.stat()
        except OSError:
            state = None
        if not state or not state.st_size:
            time.sleep(POLL_S)
            continue
        if (state.st_mtime_ns, state.st_size) != seen:
            seen = (state.st_mtime_ns, state.st_size)
            changed()
        time.sleep(POLL_S)


def _work(
    pipe: Connection, data: dict[str, Any], file: str, folder: str, backend: str, device: str | None
) -> None:
    """Run in the worker: trace once, then answer one pattern after another."""
    import signal

    from gpuspec.host import collect_seldom
    from gpuspec.light.devices import open_backend
    from gpuspec.report.folder import summary, write_files, write_glance, write_preview
    from gpuspec.simulation.preview import Previewer
    from gpuspec.simulation.simulate import trace

    collect_seldom()
    warnings.simplefilter("always", DeviceWarning)
    warnings.showwarning = lambda said, *_, **__: pipe.send(said)
    signal.signal(signal.SIGINT, signal.SIG_IGN)  # the parent decides
    try:
        station = Station.from_dict(data, file, folder)
        engine = open_backend(backend, device, ("opengl", "vulkan"))
        traced = trace(station, engine)
        pipe.send("ready")
    except GpuspecError as error:
        pipe.send(error)
        return
    light_map = traced.light_map
    previewer: Previewer | None = None
    while True:
        try:
            job = pipe.recv()
        except EOFError:
            return
        start = time.perf_counter()
        try:
            if job is None:
                pipe.send(light_map.faulty())
                continue
            what, pattern, target, frames = job
            if what == "preview":
                previewer = previewer or Previewer(traced, engine)
                write_preview(previewer.under(pattern), target)
                pipe.send(what)
                continue
            # From the one before: what a pattern needs of the trace is traced but once.
            light_map = light_map.with_pattern(pattern)
            result = traced.result(light_map)
            if what == "glance":
                write_glance(result, target)
            else:
                write_files(result, target, frames=False, pictures=True)
            if frames is not None:
                _write_sequence(result, frames)
            pipe.send(Rendered(summary(result), time.perf_counter() - start))
        except GpuspecError as error:
            pipe.send(error)


def _write_sequence(result: Result, path: Path) -> None:
    """Write the sequence to look at: an animation, or a PNG for each image."""
    from gpuspec.pictures import sequence

    if path.suffix.lower() == ".gif":
        sequence.sequence_animation(result, path)
        return
    for k in range(result.station.sequence.images):
        sequence.write_image(result, k, path / _image_name(k))


def _image_name(k: int) -> str:
    return f"image_{k:04d}.png"
