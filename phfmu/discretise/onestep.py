"""One step of a scheme as a plan."""

from __future__ import annotations

from dataclasses import replace

from phfmu.plan.differences import in_differences
from phfmu.plan.layout import Layout
from phfmu.plan.plan import Plan
from phfmu.plan.planner import make_plan
from phfmu.plan.spec import Spec
from phfmu.schemes.scheme import Scheme
from phfmu.schur.stepper import find_stepper
from phfmu.terms.term import Term, Terms


def step_layout(terms: Terms, scheme: Scheme) -> Layout:
    """The layout of the unknowns of a step of `scheme`."""
    terms = scheme.prepare(terms)
    return Layout(terms, scheme.nodes.k, scheme.unknowns(terms), scheme.reports(terms))


def step_plan(terms: Terms, scheme: Scheme) -> tuple[Plan, Layout]:
    """The plan of one step of `scheme` for the extracted `terms`."""
    layout = step_layout(terms, scheme)
    terms = layout.terms
    cache: dict[tuple, list[Spec]] = {}
    work: list[tuple[Term, list[Spec]]] = []
    for term in terms.terms:
        if term.key not in cache:
            cache[term.key] = [in_differences(s) for s in scheme.specs(term)]
        work.append((term, cache[term.key]))
    maps, constants = scheme.maps(layout), scheme.constants(layout)
    plan = make_plan(layout, work, constants, maps, scheme.holds(layout))
    return replace(plan, schur=find_stepper(layout, scheme, plan)), layout
