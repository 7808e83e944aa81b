"""The command that tells what a station's camera sees, from its data sheet."""

from __future__ import annotations

from gpuspec.cli.options import SetOption, StationArgument, changed


def camera(station: StationArgument, change: SetOption = None) -> None:
    """Tell what the camera sees."""
    from gpuspec.cli.tables import print_table
    from gpuspec.cli.terminal import print_assumptions, print_notes
    from gpuspec.simulation.cautions.camera import of_camera
    from gpuspec.simulation.cautions.station import assumptions, without_effect
    from gpuspec.simulation.view import facts
    from gpuspec.station.station import Station

    read = changed(Station.read(station), change)
    print_table([(fact.name, fact.value, fact.source) for fact in facts(read)], framed=False)
    print_assumptions(assumptions(read))
    print_notes([*without_effect(read), *of_camera(read)])
