"""The plan of the house: imports climb one ladder, and nothing imports in a circle.

Every import counts: inside functions and for type checking, too.
"""

from __future__ import annotations

import ast
import sys
from collections import defaultdict
from graphlib import CycleError, TopologicalSorter
from pathlib import Path

import pytest

import gpuspec

PACKAGE = Path(gpuspec.__file__).parent
LADDER = (
    {"version", "errors", "units", "words"},
    {"arrays", "cache", "host"},
    {"shown", "files", "shapes", "topographies"},
    {"station"},
    {"part", "detection"},
    {"light", "frames"},
    {"pictures"},
    {"report"},
    {"simulation"},
    {"captured"},
    {"studies", "sweeps"},
    {"datasets", "detectability"},
    {"loading", "prototype"},
    {"cli"},
    {"__main__", "__init__"},
)
"""Rooms and files of the package, the lowest first; each imports from steps below its own."""
ENGINES = {
    "pyopencl": {"light.opencl_device"},
    "moderngl": {"light.opengl"},
    "wgpu": {"light.vulkan"},
    "distributed": {"sweeps.cluster.crew", "sweeps.cluster.workers"},
    "optuna": {"sweeps.searching.optimise", "sweeps.searching.search"},
    "statsmodels": {"detectability.fits"},
    "firthmodels": {"detectability.fits"},
    "nothing": set(),
}
"""Packages that few files know, and which."""

IMAGE_ALONE = {"numpy", "scipy", "skimage"}
"""What detection may use beside the standard library: it must serve real frames, too."""

Imports = dict[str, set[str]]


def imports() -> Imports:
    """Return what each module of the package imports of it."""
    files = {_name(path): path for path in PACKAGE.rglob("*.py")}
    found: Imports = {}
    for name, path in files.items():
        found[name] = set()
        for node in ast.walk(ast.parse(path.read_text("utf-8"))):
            if isinstance(node, ast.Import):
                targets = [alias.name for alias in node.names]
            elif isinstance(node, ast.ImportFrom):
                assert not node.level, f"{path}:{node.lineno} imports relatively"
                targets = [f"{node.module}.{alias.name}" for alias in node.names]
            else:
                continue
            for target in targets:
                if target.partition(".")[0] == "gpuspec":
                    found[name].add(_module(target.removeprefix("gpuspec").lstrip("."), files))
    return found


def foreign(room: str = "") -> Imports:
    """Return what each module of a room imports that is neither ours nor Python's own."""
    found: Imports = {}
    for path in PACKAGE.joinpath(room).rglob("*.py"):
        names: set[str] = set()
        for node in ast.walk(ast.parse(path.read_text("utf-8"))):
            if isinstance(node, ast.Import):
                names |= {alias.name for alias in node.names}
            elif isinstance(node, ast.ImportFrom):
                names.add(node.module or "")
        roots = {name.partition(".")[0] for name in names} - {"gpuspec"}
        found[_name(path)] = roots - sys.stdlib_module_names
    return found


def _name(path: Path) -> str:
    return ".".join(path.relative_to(PACKAGE).with_suffix("").parts)


def _module(target: str, files: dict[str, Path]) -> str:
    """Return the file in which a dotted name stands."""
    while target not in files:
        package = f"{target}.__init__".lstrip(".")
        if package in files:
            return package
        target = target.rpartition(".")[0]
    return target


def check_no_circle(graph: Imports) -> None:
    """Fail on a circle of files, or of the rooms of any one folder."""
    levels: dict[str, Imports] = defaultdict(lambda: defaultdict(set))
    levels["files"] = graph
    for importer, targets in graph.items():
        for target in targets:
            mine, other = importer.split("."), target.split(".")
            depth = next(i for i, (a, b) in enumerate(zip(mine, other, strict=False)) if a != b)
            levels["rooms of gpuspec/" + "/".join(mine[:depth])][mine[depth]].add(other[depth])
    for level, arrows in levels.items():
        try:
            TopologicalSorter(arrows).prepare()
        except CycleError as error:
            pytest.fail(f"a circle of {level}: {' <- '.join(error.args[1])}")


def check_ladder(graph: Imports) -> None:
    """Fail on an arrow that does not go down."""
    rung = {room: height for height, step in enumerate(LADDER) for room in step}
    for importer, targets in graph.items():
        here = importer.partition(".")[0]
        for target in targets:
            there = target.partition(".")[0]
            assert here == there or rung[there] < rung[here], f"{importer} imports {target}"


def test_nothing_imports_in_a_circle() -> None:
    check_no_circle(imports())


def test_no_file_stands_beside_a_room_of_its_name() -> None:
    # Python imports the room and never reads the file.
    rooms = {path.parent for path in PACKAGE.rglob("__init__.py")} - {PACKAGE}
    assert [room for room in rooms if room.with_suffix(".py").exists()] == []


def test_imports_climb_one_ladder() -> None:
    check_ladder(imports())


@pytest.mark.parametrize("engine", ENGINES)
def test_few_files_know_how_images_are_made_and_work_is_shared(engine: str) -> None:
    knowing = {name for name, used in foreign().items() if engine in used}
    assert knowing == ENGINES[engine]


def test_what_comes_after_the_aspect_image_needs_arrays_alone() -> None:
    for name, used in foreign("detection").items():
        assert used <= IMAGE_ALONE, name


def test_one_file_names_every_backend() -> None:
    engines = {"light.opencl", "light.opengl", "light.vulkan", "light.float64_backend"}
    naming = {name for name, targets in imports().items() if engines <= targets}
    assert naming == {"light.devices"}


def test_every_room_stands_on_the_ladder() -> None:
    assert {name.partition(".")[0] for name in imports()} == set.union(*LADDER)


def test_every_room_says_what_is_inside_and_does_nothing() -> None:
    for path in PACKAGE.rglob("*/__init__.py"):
        body = ast.parse(path.read_text("utf-8")).body
        assert len(body) == 1, f"{path} does more than say what is inside"
        assert len(ast.get_docstring(ast.Module(body, []), clean=True) or "") > 60, path


@pytest.mark.parametrize(
    ("importer", "target"),
    [
        ("station.station", "light.devices"),
        ("light.devices", "light.devices"),
        ("sweeps.keeping.folder", "sweeps.choosing.front"),
        ("units", "errors"),
    ],
)
def test_an_arrow_against_the_ladder_is_noticed(importer: str, target: str) -> None:
    graph = imports()
    graph[importer].add(target)
    with pytest.raises((pytest.fail.Exception, AssertionError, StopIteration)):
        check_no_circle(graph)
        check_ladder(graph)
