"""Rules on state events: their directions, what arms them and what they set, their jumps.

Rules on switches: what they are made of is there and fits; the rest is checked of the model in its modes at the start.

Contacts of the wrong sign: what pushes must act along the rate at which its gap opens.

The rate of a gap g(x), or of the guard of a contact's jump, is grad g . E^-1 [(J - R) z + B u]; the contact acts along
c = on^T z.
Both are compared in z and u: opposite ones would pull where they are to push, and let bodies pass.
"""

from __future__ import annotations

from collections import Counter
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from difflib import get_close_matches
from math import isfinite, isnan

import casadi as ca
import numpy as np

from phfmu.checks.sample import Sample
from phfmu.declare.entries.entries import Entries, Entry
from phfmu.declare.entries.entry_kind import EntryKind
from phfmu.declare.error import Problem
from phfmu.declare.event import LAWS, Jump, StateEvent
from phfmu.declare.phdae import PHDAE
from phfmu.declare.switch import Switch
from phfmu.declare.variable import Variable, VariableKind, _sx, key, time
from phfmu.terms.extraction.extract import extract
from phfmu.terms.held import rates
from phfmu.terms.rows import costate_symbols, flow_expressions


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


def switches(model: PHDAE) -> list[Problem]:
    """Multipliers and modes are declared, scalar and of one switch each; columns, laws and numbers fit."""
    found = [p for s in model.switches for p in _switch(model, s)]
    for what in ("multiplier", "mode"):
        many = Counter(getattr(s, what).names()[0] for s in model.switches)
        for name, n in many.items():
            if n > 1:
                remedy = f"give each switch a {what} of its own"
                found.append(Problem("switch", model.name, f"{n} switches have the {what} '{name}'", remedy))
    return found


def _switch(model: PHDAE, s: Switch) -> Iterator[Problem]:
    entry = f"switch '{s.name}'"
    asked = (
        ("multiplier", VariableKind.ALGEBRAIC, model.algebraics),
        ("mode", VariableKind.PARAMETER, model.parameters),
    )
    for what, kind, listed in asked:
        v = getattr(s, what)
        names, symbols = (
            [n for w in listed for n in w.names()],
            {e.element_hash() for w in listed for e in ca.vertsplit(w.sx)},
        )
        if v.kind is not kind or v.n != 1 or v.sx.element_hash() not in symbols:
            close = get_close_matches(v.name, names, 3) or names[:8]
            shown = f"its {what} '{v.name}' is {v.kind} of {v.n}, not one {kind} of the model"
            yield Problem("switch", entry, shown, f"there are: {', '.join(close) or 'none'}")
    if float(s.mode.start[0]) not in (0.0, 1.0):
        yield Problem("switch", entry, f"its mode starts at {s.mode.start[0]:g}", "start with 1 (on) or 0 (off)")
    if s.law not in LAWS:
        close = get_close_matches(str(s.law), LAWS, 1)
        yield Problem(
            "switch",
            entry,
            f"its law is '{s.law}'",
            f"did you mean {close[0]}?"
            if close
            else f"give {' or '.join(LAWS)}; a force between two limits (Coulomb friction) is none: round it off, as dissipation",
        )
    if not s.nominal > 0 or not s.most >= 0:
        yield Problem(
            "switch", entry, f"nominal = {s.nominal:g}, most = {s.most:g}", "give a nominal above 0, most from 0"
        )
    if not s.on:
        yield Problem("switch", entry, "stands on no variable", "give `on`: what its multiplier acts on")
    known = {e.element_hash(): v for v in (*model.states, *model.algebraics, *model.ports) for e in ca.vertsplit(v.sx)}
    for v, column in s.on.items():
        shape = ca.SX(_sx(column)).shape
        if key(v) not in known:
            yield Problem(
                "switch", entry, f"stands on '{v.name}', which the model does not have", "list it in the model"
            )
        elif shape != (v.n, 1):
            yield Problem("switch", entry, f"its column on '{v.name}' is {shape[0]} x {shape[1]}", f"give {v.n} x 1")


