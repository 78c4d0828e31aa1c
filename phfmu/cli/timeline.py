"""Changes during a run: the scene's events and the rows of --input.  The command line wins over the scene."""

from __future__ import annotations

import argparse
from collections.abc import Iterable, Sequence
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from phfmu.network.scene import Event, Scene
    from phfmu.runs.inputs.input_rows import InputRows


def timeline(
    args: argparse.Namespace, scene: Scene, known: list[str]
) -> tuple[list[Event], InputRows | None, list[str]]:
    """The scene's events in a run, the rows of --input, and a line for each event that was left out.

    --set wins over the scene's events at or before the start, --input over those from its first row on.  `known`: scalar names
    that can be set.  ValueError: --set and a row of --input both give a value at the start.
    """
    from phfmu.cli.settings import settings

    set_here = settings(args.set)
    events, notes = started(scene.events, set_here, known)
    given = _covered(set_here, known)
    if not args.input:
        return events, None, notes
    from phfmu.runs.inputs.input_file import read_inputs

    rows = read_inputs(args.input, known)
    twice = sorted(given & set(rows.names))
    if twice and rows.time[0] <= 0.0:
        raise ValueError(
            f"{twice[0]} is given by --set and by the row of {args.input} at {rows.time[0]:g} s; leave one of them out"
        )
    first = float(rows.time[0])
    events = _without(events, set(rows.names), lambda e: e.t >= first, args.input, known, notes)
    return events, rows, notes


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
