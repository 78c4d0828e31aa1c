"""Rules on state events: their directions, what arms them and what they set, their jumps."""

from __future__ import annotations

from collections.abc import Iterator
from difflib import get_close_matches
from math import isfinite, isnan

from phfmu.checks.sample import Sample
from phfmu.declare.entries import Entries, Entry
from phfmu.declare.entry_kind import EntryKind
from phfmu.declare.event import LAWS, Jump, StateEvent
from phfmu.declare.phdae import PHDAE
from phfmu.declare.problem import Problem


def state_events(entries: Entries) -> list[Problem]:
    """Names are scalar parameters, values are finite, directions -1, 0 or 1, restitutions in [0, 1]."""
    model, found = entries.model, list[Problem]()
    for e in model.state_events:
        found += _direction(e)
        for what in ("when", "sets", "rest"):
            found += _values(model, e, what)
        if e.jump is not None:
            found += _jump(f"jump '{e.guard.name}'", e.jump)
    if not found and (jumps := entries.of(EntryKind.RESTITUTION)):
        found += _restitutions(Sample(entries), jumps)
    return found


def _direction(e: StateEvent) -> Iterator[Problem]:
    if e.guard.direction not in (-1, 0, 1):
        yield Problem(
            "state-event",
            f"guard '{e.guard.name}'",
            f"direction = {e.guard.direction}",
            "give -1 (falling), 1 (rising) or 0 (both)",
        )


def _jump(entry: str, jump: Jump) -> Iterator[Problem]:
    if not jump.most >= 0:
        yield Problem("state-event", entry, f"most = {jump.most:g}", "give the largest |c|, from 0")
    if jump.law not in LAWS:
        close = get_close_matches(jump.law, LAWS, 1)
        remedy = f"did you mean {close[0]!r}?" if close else f"there are: {', '.join(LAWS)}"
        yield Problem("state-event", entry, f"{jump.law!r} is no law", remedy)


def _values(model: PHDAE, e: StateEvent, what: str) -> Iterator[Problem]:
    known = [n for v in model.parameters for n in v.names()]
    whole = {v.name: v.names() for v in model.parameters if v.size is not None}
    for name, value in getattr(e, what).items():
        entry = f"state event '{e.guard.name}': {what} {name}"
        if name not in known:
            close = whole.get(name) or get_close_matches(name, known, 3)
            remedy = f"did you mean {', '.join(close)}?" if close else f"there are: {', '.join(known[:12]) or 'none'}"
            yield Problem("state-event", entry, f"'{name}' is no scalar parameter", remedy)
        elif not isfinite(value):
            yield Problem("state-event", entry, f"the value is {value}", "give a finite number")


def _restitutions(sample: Sample, jumps: list[Entry]) -> Iterator[Problem]:
    for entry, values in zip(jumps, sample.of(jumps), strict=True):
        worst = next((float(v) for v in values[:, 0, 0] if isnan(v) or not 0 <= v <= 1), None)
        if worst is not None:
            yield Problem(
                "state-event", entry.label, f"is {worst:.6g}", "give 0 (c vanishes) to 1 (c is turned round): more makes energy"
            )  # fmt: skip
