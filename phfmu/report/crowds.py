"""Events that stand too close for a line each: told as a crowd of so many."""

from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from itertools import pairwise

from phfmu.report.recording import Mark

#: neighbours closer than this share of the time axis stand together; more of them than this are a crowd
CLOSE, MOST = 1 / 60, 5
#: ticks that a crowd is drawn with have different places among so many on the axis
PLACES = 1500


@dataclass(frozen=True)
class Crowd:
    """Events in order, two at least; `ticks`: their times, of those at one place of the axis the first."""

    marks: tuple[Mark, ...]
    ticks: tuple[float, ...]

    @property
    def mark(self) -> Mark:
        """Where the crowd begins, and how many of what it is."""
        first = self.marks[0]
        same = all(m.text == first.text for m in self.marks)
        what = f"{len(self.marks)} × {first.text}" if same else f"{len(self.marks)} events"
        return Mark(first.time, f"{what} until {self.marks[-1].time:.4g} s")


def parted(marks: Sequence[Mark], start: float, stop: float) -> tuple[list[Mark], list[Crowd]]:
    """Marks that have room for a line on an axis from `start` to `stop`, and crowds of the others."""
    if not stop > start:
        return list(marks), []
    alone, crowds = list[Mark](), list[Crowd]()
    for group in _close(sorted(marks, key=lambda m: m.time), CLOSE * (stop - start)):
        if len(group) <= MOST:
            alone += group
            continue
        places = {int((m.time - start) / (stop - start) * PLACES): m.time for m in reversed(group)}
        crowds.append(Crowd(tuple(group), tuple(sorted(places.values()))))
    return alone, crowds


def _close(ordered: Sequence[Mark], gap: float) -> Iterator[list[Mark]]:
    group = list(ordered[:1])
    for before, mark in pairwise(ordered):
        if mark.time - before.time > gap:
            yield group
            group = []
        group.append(mark)
    yield group
