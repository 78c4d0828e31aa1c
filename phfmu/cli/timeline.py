"""What changes during a run: the scene's events and the rows of --input.  The command line wins over the scene."""

from __future__ import annotations

import argparse
from collections.abc import Iterable, Sequence
from typing import TYPE_CHECKING

from phfmu.words import counted

if TYPE_CHECKING:
    from phfmu.network.run.held import HeldInputs
    from phfmu.network.scene import Event, Scene

#: fewer rows are steps of an input, not data sampled over the run
SAMPLED = 10


def timeline(args: argparse.Namespace, scene: Scene, known: list[str], stop: float) -> tuple[list[Event], list[str]]:
    """The events of a run and a line for each that was left out.

    --set wins over the scene's events at or before the start, --input over those from its first row on.  `known`: scalar names
    that can be set.  ValueError: --set and a row of --input both give a value at the start.
    """
    from phfmu.cli.settings import settings

    set_here = settings(args.set)
    events, notes = started(scene.events, set_here, known)
    given = _covered(set_here, known)
    if not args.input:
        return events, notes
    from phfmu.cli.table import read_inputs

    rows = read_inputs(args.input, known)
    twice = sorted(given & set(rows.names))
    if twice and rows.time[0] <= 0.0:
        raise ValueError(
            f"{twice[0]} is given by --set and by the row of {args.input} at {rows.time[0]:g} s; leave one of them out"
        )
    first = float(rows.time[0])
    events = _without(events, set(rows.names), lambda e: e.t >= first, args.input, known, notes)
    return [*events, *(e for e in rows.events() if e.t <= stop)], notes + _outside(args.input, rows, stop)


def started(events: Sequence[Event], given: Iterable[str], known: list[str]) -> tuple[list[Event], list[str]]:
    """Events less what --set gives at the start, which wins, and a line for each that lost some."""
    notes: list[str] = []
    return _without(list(events), _covered(given, known), lambda e: e.t <= 0.0, "--set", known, notes), notes


def _covered(names: Iterable[str], known: list[str]) -> set[str]:
    """The scalars that names stand for; the bare name of a vector stands for all of it."""
    chosen = set(names)
    return {n for n in known if n in chosen or n.partition("[")[0] in chosen}


def _without(events: list[Event], given: set[str], chosen, by: str, known: list[str], notes: list[str]) -> list[Event]:
    """Events less the scalars that the command line gives, where `chosen`; a line in `notes` for each that lost some."""
    from dataclasses import replace

    left: list[Event] = []
    for e in events:
        lost = _covered([e.name], known) & given if chosen(e) else set()
        if not lost:
            left.append(e)
            continue
        notes.append(f"{by} wins over the scene's event {e.name} = {e.value:g} at t = {e.t:g} s")
        left += [replace(e, name=n) for n in known if n in _covered([e.name], known) - lost]
    return left


def _outside(path: str, rows: HeldInputs, stop: float) -> list[str]:
    """Lines about rows before the start and after the end, and data that begin late or end early."""
    import numpy as np

    early, late = int((rows.time < 0.0).sum()), int((rows.time > stop).sum())
    notes = []
    if early:
        notes.append(
            f"{path}: {counted(early, 'row')} before the start, from t = {rows.time[0]:g} s; "
            f"{'the last of them' if early > 1 else 'it'} holds at 0 s"
        )
    if rows.time[0] > 0.0:
        notes.append(f"{path}: begins at t = {rows.time[0]:g} s, the start values hold before")
    gap = 2 * float(np.median(np.diff(rows.time))) if len(rows.time) > SAMPLED else stop
    if rows.time[-1] < stop - gap:
        notes.append(f"{path}: ends at t = {rows.time[-1]:g} s, its last row holds until the end at {stop:g} s")
    if late:
        first = float(rows.time[len(rows.time) - late])
        notes.append(f"{path}: {counted(late, 'row')} after the end at {stop:g} s, from t = {first:g} s, not used")
    return notes
