"""The instant plan: outputs, observables, energies and algebraic variables at one instant.

Given x, t and u:  algebraic rows that contain algebraic variables are solved as they are (index 1); rows that contain
states only are differentiated once (index 2: Kirchhoff at bare nodes, holonomic constraints) and solved together with
x1' from E11 x1' = [(J - R) z + B u]_1.  The undifferentiated rows are reported as checks of a consistent state.
"""

from __future__ import annotations

import numpy as np

from phfmu.declare.error import DeclarationError
from phfmu.declare.variable import ValueKind
from phfmu.discretise.instant_kernels import RATE, InstantKernels
from phfmu.plan.layout import Layout
from phfmu.plan.plan import Plan
from phfmu.plan.planner import SchemeMaps, make_plan
from phfmu.plan.spec import Spec
from phfmu.plan.unknown import ALGEBRAIC, COSTATE, INCREMENT, of_algebraics, of_states
from phfmu.schemes.scheme import node_holds
from phfmu.terms.hidden import Check, HiddenConstraints, Level, variable_at
from phfmu.terms.located import Row, ValueAt
from phfmu.terms.term import (
    CONSTRAINT,
    Terms,
)


def instant_plan(terms: Terms, rests: bool = True) -> tuple[Plan, list[Check], Layout]:
    """The instant plan, its checks (reported as the last observables), and where its unknowns are.

    `rests`: redundant constraints may rest.
    """
    hidden, solved = terms.found(HiddenConstraints), terms.solved_costates()
    if hidden.rows and solved:
        raise DeclarationError(
            terms.model.name,
            "constraints together with a non-diagonal or state-dependent E are not supported yet",
            "use coordinates with a diagonal E",
            "descriptor",
        )
    unknowns = of_states(terms, INCREMENT, "rate of", range(terms.n1)) if hidden.rows else []
    unknowns += of_states(terms, COSTATE, "costate of", solved)
    unknowns += of_algebraics(terms, ALGEBRAIC, "equation of", range(terms.na))
    unknowns += of_algebraics(terms, RATE, "rate of", sorted(hidden.solved_by.values()))
    position = {t.rows[0].index for t in terms.of(CONSTRAINT)}
    levels = ((Level.VELOCITY, hidden.checks), (Level.POSITION, sorted(position)))
    checks = [Check(terms.algebraic_names[a], level, a) for level, which in levels for a in which]
    reports = [*range(len(terms.observable_names)), *((c.level, c.row) for c in checks)]
    layout = Layout(terms, 1, unknowns, reports, rates=bool(hidden.rows))
    rule = InstantKernels(hidden, terms.bound)
    cache: dict[tuple, list[Spec]] = {}
    work = []
    for term in terms.terms:
        key = (term.key, tuple((hidden.differentiates(r), r.index in hidden.solved_by) for r in term.rows))
        if key not in cache:
            cache[key] = rule.specs(term)
        work.append((term, cache[key]))
    mean = [(i, layout.at(ALGEBRAIC, i), 1.0, 0) for i in range(terms.na)]
    guess = [[(w, 1.0, 0)] for w in range(layout.nw)]
    maps = SchemeMaps([], mean, guess, np.ones(1), np.full(1, 0.5))
    hold = node_holds(layout) if rests else None
    return make_plan(layout, work, _constants(layout, hidden), maps, hold), checks, layout


def _constants(layout: Layout, hidden: HiddenConstraints) -> list[tuple[int, int, float, int]]:
    terms, out = layout.terms, []
    other = terms.with_descriptor()
    if hidden.rows:
        out += [(w, w, 1.0, 0) for w in (layout.at(INCREMENT, i) for i in range(terms.n1) if i not in other)]
    out += [(layout.at(COSTATE, i), layout.nv + layout.slot(i, 0), -1.0, 0) for i in terms.solved_costates()]
    for c in terms.constants:
        if c.row.kind is Row.BALANCE and not hidden.rows:
            continue
        source, r = layout.value(c.source), c.row.index
        if hidden.differentiates(c.row):
            if r in hidden.solved_by:
                out.append((layout.at(RATE, hidden.solved_by[r]), source, -c.value, 0))
            else:
                out.append((layout.report(("velocity", r)), source, c.value, 0))
            rate = _rate(layout, c.source)
            if rate is not None:
                out.append((layout.row(c.row), rate, -c.value, 0))
        else:
            out.append((layout.row(c.row), source, c.value if c.row.kind is Row.OUTPUT else -c.value, 0))
    return out


def _rate(layout: Layout, value: ValueAt) -> int | None:
    """Y index of the time derivative of a value in a differentiated row; held inputs have none."""
    variable = variable_at(value, layout.terms.bound)
    if variable is not None:
        return layout.at(RATE, variable)
    if value.kind is ValueKind.COSTATE:
        return layout.costate_rate(value.index)
    return layout.nv + layout.source_rate_slot(value.index) if value.index in layout.sources else None
