"""Texts of events above a picture: in lines, so that none lies over another one or over a curve.

Events that stand too close for a line each: told as a crowd of so many.
"""

from collections import Counter
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from itertools import pairwise

from phfmu.report.recording import Mark

#: events that have room for a text, letters of it, pixels of a letter and of a line
LABELLED, LETTERS, LETTER, LINE = 12, 40, 6.0, 14
#: between the names of equal signals; letters of a line of a legend
EQUAL, ENTRY_LETTERS = " = ", 34


@dataclass(frozen=True)
class Label:
    """A text in line `row` from below; `right`: it ends at its time instead of beginning there."""

    time: float
    text: str
    row: int
    right: bool


def labels(marks: Sequence[Mark], start: float, stop: float, width: float) -> list[Label]:
    """Places of the texts above an axis of `width` pixels.

    Of more than `LABELLED` marks the first of each text says how many there are; more texts than that are not written.
    """
    if not stop > start:
        return []
    marks = marks if len(marks) <= LABELLED else _counted(marks)
    if len(marks) > LABELLED:
        return []
    taken: list[list[tuple[float, float]]] = []
    found = []
    for mark in sorted(marks, key=lambda m: -m.time):  # later ones lie lower: no line crosses a text
        text = shortened(mark.text)
        at, size = (mark.time - start) / (stop - start) * width, len(text) * LETTER + 10.0
        right = at + size > width and at > size
        ends = (at - size, at) if right else (at, at + size)
        free = (k for k, row in enumerate(taken) if all(ends[1] <= a or b <= ends[0] for a, b in row))
        row = next(free, len(taken))
        taken += [[]] * (row == len(taken))
        taken[row] = [*taken[row], ends]
        found.append(Label(mark.time, text, row, right))
    return found


def shortened(text: str) -> str:
    """A text of at most `LETTERS`: what comes after a comma or semicolon is left out before a word is cut."""
    if len(text) <= LETTERS:
        return text
    head = text[: LETTERS - 2]
    cut = max(head.rfind(","), head.rfind(";"))
    return f"{head[:cut]} …" if cut > 0 else f"{text[: LETTERS - 1]}…"


def entry(label: str) -> list[str]:
    """The lines of a curve's name in a legend: broken between the names of equal signals."""
    lines = [""]
    for i, name in enumerate(label.split(EQUAL)):
        part = f"{EQUAL.lstrip() if i else ''}{name}"
        if lines[-1] and len(lines[-1]) + len(part) + 1 > ENTRY_LETTERS:
            lines.append(part)
        else:
            lines[-1] = f"{lines[-1]} {part}".strip()
    return lines


def height(found: Sequence[Label]) -> int:
    """Pixels that the texts need."""
    return LINE * (1 + max(label.row for label in found)) if found else 0


def _counted(marks: Sequence[Mark]) -> list[Mark]:
    """The first mark of each text, with their number."""
    times = Counter(m.text for m in marks)
    firsts = {m.text: m for m in sorted(marks, key=lambda m: -m.time)}
    return [Mark(m.time, text if times[text] == 1 else f"{times[text]} × {text}") for text, m in firsts.items()]


#: neighbours closer than this share of the time axis stand together; more of them than this are a crowd
CLOSE, MOST = 1 / 60, 5
#: ticks that a crowd is drawn with have different places among so many on the axis
PLACES = 1500


@dataclass(frozen=True)
class EventCluster:
    """Events in order, two at least; `ticks`: their times, of those at one place of the axis the first."""

    marks: tuple[Mark, ...]
    ticks: tuple[float, ...]

    @property
    def mark(self) -> Mark:
        """The start of the crowd, and how many of what it is."""
        first = self.marks[0]
        same = all(m.text == first.text for m in self.marks)
        what = f"{len(self.marks)} × {first.text}" if same else f"{len(self.marks)} events"
        return Mark(first.time, f"{what} until {self.marks[-1].time:.4g} s")


def parted(marks: Sequence[Mark], start: float, stop: float) -> tuple[list[Mark], list[EventCluster]]:
    """Marks that have room for a line on an axis from `start` to `stop`, and crowds of the others."""
    if not stop > start:
        return list(marks), []
    alone, crowds = list[Mark](), list[EventCluster]()
    for group in _close(sorted(marks, key=lambda m: m.time), CLOSE * (stop - start)):
        if len(group) <= MOST:
            alone += group
            continue
        places = {int((m.time - start) / (stop - start) * PLACES): m.time for m in reversed(group)}
        crowds.append(EventCluster(tuple(group), tuple(sorted(places.values()))))
    return alone, crowds


def _close(ordered: Sequence[Mark], gap: float) -> Iterator[list[Mark]]:
    group = list(ordered[:1])
    for before, mark in pairwise(ordered):
        if mark.time - before.time > gap:
            yield group
            group = []
        group.append(mark)
    yield group
