"""Stretches of a run between changes: input rows that fall on the grid of steps are taken inside one."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Iterator
from dataclasses import dataclass
from sys import float_info

from phfmu.network.scene import Event

#: of a step: times that differ by less are one
CLOSE = 1e-9
#: of a time: what its digits and the products of the grid lose
ROUNDING = 4 * float_info.epsilon


@dataclass(frozen=True)
class Stretch:
    """[start, end] in s; `events` count at the start.

    inputs: (number of the step from 0, event) of free inputs that change between steps; then all steps are equal
    """

    start: float
    end: float
    events: list[Event]
    inputs: tuple[tuple[int, Event], ...] = ()


def stretches(
    segments: Iterable[tuple[float, float, list[Event]]], step: float, free: Callable[[str], bool]
) -> Iterator[Stretch]:
    """(start, end, events at start) joined where the events set `free` inputs and fall on the grid of `step`."""
    first: tuple[float, float, list[Event]] | None = None
    steps, inputs, known = 0, [], dict[str, bool]()
    for start, end, here in segments:
        n = _whole(end - start, step)
        if (
            first is not None
            and _continues(first[0] + steps * step, start, step)
            and n
            and all(known[e.name] if e.name in known else known.setdefault(e.name, free(e.name)) for e in here)
        ):
            inputs += [(steps, e) for e in here]
            first, steps = (first[0], end, first[2]), steps + n
            continue
        if first is not None:
            yield Stretch(*first, tuple(inputs))
        if n:
            first, steps, inputs = (start, end, here), n, []
        else:
            first = None
            yield Stretch(start, end, here)
    if first is not None:
        yield Stretch(*first, tuple(inputs))


def _whole(length: float, step: float) -> int:
    """How many steps the length is, 0 if it is no multiple."""
    n = round(length / step)
    return n if n and abs(length - n * step) <= CLOSE * step else 0


def _continues(grid: float, start: float, step: float) -> bool:
    return abs(grid - start) <= CLOSE * step + ROUNDING * abs(start)
