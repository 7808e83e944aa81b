"""The command line. Each command is one call in Python, too."""

from __future__ import annotations

import signal
import sys
from typing import Annotated

import typer

from gpuspec.cli import study as studies
from gpuspec.cli.camera import camera
from gpuspec.cli.dataset import dataset
from gpuspec.cli.devices import devices
from gpuspec.cli.fit import fit
from gpuspec.cli.front import front
from gpuspec.cli.init import init, schema
from gpuspec.cli.inspect import inspect
from gpuspec.cli.optimise import optimise
from gpuspec.cli.pod import pod
from gpuspec.cli.prototype import prototype
from gpuspec.cli.reference import reference
from gpuspec.cli.simulate import demo, simulate
from gpuspec.cli.sweep import sweep
from gpuspec.cli.terminal import show_warnings_as_notes, standard_output
from gpuspec.errors import GpuspecError
from gpuspec.host import collect_seldom
from gpuspec.version import __version__

app = typer.Typer(
    name="gpuspec",
    help="Design, test and optimise inspection stations for specular parts before building them.",
    no_args_is_help=True,
    pretty_exceptions_enable=False,
    rich_markup_mode=None,  # of a help text no word is markup: [sweep] is the file's table
    context_settings={"help_option_names": ["-h", "--help"]},
)
app.add_typer(studies.app, name="study")
for command in (
    simulate, demo, inspect, fit, camera, prototype, sweep, front, optimise, pod, dataset, devices,
    reference, init, schema,
):  # fmt: skip
    app.command()(command)


def _version(asked: bool) -> None:
    if asked:
        print(f"gpuspec {__version__}")
        raise typer.Exit


@app.callback()
def _options(
    version: Annotated[
        bool, typer.Option("--version", callback=_version, is_eager=True, help="Print the version.")
    ] = False,
) -> None:
    from gpuspec import cache

    cache.lend()


class _Stopped(BaseException):
    """Ctrl-C or SIGTERM; typer would answer a KeyboardInterrupt itself, each version otherwise."""


def _stop(*_: object) -> None:
    raise _Stopped


def main() -> None:
    """Run the command line; a user's mistake ends in one sentence and exit code 1."""
    for number in (signal.SIGINT, signal.SIGTERM):
        if signal.getsignal(number) != signal.SIG_IGN:
            signal.signal(number, _stop)
    collect_seldom()
    show_warnings_as_notes()
    try:
        with standard_output():
            app()
    except GpuspecError as error:
        print(f"error: {error}", file=sys.stderr)
        sys.exit(1)
    except (_Stopped, KeyboardInterrupt):
        print("stopped; nothing half-written was left.", file=sys.stderr)
        sys.exit(130)
    except MemoryError:
        print("error: out of memory; use a larger camera.sampling_mm, or fewer camera.columns and "
              "camera.rows.", file=sys.stderr)  # fmt: skip
        sys.exit(1)
