"""Extraction of the energies: terms with their costates E^-T grad H.

H of every component of a model.
"""

from __future__ import annotations

import casadi as ca

from phfmu.declare.energy import Energy, EnergyKind
from phfmu.declare.error import DeclarationError
from phfmu.declare.expressions.operations import degree, piecewise
from phfmu.declare.expressions.summands import summands
from phfmu.declare.phdae import PHDAE
from phfmu.declare.variable import ValueKind
from phfmu.terms.canonical import Locator, alike, make_term, scalars
from phfmu.terms.located import Row, RowAt
from phfmu.terms.term import ENERGY, JOINT, EnergyForm, Term, Terms


def energies(model: PHDAE, out: Terms, locator: Locator, mass: dict[int, ca.SX], joint: bool) -> None:
    """One term per summand of H, or one per member if `joint`; `mass`: diagonal entries of E by state."""
    known = {s.element_hash() for v in model.states for s in scalars(v.sx)}
    parts = [part for whole in model.energies for part in summands(whole, known)]
    if joint:
        for owner in dict.fromkeys(e.owner for e in model.energies):
            _joint(out, locator, mass, [e for e in parts if e.owner == owner])
        return
    for e in parts:
        states = _states_of(e.expr, locator)
        if not states:  # a constant moves nothing
            continue
        owner = out.member(e.owner)
        if e.kind is not EnergyKind.QUADRATIC:
            _require_kind(model, e, states)
            out.terms.append(_bent(e, out, locator, mass, states, owner))
            continue

        def quadratic(e: Energy = e, states: list[tuple[ca.SX, int]] = states, owner: int = owner) -> list[Term]:
            _require_kind(model, e, states)
            exprs = {"H": e.expr, "scale": _scale(states, mass), "z": _costates(e.expr, states, mass)}
            return [make_term(ENERGY, exprs, locator, "energy", rows=_balances(states), extra=[s for s, _ in states], owner=owner,
                              form=EnergyForm(e.kind))]  # fmt: skip

        weighted = tuple(i in mass for _, i in states)
        given = [e.expr, *(mass[i] for _, i in states if i in mass)]
        out.terms += alike(given, _balances(states), locator, "energy", quadratic, owner, weighted)


def _scale(states: list[tuple[ca.SX, int]], mass: dict[int, ca.SX]) -> ca.SX:
    """1 / m of each state."""
    return ca.vertcat(*(1 / mass.get(i, ca.SX(1)) for _, i in states))


def _bent(
    e: Energy, out: Terms, locator: Locator, mass: dict[int, ca.SX], states: list[tuple[ca.SX, int]], owner: int
) -> Term:
    """The term of an energy that is not quadratic: of a strain with its law, or a general one with its metric."""
    exprs = {"H": e.expr, "scale": _scale(states, mass)}
    symbols = [s for s, _ in states]
    if e.kind is EnergyKind.STRAIN:
        c = ca.SX.sym("c")
        assert e.invariant is not None and e.phi is not None
        exprs |= {"C": e.invariant, "phi": e.phi(c)}
        return make_term(ENERGY, exprs, locator.also(c, ValueKind.INVARIANT, [-1]), "energy", rows=_balances(states),
                         owner=owner, extra=[*symbols, c], form=EnergyForm(e.kind))  # fmt: skip
    chosen = {at.index for v in e.correct for at in locator.of(v)} or {i for _, i in states}
    nominal = out.state_nominals
    form = EnergyForm(e.kind, tuple((i in chosen) / nominal[i] ** 2 for _, i in states))
    return make_term(ENERGY, exprs, locator, "energy", rows=_balances(states), owner=owner, extra=symbols, form=form)


def _require_kind(model: PHDAE, e: Energy, states: list[tuple[ca.SX, int]]) -> None:
    """Raise DeclarationError if the operations of a term do not show the constant Hessian (of H, of the invariant) it claims."""
    what, expr = ("H", e.expr) if e.kind is EnergyKind.QUADRATIC else ("the invariant C", e.invariant)
    if e.kind is EnergyKind.GENERAL or expr is None:
        return
    x = ca.vertcat(*(s for s, _ in states))
    if degree(expr, x) not in (0, 1, 2):
        found = ", ".join(piecewise(expr, x))
        raise DeclarationError(
            f"{model.name}: a {e.kind} energy of {', '.join(str(s) for s, _ in states[:4])}",
            f"{what} is not quadratic" + (f" ({found})" if found else ""),
            "use energy(H)",
            "energy",
        )


