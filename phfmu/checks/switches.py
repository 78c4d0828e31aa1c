"""Rules on switches: what they are made of is there and fits; the rest is checked of the model in its modes at the start."""

from __future__ import annotations

from collections import Counter
from collections.abc import Iterator
from difflib import get_close_matches

import casadi as ca

from phfmu.declare.event import LAWS
from phfmu.declare.phdae import PHDAE
from phfmu.declare.problem import Problem
from phfmu.declare.switch import Switch
from phfmu.declare.variable import _sx, key
from phfmu.declare.variable_kind import VariableKind


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
