"""One step of a scheme as a plan."""

from __future__ import annotations

import numpy as np

from phfmu.discretise.collocated import Collocated
from phfmu.discretise.layout import Layout
from phfmu.discretise.plan import Plan
from phfmu.discretise.planner import Maps, make_plan
from phfmu.discretise.quadrature import nodes
from phfmu.discretise.spec import Spec
from phfmu.discretise.terms import Term, Terms


def step_plan(terms: Terms, scheme: Collocated) -> tuple[Plan, Layout]:
    """The plan of one step of `scheme` for the extracted `terms`."""
    terms = scheme.prepare(terms)
    layout = Layout(terms, scheme.k, _unknowns(terms, scheme))
    cache: dict[tuple, list[Spec]] = {}
    work: list[tuple[Term, list[Spec]]] = []
    for term in terms.terms:
        if term.key not in cache:
            cache[term.key] = scheme.specs(term)
        work.append((term, cache[term.key]))
    plan = make_plan(layout, work, _constants(layout), _maps(layout), na=terms.na, nobs=0)
    return plan, layout


def _unknowns(terms: Terms, scheme: Collocated) -> list[tuple[str, int, int]]:
    out: list[tuple[str, int, int]] = []
    for node in range(scheme.k):
        out += [("D", i, node) for i in range(terms.n1)]
        out += [("Z", i, node) for i in terms.solved_costates]
        out += [("a", i, node) for i in range(terms.na)]
    if scheme.two_level:
        out += [("m", t.rows[0][1], 0) for t in terms.terms if t.kind == "constraint"]
    return out


def _constants(layout: Layout) -> list[tuple[int, int, float, int]]:
    """Identity rows of E, E^T z = W rows, and the constant entries of (J - R) z + B u at every node."""
    terms, out = layout.terms, []
    other = {i for t in terms.terms if t.kind in ("mass", "massblock", "closed") for _, i in t.rows}
    for node in range(layout.k):
        for i in range(terms.n1):
            if i not in other:
                out.append((layout.row("x", i, node), layout.value("D", i, node), 1.0, 0))
        for i in terms.solved_costates:
            out.append((layout.w_of[("Z", i, node)], layout.nv + layout.slot(i, node), -1.0, 0))
        for row_kind, row, kind, source, value in terms.constants:
            sign = 1.0 if row_kind == "y" else -1.0
            out.append(
                (layout.row(row_kind, row, node), layout.value(kind, source, node), sign * value, int(row_kind == "x"))
            )
    return out


def _maps(layout: Layout) -> Maps:
    nd = nodes(layout.k)
    update, mean, guess = [], [], []
    ahead = np.array([nd.value(1.0 + c) for c in nd.c])  # extrapolate the last step's polynomial
    for w, (kind, i, node) in enumerate(layout.unknowns):
        if kind == "D":
            update.append((i, w, float(nd.b[node])))
        elif kind == "a":
            mean.append((i, w, float(nd.b[node])))
        if kind == "m":
            guess.append([(w, 1.0, 0)])
        else:
            last = [layout.w_of[(kind, i, j)] for j in range(layout.k)]
            guess.append([(last[j], float(ahead[node, j]), int(kind == "D")) for j in range(layout.k)])
    return Maps(update, mean, guess, nd.b)
