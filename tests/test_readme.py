"""README and chapters hold what they say: commands run, figures are printed, links lead somewhere.

Of every document the blocks are taken in their order. ```sh is run by bash and ```python in this
process, in one folder and one namespace a document; ```text after one of them is what it prints,
line by line in this order, others between them left out. The chapters go on where the README's tour
ended. An HTML comment above a block says what else is done with it:

- ``file: NAME``: it is written to that file;
- ``main command``, ``test command``: test_machines.py and .ci/run run it, in fresh environments;
- ``refused``: each line is a command that ends with an error;
- ``not run: REASON``.

A line of ```text that ends with ... goes on in what is printed.
"""

from __future__ import annotations

import ast
import importlib
import os
import re
import shlex
import shutil
import subprocess
import sys
import tomllib
from collections.abc import Iterator
from contextlib import chdir, redirect_stdout
from functools import cache
from io import StringIO
from pathlib import Path
from urllib.parse import unquote

import click
import pytest
import typer
from documents import CHAPTERS, CHECKOUT, README, REFERENCE, Block, blocks
from PIL import Image
from test_layout import LADDER

from gpuspec.cli.main import app
from gpuspec.report.folder import FILES
from gpuspec.station.keys import keys

DOCUMENTS = (README, *CHAPTERS)
ALL = (*DOCUMENTS, REFERENCE, CHECKOUT / "kernels/README.md", CHECKOUT / "shaders/README.md")
SECONDS = 300.0
"""Longest a block may take; the longest, a sweep of 15,360 designs, takes 7 on two cores."""
GPUSPEC = f'gpuspec() {{ {shlex.quote(sys.executable)} -m gpuspec "$@"; }}\n'
"""That of this checkout, whichever is installed."""
SUFFIXES = {".toml", ".png", ".gif", ".json", ".csv", ".tif", ".sha256", ".py"}
LONGEST_README = 150  # lines: what is read to its end
LINK = re.compile(r"\[[^\]]*\]\(([^)\s]+)\)")


def named(document: Path) -> str:
    return document.relative_to(CHECKOUT).as_posix()


def shell(block: Block, folder: Path) -> str:
    """Run a block as a reader would; return what it printed."""
    refused = block.said == "refused"
    printed = ""
    for script in block.text.splitlines() if refused else [block.text]:
        done = subprocess.run(
            ["bash", "-e", "-o", "pipefail", "-c", GPUSPEC + script], cwd=folder, text=True,
            stdout=subprocess.PIPE, stderr=subprocess.STDOUT, timeout=SECONDS,
            env={**os.environ, "PYTHONPATH": str(CHECKOUT), "COLUMNS": "200"},
        )  # fmt: skip
        assert done.returncode == refused, f"{block}{done.stdout}"
        printed += done.stdout
    return printed


def python(block: Block, folder: Path, names: dict[str, object]) -> str:
    """Execute a block; return what it printed."""
    printed = StringIO()
    program = compile("\n" * block.line + block.text, str(block.document), "exec")
    sys.path.insert(0, str(folder))  # as of a program that stands there
    try:
        with chdir(folder), redirect_stdout(printed):
            exec(program, names)
    finally:
        sys.path.remove(str(folder))
    return printed.getvalue()


def check_printed(block: Block, printed: str) -> None:
    """Check that the lines of a block were printed, in their order."""
    lines = iter([" ".join(line.split()) for line in printed.splitlines()])
    for line in block.text.splitlines():
        wanted = " ".join(line.split())
        found = any(
            line.startswith(wanted[:-3]) if wanted.endswith("...") else line == wanted
            for line in lines
        )
        assert found, f"{block}not printed: {wanted}\n\n{printed}"


def run(document: Path, folder: Path) -> None:
    """Run a document's blocks in a folder, one after the other."""
    names: dict[str, object] = {"__name__": "__main__"}
    printed: str | None = None
    for block in blocks(document):
        if block.said.startswith("file: "):
            (folder / block.said.removeprefix("file: ")).write_text(block.text, "utf-8")
        elif not block.runs:
            printed = None
        elif block.language == "sh":
            printed = shell(block, folder)
        elif block.language == "python":
            printed = python(block, folder, names)
        elif block.language == "text" and printed is not None:
            check_printed(block, printed)


