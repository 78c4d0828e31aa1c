"""Warnings: constraints that a source moves, which steps meet at their nodes only."""

from __future__ import annotations

import casadi as ca

from phfmu.declare.phdae import PHDAE
from phfmu.declare.problem import Problem
from phfmu.declare.variable import _sx, time
from phfmu.terms.canonical import components
from phfmu.terms.extract import extract
from phfmu.terms.hidden import Hidden
from phfmu.terms.rows import costate_symbols, flow_expressions
from phfmu.terms.term import CONSTRAINT


def moving(model: PHDAE) -> list[Problem]:
    """Hidden constraints of the states that depend on time: a capacitor on an ideal source, a shaft that is driven."""
    if not any(p.source is not None and ca.depends_on(ca.SX(_sx(p.source)), time) for p in model.ports):
        return []
    terms = extract(model)
    holonomic, hidden = {t.rows[0].index for t in terms.of(CONSTRAINT)}, terms.found(Hidden)
    checks, rows = set(hidden.checks) - holonomic, sorted(hidden.rows)
    if not checks:
        return []
    inputs = [ca.SX(_sx(q.port.source))[q.j] if q.port.source is not None else q.port.u[q.j] for q in terms.pairs]
    z = costate_symbols(model)
    g = flow_expressions(terms, z, ca.vertcat(ca.SX(0, 1), *inputs))[1][rows]
    shared = ca.DM(ca.jacobian_sparsity(g, ca.vertcat(*(v.sx for v in model.algebraics))), 1)
    parts = components(ca.SX(ca.mtimes(shared, shared.T)) + ca.SX.eye(len(rows)))
    found = []
    for part in parts:
        tied = sorted(set(ca.jacobian_sparsity(g[part], z).get_triplet()[1]))
        if not tied or not ca.depends_on(g[part], time) or not checks.intersection(rows[i] for i in part):
            continue
        names = ", ".join(f"'{terms.state_names[i]}'" for i in tied[:4])
        found.append(
            Problem(
                "order", model.name,
                f"{names} {'is' if len(tied) == 1 else 'are'} tied to a source that moves with time, where the switches between "
                "are closed; steps meet it at their nodes only, with order k + 1 (k odd) or k (k even) in place of 2k",
                "put the resistance or the inductance of the source between", "warning",
            )
        )  # fmt: skip
    return found
