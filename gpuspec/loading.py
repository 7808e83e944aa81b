"""Whatever gpuspec wrote into a folder, read back."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING

from gpuspec.errors import ExtraError, OutputError
from gpuspec.simulation.kept import read
from gpuspec.simulation.result import Result
from gpuspec.studies.study import STUDIES

if TYPE_CHECKING:
    from gpuspec.sweeps.keeping.folder import RunFolder


def load(folder: str | Path) -> Result | RunFolder:
    """Read a run or a sweep from its folder.

    Of a run, the images, tables and numbers are there at once; the light map is traced again only
    when it is asked for images, by the backend and on the device that the folder names.

    Parameters
    ----------
    folder : str or Path
        Of a simulation or a prototype (``aspect.tif`` ...), or of a sweep (``sweep.json`` ...).

    Returns
    -------
    Result or RunFolder

    Raises
    ------
    OutputError
        If the folder holds neither, or a file of it is damaged.
    ExtraError
        If what reads a sweep is not installed.

    Examples
    --------
    >>> import gpuspec as gs, tempfile
    >>> result = gs.simulate(gs.example("trim").replace(camera__sampling_mm=0.5), "numpy")
    >>> with tempfile.TemporaryDirectory() as folder:
    ...     result.save(folder, pictures=False)
    ...     again = gs.load(folder)
    >>> again.score == result.score
    True
    """
    if not isinstance(folder, (str, Path)) or not str(folder).strip():
        raise OutputError(
            f"a run or a sweep is loaded from the path of its folder, not {folder!r}."
        )
    path = Path(folder)
    try:
        if (path / "sweep.json").is_file():
            return _sweep(path)
        if (path / "optimise.json").is_file():
            raise OutputError(
                f"{path} is the folder of a search; gpuspec.optimise with the same plan and folder "
                f"goes on with it and returns what it found."
            )
        if (path / "dataset.json").is_file():
            raise OutputError(
                f"{path} is the folder of a data set; its README.md says how it is loaded, and "
                f"gpuspec.dataset with the same station goes on with it."
            )
        if not path.is_dir():
            what = "is no folder" if path.exists() else "is not there"
            raise OutputError(f"{path} {what}; name the folder of a run or a sweep.")
        for name in STUDIES:
            if (path / f"{name}.json").is_file() and not (path / "score.json").is_file():
                raise OutputError(
                    f"{path} holds what a study of {name} wrote, from which it is not read back; "
                    f'gpuspec.study("{name}", "{path / name}.toml") works it out again.'
                )
        return read(path)
    except (OSError, ValueError) as error:  # impossible names, too
        raise OutputError(f"{path} cannot be read: {error}.") from None


def _sweep(path: Path) -> RunFolder:
    try:
        from gpuspec.sweeps.keeping.folder import RunFolder
    except ModuleNotFoundError as error:
        raise ExtraError.of(error, "sweep") from None
    return RunFolder.read(path)
