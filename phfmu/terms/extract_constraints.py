"""From holonomic constraints to terms."""

from __future__ import annotations

import casadi as ca

from phfmu.declare.error import DeclarationError
from phfmu.declare.phdae import PHDAE
from phfmu.declare.value import Value
from phfmu.declare.variable import time
from phfmu.terms.canonical import Locator, make_term, member
from phfmu.terms.located import Row, RowAt
from phfmu.terms.term import CONSTRAINT, Terms
from phfmu.terms.velocities import velocity_of


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
                          owner=member(out.members, c.owner))
            )  # fmt: skip
    _require_velocities(out)


def _require_velocities(out: Terms) -> None:
    known = velocity_of(out)
    for t in out.of(CONSTRAINT):
        bad = [out.state_names[q] for q in t.indices(Value.STATE) if q not in known]
        if bad:
            raise DeclarationError(
                f"{out.model.name}: constraint of '{out.algebraic_names[t.rows[0].index]}'",
                f"depends on {', '.join(bad)}, whose row is not q' = z_v",
                "constraints act on positions with skew(q, v, 1.0) and no other term in their rows",
                "velocity",
            )
