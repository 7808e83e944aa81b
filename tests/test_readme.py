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

import os
import re
import shlex
import shutil
import subprocess
import sys
from contextlib import chdir, redirect_stdout
from io import StringIO
from pathlib import Path
from urllib.parse import unquote

import pytest
from documents import CHAPTERS, CHECKOUT, README, REFERENCE, Block, blocks
from PIL import Image

from gpuspec.report import FILES

DOCUMENTS = (README, *CHAPTERS)
ALL = (*DOCUMENTS, REFERENCE, CHECKOUT / "kernels/README.md", CHECKOUT / "shaders/README.md")
SECONDS = 300.0
"""Longest a block may take; the longest, a sweep of 15,360 designs, takes 7 on two cores."""
GPUSPEC = f'gpuspec() {{ {shlex.quote(sys.executable)} -m gpuspec "$@"; }}\n'
"""That of this checkout, whichever is installed."""
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
            ["bash", "-e", "-o", "pipefail", "-c", GPUSPEC + script], cwd=folder, timeout=SECONDS, text=True,
            stdout=subprocess.PIPE, stderr=subprocess.STDOUT,
            env={**os.environ, "PYTHONPATH": str(CHECKOUT), "COLUMNS": "200"},
        )  # fmt: skip
        assert done.returncode == refused, f"{block}{done.stdout}"
        printed += done.stdout
    return printed


def python(block: Block, folder: Path, names: dict[str, object]) -> str:
    """Execute a block; return what it printed."""
    printed = StringIO()
    program = compile("\n" * block.line + block.text, str(block.document), "exec")
    with chdir(folder), redirect_stdout(printed):
        exec(program, names)
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
    assert {"trim.toml", "even", "sweep", "best.toml", "best"} <= set(os.listdir(toured))


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


@pytest.mark.parametrize("document", ALL, ids=named)
def test_every_link_leads_to_a_file_of_the_checkout_or_to_a_site(document: Path):
    tracked = set(subprocess.run(
        ["git", "ls-files", "-co", "--exclude-standard"], cwd=CHECKOUT, check=True, text=True,
        capture_output=True, timeout=SECONDS,
    ).stdout.splitlines())  # fmt: skip
    for link in links(document):
        if link.startswith("https://"):
            continue
        path, _, anchor = link.partition("#")
        assert ":" not in path and "\\" not in path and not path.startswith("/"), link
        target = Path(os.path.normpath(document.parent / unquote(path))) if path else document
        # As git spells it: a code host tells upper from lower case.
        known = target.relative_to(CHECKOUT).as_posix()
        assert known in tracked or any(name.startswith(f"{known}/") for name in tracked), link
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
