"""From holonomic constraints to terms, and which velocity moves which position."""

from __future__ import annotations

import casadi as ca

from phfmu.declare.error import DeclarationError
from phfmu.declare.phdae import PHDAE
from phfmu.declare.variable import time
from phfmu.terms.term import CONSTRAINT, Locator, Terms, make_term, member


def constraints(model: PHDAE, out: Terms, locator: Locator) -> None:
    """A term for each row of g, and `velocity_of`; the terms of J are there.  DeclarationError if g acts on no positions."""
    _velocities(out)
    for c in model.constraints:
        name = c.multiplier.name
        drive = [] if c.drive is None else [("y", locator.find(c.drive.u[0], f"drive of '{name}'")[1])]
        if c.g.shape != (c.multiplier.n, 1):
            raise DeclarationError(
                f"constraint '{c.multiplier.name}'", f"g is {c.g.shape[0]} x {c.g.shape[1]}, its multiplier has "
                f"{c.multiplier.n} entries", "give the multiplier one entry for each row of g", "shape",
            )  # fmt: skip
        for j, row in enumerate(locator.of(c.multiplier)):
            rows = [row, *(drive if ca.depends_on(c.g[j], time) else [])]
            out.terms.append(
                make_term(CONSTRAINT, {"g": c.g[j]}, locator, f"constraint '{name}'", rows=rows,
                          owner=member(out.members, c.owner))
            )  # fmt: skip
    _require_velocities(out)


def _velocities(out: Terms) -> None:
    """q -> v for rows q' = z_v (one constant unit entry): where the multiplier of g(q) acts."""
    other = out.with_descriptor()
    rows: dict[int, list[tuple[str, int, float]]] = {}
    for row_kind, row, kind, source, value in out.constants:
        if row_kind == "x":
            rows.setdefault(row, []).append((kind, source, value))
    out.velocity_of = {q: s[0][1] for q, s in rows.items() if len(s) == 1 and s[0][0] == "z" and s[0][2] == 1.0
                       and q not in other}  # fmt: skip


def _require_velocities(out: Terms) -> None:
    for t in out.of(CONSTRAINT):
        bad = [out.state_names[q] for q in t.index.get("x", ()) if q not in out.velocity_of]
        if bad:
            raise DeclarationError(
                f"{out.model.name}: constraint of '{out.algebraic_names[t.rows[0][1]]}'",
                f"depends on {', '.join(bad)}, whose row is not q' = z_v",
                "constraints act on positions with skew(q, v, 1.0) and no other term in their rows",
                "velocity",
            )
