"""The command that lists and tests devices."""

from __future__ import annotations

import json
from typing import TYPE_CHECKING, Annotated

import typer

from gpuspec.cli.terminal import console, progress

if TYPE_CHECKING:
    from gpuspec.light.devices import DeviceReport, Found


def devices(
    test: Annotated[
        bool,
        typer.Option(
            "--test", help="Compare each with float64 and time it; the fastest settings are kept."
        ),
    ] = False,
    as_json: Annotated[bool, typer.Option("--json", help="Print JSON, for a report.")] = False,
) -> None:
    """List backends and devices. Says what is chosen, and why not the others."""
    from gpuspec.errors import BackendError
    from gpuspec.light.devices import survey, tested

    with progress() as tell:
        tell("looking for devices")
        found = survey()
        results = []
        for entry in found if test else ():
            tell(f"testing {entry.backend} on {entry.info.device if entry.info else '-'}")
            results.append(tested(entry))
    if as_json:
        print(json.dumps(_json(found, results), indent=2))
    elif test:
        _print_test(results)
    else:
        _print_list(found)
    for result in results:
        if result.found.chosen and result.failure:
            raise BackendError(f"what auto chooses fails: {result.failure}")


def _json(found: list[Found], results: list[DeviceReport]) -> dict[str, object]:
    import platform

    from gpuspec.light.devices import DeviceReport
    from gpuspec.version import __version__

    return {
        "gpuspec": __version__,
        "python": platform.python_version(),
        "platform": platform.platform(),
        "devices": [one.as_dict() for one in results or map(DeviceReport, found)],
    }


def _print_list(found: list[Found]) -> None:
    from gpuspec.cli.tables import print_table

    rows = []
    for entry in found:
        info = entry.info
        told = (f"{entry.number}: {info.device}", info.driver, info.version) if info else ("-",) * 3
        rows.append((entry.backend, *told, entry.remark))
    print_table(rows, ("backend", "device", "driver", "version", ""))


def _print_test(results: list[DeviceReport]) -> None:
    """Print a table to paste into a report: plain text, as wide as it is."""
    from gpuspec.light.speed import COPY, ROWS

    out = console()
    heads = "".join(f"{row:>18}" for row in ROWS)
    out.print(f"{'4 megapixels: ms (copies)':44}{'off float64':>14}{heads}", soft_wrap=True)
    for result in results:
        info = result.found.info
        name = f"{result.found.backend} {result.found.number}: {info.device if info else '-'}"
        name = f"{name[:42]:44}"
        if result.failure:
            out.print(f"{name}{result.failure.splitlines()[0]}", soft_wrap=True)
            continue
        copy = result.ms[COPY]
        cells = "".join(
            f"{f'{ms:.4g} ({ms / copy:.3g})':>18}" for ms in (result.ms[row] for row in ROWS)
        )
        out.print(f"{name}{f'{result.difference_dn:.5f} DN':>14}{cells}", soft_wrap=True)
    for result in results:
        widths = result.settings.get("widths")
        if widths:
            told = ", ".join(f"{file} {width}" for file, width in widths.items())
            out.print(
                f"opencl {result.found.number}: pixels of a vector, from now on: {told}",
                soft_wrap=True,
            )
