"""What can go wrong through no fault of the program, said in one sentence each."""

from __future__ import annotations


class GpuspecError(Exception):
    """A user's problem: what happened, why, and what to do next."""


class StationError(GpuspecError):
    """The station file, or a value in it, cannot be used."""


class TopographyError(GpuspecError):
    """A measured topography or a mesh cannot be read or used."""


class BackendError(GpuspecError):
    """A backend or device is absent, or its kernels do not build."""


class DeviceError(BackendError):
    """A device is there and does not open, or does not compute."""


class DeviceWarning(UserWarning):
    """A device was left for another, which was not asked for by name."""


class FrameError(GpuspecError):
    """A frame of a camera cannot be read, does not belong to its sequence, or tells nothing."""


class OutputError(GpuspecError):
    """Results cannot be written where they were asked for."""


class PatternError(GpuspecError):
    """A user's pattern cannot be read, does not compile, or runs for ever."""


class TrialsError(GpuspecError):
    """Trials, hits or signals over size, cannot be read, or tell of no curve."""


class ExtraError(GpuspecError):
    """A package that only this command needs is not installed."""

    @classmethod
    def of(cls, error: ModuleNotFoundError, extra: str) -> ExtraError:
        """Say which extra of gpuspec to install for a package that is missing.

        Parameters
        ----------
        error : ModuleNotFoundError
            Of the import that was tried.
        extra : str
            Name of the extra in pyproject.toml.

        Raises
        ------
        ModuleNotFoundError
            The error itself, if what is missing is a file of gpuspec.
        """
        if (error.name or "").partition(".")[0] == "gpuspec":
            raise error
        return cls(
            f'this needs {error.name}, which is not installed; pip install "gpuspec[{extra}]" '
            f'(in a checkout: pip install ".[{extra}]").'
        )


class ClusterError(GpuspecError):
    """Other processes or machines that should do the work are not there, or fail."""