@pytest.fixture(scope="module")
def toured(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """The folder in which the README's tour was made."""
    folder = tmp_path_factory.mktemp("tour")
    run(README, folder)
    return folder


@pytest.mark.slow
def test_the_readmes_commands_run_and_print_what_it_says(toured: Path):
    left = {path.name for path in toured.iterdir()}
    assert {"trim.toml", "even", "sweep", "best.toml", "best"} <= left


# Without a driver of OpenGL its tests are skipped by their name.
IDS = [f"{path.stem}{' on opengl' * (path.stem == 'prototypes')}" for path in CHAPTERS]


@pytest.mark.slow
@pytest.mark.parametrize("chapter", CHAPTERS, ids=IDS)
def test_a_chapters_commands_run_and_print_what_it_says(
    chapter: Path, toured: Path, tmp_path: Path
):
    folder = shutil.copytree(toured, tmp_path / "tour")
    run(chapter, folder)


@pytest.mark.parametrize("document", DOCUMENTS, ids=named)
def test_every_block_is_run_or_says_why_not(document: Path):
    known = re.compile(r"main command|test command|refused|file: [\w.]+|not run: \w.{9,}")
    for block in blocks(document):
        assert block.language in {"sh", "python", "text", "toml", "glsl", ""}, block
        assert not block.said or known.fullmatch(block.said), block
        if block.language in {"toml", "glsl"}:
            assert block.said.startswith("file: "), f"{block}never read by a command"
        if block.language == "python":
            compile(block.text, str(document), "exec")
        if block.language == "sh":
            subprocess.run(["bash", "-n", "-c", block.text], check=True, timeout=SECONDS)


@pytest.mark.parametrize("chapter", CHAPTERS, ids=named)
def test_every_chapter_has_a_command_that_is_run(chapter: Path):
    assert any(block.runs and block.language in {"sh", "python"} for block in blocks(chapter))


def links(document: Path) -> list[str]:
    return LINK.findall(document.read_text("utf-8"))


def anchors(document: Path) -> set[str]:
    """The anchors that a code host gives to a document's headings."""
    heads = re.findall(r"^#+ (.*)$", document.read_text("utf-8"), re.MULTILINE)
    kept = (re.sub(r"[^\w\- ]", "", head.lower()) for head in heads)
    return {head.replace(" ", "-") for head in kept}


@cache
def tracked() -> frozenset[str]:
    """The files of the checkout, as git spells them: a code host tells upper from lower case."""
    listed = subprocess.run(
        ["git", "ls-files", "-co", "--exclude-standard"], cwd=CHECKOUT, check=True, text=True,
        capture_output=True, timeout=SECONDS,
    )  # fmt: skip
    return frozenset(name for name in listed.stdout.splitlines() if (CHECKOUT / name).exists())


@pytest.mark.parametrize("document", ALL, ids=named)
def test_every_link_leads_to_a_file_of_the_checkout_or_to_a_site(document: Path):
    held = tracked()
    for link in links(document):
        if link.startswith("https://"):
            continue
        path, _, anchor = link.partition("#")
        assert ":" not in path and "\\" not in path and not path.startswith("/"), link
        target = Path(os.path.normpath(document.parent / unquote(path))) if path else document
        known = target.relative_to(CHECKOUT).as_posix()
        assert known in held or any(name.startswith(f"{known}/") for name in held), link
        assert not anchor or anchor in anchors(target), link


@pytest.mark.parametrize("chapter", CHAPTERS, ids=named)
def test_every_chapter_is_linked_from_the_readme_and_back(chapter: Path):
    assert named(chapter) in links(README)
    assert "../README.md" in links(chapter)


def test_every_picture_is_shown_by_a_document_and_can_be_opened():
    shown = {
        (document.parent / link).resolve() for document in DOCUMENTS for link in links(document)
    }
    pictures = set((CHECKOUT / ".readme").iterdir()) - set(CHAPTERS)
    assert pictures <= shown
    for picture in pictures - {REFERENCE}:
        with Image.open(picture) as image:
            image.verify()


def test_the_readme_is_short_enough_to_be_read_to_its_end():
    assert len(README.read_text("utf-8").splitlines()) <= LONGEST_README


def spans(document: Path) -> list[str]:
    """What stands as code within a document's sentences and tables."""
    text = re.sub(r"^```.*?^```$", "", document.read_text("utf-8"), flags=re.MULTILINE | re.DOTALL)
    return re.findall(r"`([^`\n]+)`", text)


@pytest.mark.parametrize("document", DOCUMENTS, ids=named)
def test_every_key_that_is_named_is_one(document: Path):
    known = {key.path for key in keys()}
    sections = {path.partition(".")[0] for path in known}
    for span in spans(document):
        found = re.match(r"(?:--set )?([a-z]+)(?:\[\d\])?(\.[a-z_]+(?:\.[a-z_]+)?)(?: ?=|$)", span)
        if found and found[1] in sections and Path(span).suffix not in SUFFIXES:
            assert found[1] + found[2] in known, span


def options(command: click.Command) -> set[str]:
    """Return the options of a command and of those below it."""
    found = {option for one in command.params for option in (*one.opts, *one.secondary_opts)}
    for below in getattr(command, "commands", {}).values():
        found |= options(below)
    return found


@pytest.mark.parametrize("document", DOCUMENTS, ids=named)
def test_every_option_that_is_named_is_one(document: Path):
    known = options(typer.main.get_command(app)) | {"--install-completion"}
    for span in spans(document):
        if span.startswith(("gpuspec ", "--")):
            assert set(re.findall(r"(?<!\S)--[a-z][\w-]*", span)) <= known, span


@pytest.mark.parametrize("document", DOCUMENTS, ids=named)
def test_every_extra_and_every_file_that_is_named_is_there(document: Path):
    text = document.read_text("utf-8")
    extras = tomllib.loads((CHECKOUT / "pyproject.toml").read_text("utf-8"))["project"]
    for found in re.findall(r"\"\.\[(\w+)\]\"", text):
        assert found in extras["optional-dependencies"]
    for file in re.findall(r"(?:tests|kernels|shaders|\.ci)/\w[\w./]*\w", text):
        assert (CHECKOUT / file).exists(), file
    for test in re.findall(r"\btest_\w+\.py", text):
        assert list((CHECKOUT / "tests").rglob(test)), test


def test_the_files_of_a_run_are_those_that_it_writes():
    (chapter,) = (path for path in CHAPTERS if path.stem == "stations-and-parts")
    _, _, below = chapter.read_text("utf-8").partition("## What a run leaves")
    rows = re.findall(r"^\| (`.*?) \|", below, re.MULTILINE)
    assert set(re.findall(r"`([\w.]+)`", " ".join(rows[: len(FILES)]))) >= set(FILES)


def imported(program: str) -> Iterator[tuple[str, str]]:
    """Yield what a program imports: module and name."""
    for node in ast.walk(ast.parse(program)):
        if isinstance(node, ast.ImportFrom):
            yield from ((node.module or "", alias.name) for alias in node.names)
        elif isinstance(node, ast.Import):
            yield from ((alias.name, "") for alias in node.names)


def unrun() -> Iterator[str]:
    """Yield the programs that no test runs: blocks, and the benchmarks that print the figures."""
    for document in DOCUMENTS:
        for block in blocks(document):
            if block.language == "python" and not block.runs:
                yield block.text
    for path in (CHECKOUT / "tests/benchmarks").glob("*.py"):
        yield path.read_text("utf-8")


def test_what_is_not_run_imports_what_is_there():
    for program in unrun():
        for module, name in imported(program):
            assert not module.startswith("test_"), module  # tests move; what they share does not
            if module.partition(".")[0] == "gpuspec" and name:
                there = importlib.import_module(module)
                assert hasattr(there, name) or importlib.import_module(f"{module}.{name}")


def test_the_map_of_the_house_names_every_room():
    (house,) = (block for block in blocks(README) if block.text.startswith("gpuspec/"))
    told = re.findall(r"^( *)(\.?\w+)/ ", house.text, re.MULTILINE)
    rooms, above = set(), ""
    for indent, name in told:
        above = above if indent else name
        rooms.add(f"{above}/{name}" if indent else name)
    folders = {path.parent for path in map(Path, tracked())}
    there = {folder.as_posix() for folder in folders if folder.parts}
    assert rooms <= there
    packages = {
        "/".join(Path(name).parts[:2]) for name in tracked() if name.endswith("__init__.py")
    }
    assert {path for path in packages if "." not in path} <= rooms
    assert {folder.split("/")[0] for folder in there} <= rooms


def test_the_map_of_the_house_tells_the_ladder_of_its_imports():
    (house,) = (block for block in blocks(README) if block.text.startswith("gpuspec/"))
    told, _, _ = house.text.removeprefix("gpuspec/").partition(":")
    steps = [set(re.findall(r"\w+", step)) for step in told.split("→")]
    climbed = [next(i for i, rung in enumerate(LADDER) if step <= rung) for step in steps]
    assert climbed == sorted(set(climbed))
    folders = {
        path.name for path in (CHECKOUT / "gpuspec").iterdir() if (path / "__init__.py").exists()
    }
    assert folders <= set.union(*steps)
