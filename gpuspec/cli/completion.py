"""What a shell completes when Tab is pressed: names that the program knows."""

from __future__ import annotations


def backends(begun: str) -> list[str]:
    """Return the backends that a name may become."""
    from gpuspec.light.devices import BACKENDS

    return [name for name in ("auto", *BACKENDS) if name.startswith(begun)]


def examples(begun: str) -> list[str]:
    """Return the examples that a name may become."""
    from gpuspec.station import examples as shipped

    return [name for name in shipped.examples() if name.startswith(begun)]


def patterns(begun: str) -> list[str]:
    """Return the shipped patterns that a name may become."""
    from gpuspec.light.patterns import shipped

    return [name for name in shipped() if name.startswith(begun)]


def changes(begun: str) -> list[str]:
    """Return the keys of a station file that a change may begin with; no entries of lists."""
    from gpuspec.station.keys import keys

    return [f"{key.path}=" for key in keys() if not key.listed and key.path.startswith(begun)]


def keys(begun: str) -> list[str]:
    """Return the sections and keys that a name may become."""
    from gpuspec.station import keys

    known = keys.keys()
    names = dict.fromkeys([key.path.rpartition(".")[0] for key in known])
    names |= dict.fromkeys(key.path for key in known)
    return [name for name in names if name.startswith(begun)]
