"""README and chapters as the tests read them: their blocks of code, and what is said above each."""

from __future__ import annotations

import re
from dataclasses import dataclass
from pathlib import Path

CHECKOUT = Path(__file__).resolve().parents[1]
README = CHECKOUT / "README.md"
REFERENCE = CHECKOUT / ".readme" / "station.md"
"""The station file key by key: what `gpuspec reference` prints, wherever that is."""
CHAPTERS = tuple(sorted(set((CHECKOUT / ".readme").glob("*.md")) - {REFERENCE}))

_FENCE = re.compile(r"^```(\w*)$")
_SAID = re.compile(r"^<!-- (.+) -->$")


@dataclass(frozen=True)
class Block:
    """A fenced block of a document.

    Attributes
    ----------
    document : Path
        Where it stands, an absolute path.
    line : int
        Number of the line of its fence.
    language : str
        Of the fence; "": none.
    text : str
    said : str
        The HTML comment on the line above; "": none.
    """

    document: Path
    line: int
    language: str
    text: str
    said: str

    def __str__(self) -> str:
        return f"{self.document.relative_to(CHECKOUT)}:{self.line}\n{self.text}"

    @property
    def runs(self) -> bool:
        """Whether nothing is said that keeps it from being run where its document is."""
        return self.said in {"", "refused"}


def blocks(document: Path) -> list[Block]:
    """Return the fenced blocks of a document, in its order."""
    found, lines = [], document.read_text("utf-8").split("\n")
    at = 0
    while at < len(lines):
        fence = _FENCE.match(lines[at])
        if fence:
            end = lines.index("```", at + 1)
            above = _SAID.match(lines[at - 1]) if at else None
            text = "\n".join(lines[at + 1 : end]) + "\n"
            found.append(Block(document, at + 1, fence[1], text, above[1] if above else ""))
            at = end
        at += 1
    return found


def block_said(said: str) -> str:
    """Return the README's block below a comment, e.g. "main command"."""
    (found,) = (block for block in blocks(README) if block.said == said)
    return found.text
