"""A run whose inputs follow data: rows become events where they are held, else functions of time that the stepper reads."""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import replace
from os import PathLike, fspath
from typing import Any

from phfmu.network.couplings.monolithic import Monolithic
from phfmu.network.couplings.stepper import Follows, Stepper
from phfmu.network.members.interpolant import Interpolant
from phfmu.network.scene import Event
from phfmu.runs.input_rows import InputRows, input_rows, require_interpolation
from phfmu.runs.options import Options


@contextmanager
def following(stepper: Stepper, options: Options, inputs: Any, interpolate: str) -> Iterator[tuple[Options, list[str]]]:
    """Options with the events that the inputs make, and lines about them; the stepper follows the rest until the end.

    Errors: KeyError, ValueError for inputs and options that do not go together.
    """
    require_interpolation(interpolate)
    if inputs is None:
        if interpolate != "held":
            raise ValueError(f"--interpolate {interpolate} is for --input; give it too")
        yield options, []
        return
    rows, found = _rows(inputs, stepper), None
    _require_one_source(rows, options)
    if interpolate != "held":
        if not isinstance(stepper, Follows):
            raise ValueError(
                f"--interpolate {interpolate} needs one composed model, or members that are stepped apart; here it is "
                f"{stepper.what}; {stepper.instead}, or a network with it as its member (Network.add), or leave "
                "--interpolate out: rows are held, each until the next one"
            )
        _require_fit(stepper, options)
        starts = {n: v for n, v in stepper.inputs().items() if n in stepper.free_inputs}
        found = rows.interpolant(interpolate, starts, options.t0)
    events = _events(rows, found, options.t0)
    notes = rows.notes(options.t0, options.stop) + rows.between(found, interpolate, options.step)
    options = replace(options, events=[*options.events, *(e for e in events if e.t <= options.stop)])
    if found is None or not isinstance(stepper, Follows):
        yield options, notes
        return
    if isinstance(stepper, Monolithic) and stepper.lands:
        notes.append(f"{rows.source}: with state events inputs have their mean over each step: order 2")
    stepper.followed = found
    try:
        yield options, notes
    finally:
        stepper.followed = None


def _rows(inputs: Any, stepper: Stepper) -> InputRows:
    if isinstance(inputs, str | PathLike):
        from phfmu.runs.input_file import read_inputs

        return read_inputs(fspath(inputs), stepper.settable())
    return input_rows(inputs, stepper.settable())


def _events(rows: InputRows, found: Interpolant | None, t0: float) -> list[Event]:
    """Rows of what is held, and where interpolated inputs start and jump."""
    if found is None:
        return rows.events()
    events = rows.events([n for n in rows.names if n not in found.names])
    starts = found(t0, after=True).tolist()
    events += [Event(t0, n, v) for n, v in zip(found.names, starts, strict=True)]
    for t, values in zip(found.jumps.tolist(), found.after.tolist(), strict=True):
        events += [Event(t, n, v) for n, v in zip(found.names, values, strict=True) if t > t0]
    return events


def _require_one_source(rows: InputRows, options: Options) -> None:
    """ValueError where events give what the rows give, from the first of them on."""
    for e in options.events:
        own = [n for n in rows.names if e.name in (n, n.partition("[")[0])]
        if own and e.t >= rows.time[0]:
            raise ValueError(
                f"{own[0]} is given by {rows.source} and by the event {e.name} = {e.value:g} at t = {e.t:g} s; leave one out"
            )


def _require_fit(whole: Stepper, options: Options) -> None:
    if options.dense is not None:
        raise ValueError("--dense does not go with interpolated inputs yet; leave one of them out")
    if whole.lands and options.adaptive:
        raise ValueError(
            "--rtol does not go with interpolated inputs and state events yet; take equal steps without it"
        )
