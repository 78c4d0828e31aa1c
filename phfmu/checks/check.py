"""The check of a declaration: every problem at once, each with its entry, its numbers and a remedy.

Rules:  name, unit, nominal, start (what is declared);  shape, symbol, source (expressions);  skew, symmetry,
passivity, friction, costate, mass (matrices at sampled points);  energy, closed-pair;  velocity, unused, solvability
(equations);  limit (parameters);  state-event (guards, modes, jumps);  switch;  dimension, kink, bounded, order (warnings);
internal (the check itself stopped at an entry).
"""

from __future__ import annotations

from collections.abc import Callable
from typing import TYPE_CHECKING

from phfmu.checks.dimensions import dimensions
from phfmu.checks.energies import bounded, closed_pairs, constants, energies
from phfmu.checks.equations import equations, moving, unused, velocities
from phfmu.checks.events import closing, state_events, switches
from phfmu.checks.friction import friction
from phfmu.checks.matrices import costates, finite, masses, passivity, skew_symmetry, symmetry
from phfmu.checks.names import names, nominals, ranges, shared_symbols, units
from phfmu.checks.pieces import continuous, kinks
from phfmu.checks.sample import Sample
from phfmu.declare.entries.entries import Entries, normal_form
from phfmu.declare.entries.starts import starts
from phfmu.declare.error import DeclarationError, Problem
from phfmu.declare.phdae import PHDAE, require_declaration
from phfmu.events.modes import Modes

if TYPE_CHECKING:
    from phfmu.schemes.scheme import Scheme

#: rules that only warn: they run where warnings are asked for, on a model without errors
WARNING_RULES: tuple[Callable[[Entries, Sample], list[Problem]], ...] = (dimensions, kinks, bounded, constants)

#: a model with a problem of these rules is not discretised: the planner would only repeat it
BLOCKING = {
    "shape",
    "symbol",
    "source",
    "start",
    "nominal",
    "energy",
    "mass",
    "velocity",
    "unused",
    "state-event",
    "internal",
}


def check(model: PHDAE, scheme: Scheme | None = None, *, strict: bool = False) -> list[Problem]:
    """All errors of `model`, an empty list if it is sound; with `strict` its warnings too (`Problem.severity`).

    Matrices and energies are evaluated at the start and at seeded points around it, within the nominal size
    of each variable and with the parameters at their start values.  The equations are planned for `scheme`
    (default: the default scheme of the model).  Never raises for a bad model;
    DeclarationError if `model` is no declaration.
    """
    found = _problems(require_declaration(model, "check"), scheme, strict)
    return found if strict else [p for p in found if p.severity == "error"]


def _problems(model: PHDAE, scheme: Scheme | None, strict: bool) -> list[Problem]:
    found: list[Problem] = []
    stepped, contacts = model, model.switches
    if model.switches:
        if found := _safely(switches, model):
            return found
        try:
            modes = Modes(model)
            stepped, model = modes.declared(modes.start), modes.whole
        except DeclarationError as e:
            return [*e.problems]
    for rule in (names, units, nominals, starts):
        found += _safely(rule, model)
    if shared := _safely(shared_symbols, model):
        return found + shared
    entries = Entries(model)
    found += _safely(normal_form, entries)
    found += entries.problems
    try:
        sample = Sample(entries)
    except Exception as e:  # a declaration is data from outside: whatever is wrong with it becomes a problem
        return [*found, _internal("sampling", model, e)] if not BLOCKING & {p.rule for p in found} else found
    for rule in (
        ranges,
        finite,
        skew_symmetry,
        symmetry,
        passivity,
        friction,
        masses,
        costates,
        energies,
        continuous,
        closed_pairs,
    ):
        found += _safely(rule, entries, sample)
    for rule in (unused, velocities, state_events):
        found += _safely(rule, entries)
    if not BLOCKING & {p.rule for p in found}:
        found += _safely(equations, stepped, scheme)
        found += _safely(closing, stepped, contacts)
    if strict and all(p.severity == "warning" for p in found):
        for rule in WARNING_RULES:
            found += _safely(rule, entries, sample)
        found += _safely(moving, model)
    return found


def _safely(rule: Callable[..., list[Problem] | None], *args) -> list[Problem]:
    """The problems a rule finds; an error inside the rule becomes one more problem."""
    try:
        return rule(*args) or []
    except Exception as e:
        model = args[0] if isinstance(args[0], PHDAE) else args[0].model
        return [_internal(rule.__name__.replace("_", " "), model, e)]


def _internal(what: str, model: PHDAE, error: Exception) -> Problem:
    text = f"the check of {what} stopped with {type(error).__name__}: {error}"
    return Problem("internal", model.name, text, "look for an entry of the wrong type")
