"""Tables on the terminal."""

from __future__ import annotations

import re

import pytest

from gpuspec.cli.tables import fits, print_score, print_table
from gpuspec.cli.terminal import console
from gpuspec.words import BEST

HEADS = ("design", "luminous_mm", "what it found", "hits")
ROWS = [("12345", "0.000123", "a dent or a bump", "36 of 36"), ("7", "2.5", "nothing", "0 of 36")]
WIDTHS = (20, 33, 40, 60, 80, 200)


@pytest.fixture(params=WIDTHS, ids=str)
def width(request: pytest.FixtureRequest, monkeypatch: pytest.MonkeyPatch) -> int:
    monkeypatch.setenv("COLUMNS", str(request.param))
    return int(request.param)


@pytest.mark.parametrize("framed", [True, False])
def test_a_table_breaks_no_number_and_no_word_at_any_width(
    width: int, framed: bool, capsys: pytest.CaptureFixture[str]
) -> None:
    print_table(ROWS, HEADS, framed=framed, title="some")
    shown = capsys.readouterr().out
    assert "…" not in shown
    found = re.split(r"[\s│┃]+", shown)
    for text in [*HEADS, *(cell for row in ROWS for cell in row)]:
        # In lines of "head: cell", a colon follows the head.
        assert all(word in found or f"{word}:" in found for word in text.split()), text


def test_a_table_is_no_wider_than_the_terminal(
    width: int, capsys: pytest.CaptureFixture[str]
) -> None:
    print_table(ROWS, HEADS)
    lines = capsys.readouterr().out.splitlines()
    drawn = any("│" in line for line in lines)
    assert drawn == (width >= 60)
    # Lines of "head: cell" in place of a table that does not fit may be longer.
    assert not drawn or max(map(len, lines)) <= width


def test_a_whole_column_stays_in_one_line(width: int, capsys: pytest.CaptureFixture[str]) -> None:
    print_table(ROWS, HEADS, whole=[3])
    shown = capsys.readouterr().out
    assert "36 of 36" in shown
    assert "0 of 36" in shown


@pytest.mark.parametrize("terminal", [True, False], ids=["terminal", "pipe"])
def test_sentences_end_their_lines_between_words_on_a_terminal_alone(
    terminal: bool, capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setenv("COLUMNS", "20")
    monkeypatch.setenv("TERM", "xterm")
    path = "/a/path/longer/than/a/line.toml"
    text = f"note: 0.123456 of 1234567 designs in {path} are the best"
    monkeypatch.setattr("rich.console.Console.is_terminal", terminal)
    console().print(text, soft_wrap=True)
    lines = capsys.readouterr().out.splitlines()
    if terminal:
        assert max(len(line) for line in lines if path not in line) <= 20
        assert path in [line.strip() for line in lines]
        assert " ".join(line.strip() for line in lines) == text
    else:
        assert lines == [text]


def test_what_fits_is_told_to_the_column(monkeypatch: pytest.MonkeyPatch) -> None:
    rows = [("1", "22"), ("333", "4")]
    for framed, needed in ((False, 1 + 3 + 1 + 1 + 2 + 1), (True, 3 + 2 + 2 * 2 + 3)):
        monkeypatch.setenv("COLUMNS", str(needed))
        assert fits(rows, ("a", "b"), framed=framed)
        monkeypatch.setenv("COLUMNS", str(needed - 1))
        assert not fits(rows, ("a", "b"), framed=framed)


def test_a_score_says_which_way_is_good(width: int, capsys: pytest.CaptureFixture[str]) -> None:
    print_score("0.850", "undefined (flawless part)", "-")
    shown = " ".join(capsys.readouterr().out.split())
    for words in ("0.850", "undefined", "precision P1", "recall P2", "overdetection"):
        assert words in shown
    if width >= 80:
        assert BEST in shown
