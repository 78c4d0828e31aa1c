"""Texts of events above a picture: in lines, so that none lies over another one or over a curve."""

from collections.abc import Sequence
from dataclasses import dataclass

from phfmu.report.recording import Mark

#: events that have room for a text, letters of it, pixels of a letter and of a line
LABELLED, LETTERS, LETTER, LINE = 12, 40, 6.0, 14


@dataclass(frozen=True)
class Label:
    """A text in line `row` from below; `right`: it ends at its time instead of beginning there."""

    time: float
    text: str
    row: int
    right: bool


def labels(marks: Sequence[Mark], start: float, stop: float, width: float) -> list[Label]:
    """Where the texts stand above an axis of `width` pixels; none for more than `LABELLED` events."""
    if len(marks) > LABELLED or not stop > start:
        return []
    taken: list[list[tuple[float, float]]] = []
    found = []
    for mark in sorted(marks, key=lambda m: -m.time):  # later ones lie lower: no line crosses a text
        text = mark.text if len(mark.text) <= LETTERS else f"{mark.text[: LETTERS - 1]}…"
        at, size = (mark.time - start) / (stop - start) * width, len(text) * LETTER + 10.0
        right = at + size > width and at > size
        ends = (at - size, at) if right else (at, at + size)
        free = (k for k, row in enumerate(taken) if all(ends[1] <= a or b <= ends[0] for a, b in row))
        row = next(free, len(taken))
        taken += [[]] * (row == len(taken))
        taken[row] = [*taken[row], ends]
        found.append(Label(mark.time, text, row, right))
    return found


def height(found: Sequence[Label]) -> int:
    """Pixels that the texts need."""
    return LINE * (1 + max(label.row for label in found)) if found else 0