def _joint(out: Terms, locator: Locator, mass: dict[int, ca.SX], group: list[Energy]) -> None:
    """All energies of a member as one term, whose parts are booked each: their sum may be zero while they move."""
    parts = [e.expr for e in group if _states_of(e.expr, locator)]
    if not parts:
        return
    total = sum(parts, ca.SX(0))
    states = _states_of(total, locator)
    exprs = {
        "H": total,
        "parts": ca.vertcat(*parts),
        "scale": _scale(states, mass),
        "z": _costates(total, states, mass),
    }
    out.terms.append(make_term(JOINT, exprs, locator, "energy",
                               rows=_balances(states), owner=out.member(group[0].owner),
                               extra=[s for s, _ in states]))  # fmt: skip


def _balances(states: list[tuple[ca.SX, int]]) -> list[RowAt]:
    return [RowAt(Row.BALANCE, i) for _, i in states]


def _costates(h: ca.SX, states: list[tuple[ca.SX, int]], mass: dict[int, ca.SX]) -> ca.SX:
    """E^-T grad H on the states of one term."""
    if not states:
        return ca.SX(0, 1)
    grad = ca.densify(ca.gradient(h, ca.vertcat(*(s for s, _ in states))))
    return ca.vertcat(*(divided(grad[j], mass[i]) if i in mass else grad[j] for j, (_, i) in enumerate(states)))


def divided(gradient: ca.SX, m: ca.SX) -> ca.SX:
    """gradient / m, without the division where gradient = m f: a velocity v has the costate v also if its mass is 0."""
    if m.is_symbolic():
        f = ca.gradient(gradient, m)
        if not ca.depends_on(f, m) and ca.substitute(gradient, m, ca.SX(0)).is_zero():
            return f
    return gradient / m


def all_divided(gradients: ca.SX, masses: list[ca.SX]) -> list[ca.SX]:
    """The entries of a column `divided` by their masses; those that are products with a symbol m of their own, all at once."""
    symbols = {m.element_hash(): m for m in masses if m.is_symbolic()}
    if len(symbols) > 1 and all(m.is_symbolic() for m in masses):
        m, place = ca.vertcat(*symbols.values()), {key: j for j, key in enumerate(symbols)}
        f = ca.jtimes(gradients, m, ca.DM.ones(m.numel()))
        row, col = ca.jacobian_sparsity(gradients, m).get_triplet()
        own = all(place[masses[r].element_hash()] == c for r, c in zip(row, col, strict=True))
        left = ca.substitute(gradients, m, ca.SX.zeros(m.numel(), 1))
        if own and not ca.jacobian_sparsity(f, m).nnz() and all(e.is_zero() for e in ca.vertsplit(left)):
            return ca.vertsplit(ca.densify(f))
    return [divided(g, m) for g, m in zip(ca.vertsplit(gradients), masses, strict=True)]


def _states_of(expr: ca.SX, locator: Locator) -> list[tuple[ca.SX, int]]:
    found = []
    for s in ca.symvar(expr):
        at = locator.find(s, "energy")
        if at.kind is ValueKind.STATE:
            found.append((s, at.index))
        elif at.kind is not ValueKind.PARAMETER:
            raise DeclarationError(
                "the energy", f"depends on '{s}'", "H may depend on states and parameters only", "symbol"
            )
    return found


def component_energies(terms: Terms) -> list[ca.SX]:
    """Energies of the members of `terms`, in their order."""
    model = terms.model
    out = [ca.SX(0) for _ in terms.members]
    for e in model.energies:
        out[terms.member(e.owner)] += e.expr
    for pair in model.closed:
        out[terms.member(pair.owner)] += pair.hamiltonian
    return out
