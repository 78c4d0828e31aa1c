"""Contacts of the wrong sign: what pushes must act along the rate at which its gap opens.

The rate of a gap g(x), or of the guard of a contact's jump, is grad g . E^-1 [(J - R) z + B u]; the contact acts along
c = on^T z.
Both are compared in z and u: opposite ones would pull where they are to push, and let bodies pass.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass

import casadi as ca
import numpy as np

from phfmu.declare.event import StateEvent
from phfmu.declare.phdae import PHDAE
from phfmu.declare.problem import Problem
from phfmu.declare.switch import Switch
from phfmu.declare.variable import Variable, _sx, time
from phfmu.terms.extract import extract
from phfmu.terms.held import rates
from phfmu.terms.rows import costate_symbols, flow_expressions

#: of cosines: what counts as opposite
OPPOSITE = 0.99


@dataclass(frozen=True)
class Contact:
    """gap: a distance, whose rate is to be c;  remedy: for one of the wrong sign."""

    rule: str
    entry: str
    gap: ca.SX
    c: ca.SX
    remedy: str


def closing(model: PHDAE, switches: Sequence[Switch]) -> list[Problem]:
    """`model`: in one of the modes of its `switches`.  What cannot be compared is left out."""
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


def _gaps(model: PHDAE, switches: Sequence[Switch]) -> Iterator[Contact]:
    for s in switches:
        if s.gap is not None and s.law == "unilateral":
            on = ", ".join(f"{v.name}: {ca.SX(-_sx(column))}" for v, column in s.on.items())
            gap = ca.SX(_sx(s.gap))
            yield Contact(
                "switch",
                f"switch '{s.name}'",
                gap,
                s.rate(model.effort),
                f"turn the sign of `on` round, {{{on}}}, or of `gap`",
            )


def _jumps(events: Sequence[StateEvent]) -> Iterator[Contact]:
    for e in events:
        if e.jump is None or e.jump.law != "unilateral" or e.guard.direction == 0:
            continue
        gap = -e.guard.direction * ca.SX(_sx(e.guard.expr))
        c = sum((ca.dot(ca.SX(_sx(column)), v.z) for v, column in e.jump.on.items()), ca.SX(0))
        on = ", ".join(f"{v.name}: {ca.SX(-_sx(column))}" for v, column in e.jump.on.items())
        remedy = f"turn the sign of its column round, {{{on}}}, or the direction of the guard"
        yield Contact("state-event", f"jump '{e.guard.name}'", gap, c, remedy)


def _cosine(model: PHDAE, speed: ca.SX, c: ca.SX, read: ca.SX) -> float:
    """Of the gradients of both in `read`, at the start; 0 where one of them is zero or unknown."""
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
