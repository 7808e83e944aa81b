"""What the scores are called wherever a person reads: the field's word, the letter, the paper's."""

from __future__ import annotations

P1 = "precision P1 (overdetection)"
P2 = "recall P2 (misdetection)"
F1 = "F1"
SCORES = {"p1": P1, "p2": P2, "f1": F1}

MEANINGS = {
    "p1": "share of detected pixels in zones",
    "p2": "share of zone pixels detected",
    "f1": "of P1 and P2; 1 is best for all three",
}
"""Said beside the numbers."""

BEST = "1 is best"
LEGEND = f"p1: {P1}; p2: {P2}; f1: of both; {BEST}"
"""Said beside numbers under short names."""


def precision(p1: float, detected_px: int) -> str:
    """Return P1 as it is printed; of no detected pixels it is 1 by definition and says nothing.

    Parameters
    ----------
    p1 : float
    detected_px : int
        Detected pixels.
    """
    return f"{p1:.3f}" if detected_px else "- (nothing detected)"


def number(value: float) -> str:
    """Return a key's value as a station file has it, to six digits."""
    text = f"{value:.6g}"
    return f"{value:.0f}" if "e+" in text and abs(value) < 1e15 else text


def plural(count: int, thing: str) -> str:
    """Return "1 design" or "2,000 designs".

    Parameters
    ----------
    count : int
        From 0.
    thing : str
        In the singular.
    """
    return f"{count:,} {thing}{'' if count == 1 else 's'}"


def none_valid(count: int) -> str:
    """Return "1 design is no valid station" or "16 designs are no valid station".

    Parameters
    ----------
    count : int
    """
    return f"{plural(count, 'design')} {'is' if count == 1 else 'are'} no valid station"