#: of cosines: what counts as opposite
OPPOSITE = 0.99


@dataclass(frozen=True)
class GapRate:
    """Gap of a switch or jump, and the velocity c that is to be its rate; `remedy`: for one of the wrong sign."""

    rule: str
    entry: str
    gap: ca.SX
    c: ca.SX
    remedy: str


def closing(model: PHDAE, switches: Sequence[Switch]) -> list[Problem]:
    """Contacts that act against the rate of their gap; those that cannot be compared are left out.

    model: in one of the modes of its `switches`
    """
    contacts = [*_gaps(model, switches), *_jumps(model.state_events)]
    if not contacts:
        return []
    terms = extract(model)
    inputs = [q.port.u[q.j] for q in terms.pairs]
    u, a = ca.vertcat(ca.SX(0, 1), *inputs), ca.vertcat(ca.SX(0, 1), *(v.sx for v in model.algebraics))
    bound = [a[terms.bound[i]] if i in terms.bound else s for i, s in enumerate(inputs)]
    z = costate_symbols(model)
    flow = flow_expressions(terms, z, u)[0]
    read = ca.vertcat(ca.SX(0, 1), z, u, a)
    found = []
    for contact in contacts:
        if ca.depends_on(contact.gap, read) or not ca.depends_on(contact.gap, model.x):
            continue
        speed = ca.mtimes(ca.jacobian(contact.gap, model.x), rates(terms, flow))
        c = ca.substitute([contact.c], [u], [ca.vertcat(ca.SX(0, 1), *bound)])[0]
        if _cosine(model, speed, c, read) < -OPPOSITE:
            what = "acts against the rate at which its gap opens: it would pull where it is to push"
            found.append(Problem(contact.rule, contact.entry, what, contact.remedy))
    return found


def _gaps(model: PHDAE, switches: Sequence[Switch]) -> Iterator[GapRate]:
    for s in switches:
        if s.gap is not None and s.law == "unilateral":
            on = ", ".join(f"{v.name}: {ca.SX(-_sx(column))}" for v, column in s.on.items())
            gap = ca.SX(_sx(s.gap))
            yield GapRate(
                "switch",
                f"switch '{s.name}'",
                gap,
                s.rate(model.effort),
                f"turn the sign of `on` round, {{{on}}}, or of `gap`",
            )


def _jumps(events: Sequence[StateEvent]) -> Iterator[GapRate]:
    for e in events:
        if e.jump is None or e.jump.law != "unilateral" or e.guard.direction == 0:
            continue
        gap = -e.guard.direction * ca.SX(_sx(e.guard.expr))
        c = sum((ca.dot(ca.SX(_sx(column)), v.z) for v, column in e.jump.on.items()), ca.SX(0))
        on = ", ".join(f"{v.name}: {ca.SX(-_sx(column))}" for v, column in e.jump.on.items())
        remedy = f"turn the sign of its column round, {{{on}}}, or the direction of the guard"
        yield GapRate("state-event", f"jump '{e.guard.name}'", gap, c, remedy)


def _cosine(model: PHDAE, speed: ca.SX, c: ca.SX, read: ca.SX) -> float:
    """The cosine of the angle of both gradients in `read`, at the start; 0 where one of them is zero or unknown."""
    both = [ca.densify(ca.gradient(e, read)) for e in (speed, c)]
    known: list[Variable] = [*model.states, *model.parameters]
    at = [v.sx for v in known]
    f = ca.Function("slopes", [ca.vertcat(ca.SX(0, 1), *at), read, time], both, {"allow_free": True})
    if f.has_free():
        return 0.0
    start = np.array([s for v in known for s in v.start], float)
    g, of_c = (np.array(v).ravel() for v in f(start, np.zeros(read.numel()), 0.0))
    size = float(np.linalg.norm(g) * np.linalg.norm(of_c))
    return float(g @ of_c) / size if np.isfinite(size) and size > 0 else 0.0
