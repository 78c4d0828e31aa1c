"""A run whose inputs follow data: rows become events where they are held, else functions of time that the stepper reads."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Iterator
from contextlib import contextmanager
from functools import partial
from heapq import merge
from itertools import takewhile
from math import inf
from os import PathLike, fspath
from typing import Any

from phfmu.network.couplings.monolithic import Monolithic
from phfmu.network.couplings.stepper import Follows, Stepper
from phfmu.network.members.interpolant import Interpolant
from phfmu.network.scene import Event
from phfmu.runs.inputs.input_rows import InputRows, input_rows, require_interpolation
from phfmu.runs.options import Options


@contextmanager
def following(
    stepper: Stepper, options: Options, inputs: Any, interpolate: str
) -> Iterator[tuple[Callable[..., Iterator[Event]], list[str]]]:
    """The events of a run in order, all or from a time on, with those that the inputs make, and lines about these.

    The stepper follows the rest until the end.

    Errors: KeyError, ValueError for inputs and options that do not go together.
    """
    require_interpolation(interpolate)
    if inputs is None:
        if interpolate != "held":
            raise ValueError(f"--interpolate {interpolate} is for --input; give it too")
        yield partial(_in_order, options, lambda _: ()), []
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
    events = partial(_in_order, options, partial(_events, rows, found, options.t0))
    notes = rows.notes(options.t0, options.stop) + rows.between(found, interpolate, options.step)
    if found is None or not isinstance(stepper, Follows):
        yield events, notes
        return
    if isinstance(stepper, Monolithic) and stepper.lands:
        notes.append(f"{rows.source}: with state events inputs have their mean over each step: order 2")
    stepper.followed = found
    try:
        yield events, notes
    finally:
        stepper.followed = None


def _rows(inputs: Any, stepper: Stepper) -> InputRows:
    if isinstance(inputs, str | PathLike):
        from phfmu.runs.inputs.input_file import read_inputs

        return read_inputs(fspath(inputs), stepper.settable())
    return input_rows(inputs, stepper.settable())


def _in_order(options: Options, given: Callable[[float], Iterable[Event]], since: float = -inf) -> Iterator[Event]:
    """The events of the options, and those that inputs give until the end, from a time on; at one time those of the options are
    first."""
    events = sorted((e for e in options.events if e.t >= since), key=_time)
    return merge(events, takewhile(lambda e: e.t <= options.stop, given(since)), key=_time)


def _time(e: Event) -> float:
    return e.t


def _events(rows: InputRows, found: Interpolant | None, t0: float, since: float) -> Iterator[Event]:
    """Rows of what is held, and where interpolated inputs start and jump, from a time on."""
    if found is None:
        return rows.events(since=since)
    held = rows.events([n for n in rows.names if n not in found.names], since)
    starts = found(t0, after=True).tolist()
    jumps = [Event(t0, n, v) for n, v in zip(found.names, starts, strict=True)]
    for t, values in zip(found.jumps.tolist(), found.after.tolist(), strict=True):
        jumps += [Event(t, n, v) for n, v in zip(found.names, values, strict=True) if t > t0]
    return merge(held, (e for e in jumps if e.t >= since), key=_time)


def _require_one_source(rows: InputRows, options: Options) -> None:
    """Raise ValueError where events give what the rows give, from the first of them on."""
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
