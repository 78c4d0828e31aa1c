"""Extraction: walk a declaration once and list its terms and constant entries.

From holonomic constraints to terms.
"""

from __future__ import annotations

import casadi as ca

from phfmu.declare.error import DeclarationError
from phfmu.declare.phdae import PHDAE
from phfmu.declare.variable import ValueKind, time
from phfmu.terms.canonical import Locator, make_term
from phfmu.terms.extraction.extract_energy import energies
from phfmu.terms.extraction.extract_flows import blocks, ports
from phfmu.terms.extraction.extract_masses import closed_pairs, masses
from phfmu.terms.hidden import hidden_rows
from phfmu.terms.located import Row, RowAt
from phfmu.terms.term import CONSTRAINT, OBSERVABLE, PortPair, Terms
from phfmu.terms.velocities import velocities, velocity_of


def constraints(model: PHDAE, out: Terms, locator: Locator) -> None:
    """A term for each row of g; the velocities are known.  DeclarationError if g acts on no positions."""
    for c in model.constraints:
        name = c.multiplier.name
        drive = [] if c.drive is None else [RowAt(Row.OUTPUT, locator.find(c.drive.u[0], f"drive of '{name}'").index)]
        if c.g.shape != (c.multiplier.n, 1):
            raise DeclarationError(
                f"constraint '{c.multiplier.name}'", f"g is {c.g.shape[0]} x {c.g.shape[1]}, its multiplier has "
                f"{c.multiplier.n} entries", "give the multiplier one entry for each row of g", "shape",
            )  # fmt: skip
        for j, at in enumerate(locator.of(c.multiplier)):
            rows = [RowAt(Row.EQUATION, at.index), *(drive if ca.depends_on(c.g[j], time) else [])]
            out.terms.append(
                make_term(CONSTRAINT, {"g": c.g[j]}, locator, f"constraint '{name}'", rows=rows,
                          owner=out.member(c.owner))
            )  # fmt: skip
    _require_velocities(out)


def _require_velocities(out: Terms) -> None:
    known = velocity_of(out)
    for t in out.of(CONSTRAINT):
        bad = [out.state_names[q] for q in t.indices(ValueKind.STATE) if q not in known]
        if bad:
            raise DeclarationError(
                f"{out.model.name}: constraint of '{out.algebraic_names[t.rows[0].index]}'",
                f"depends on {', '.join(bad)}, whose row is not q' = z_v",
                "constraints act on positions with skew(q, v, 1.0) and no other term in their rows",
                "velocity",
            )


def extract(model: PHDAE, *, joint: bool = False) -> Terms:
    """All terms of `model`; `joint` merges the energies of each member into one term (joint Gonzalez gradient)."""
    members = list(model.members)
    free = [p for p in model.ports if p.external]
    rest = [p for p in model.ports if not p.external]
    out = Terms(
        model,
        n1=sum(v.n for v in model.states),
        na=sum(v.n for v in model.algebraics),
        np=sum(v.n for v in model.parameters),
        nu=sum(p.n for p in free),
        members=members,
    )
    pairs = out.pairs = [PortPair(p, j, out.member(p.owner)) for p in (*free, *rest) for j in range(p.n)]
    locator = Locator(model, pairs)
    for i, pair in enumerate(pairs):
        if pair.port.bound is not None:
            out.bound[i] = locator.find(pair.port.bound[pair.j], pair.port.name).index
    diagonal = masses(model, out, locator)
    closed_pairs(model, out, locator)
    blocks(model, out, locator)
    ports(out, locator)
    out = out.having(velocities(out))
    constraints(model, out, locator)
    energies(model, out, locator, diagonal, joint)
    _observables(model, out, locator)
    _modes(model, out, locator)
    return out.having(hidden_rows(out))


def _observables(model: PHDAE, out: Terms, locator: Locator) -> None:
    first = 0
    for o in model.observables:
        n = o.expr.numel()
        rows = [RowAt(Row.OBSERVABLE, first + j) for j in range(n)]
        out.observable_names += o.names()
        f = o.expr if o.expr.is_column() else ca.vec(o.expr)
        out.terms.append(make_term(OBSERVABLE, {"f": f}, locator, f"observable '{o.name}'", rows=rows))
        first += n


def _modes(model: PHDAE, out: Terms, locator: Locator) -> None:
    """Parameters that state events set are reported, after the observables."""
    if not model.modes:
        return
    symbols = {n: s for v in model.parameters for n, s in zip(v.names(), ca.vertsplit(v.sx), strict=True)}
    for name in model.modes:
        rows = [RowAt(Row.OBSERVABLE, len(out.observable_names))]
        out.observable_names.append(name)
        out.terms.append(make_term(OBSERVABLE, {"f": symbols[name]}, locator, f"mode '{name}'", rows=rows))
