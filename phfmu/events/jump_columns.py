"""Jumps and the hidden constraints that they meet, as expressions.

    x+ = x- + L [m, s],   L = E^-1 [on, A],   c = [on, A]^T z = L^T grad H,   S = L^T H'' L,

m: impulses of the jumps, s: of constraints A^T z = 0.  A constraint is part of it where S couples it with a jump, and where a
mode is in its coefficients.  H must be quadratic along L, and L must not change along its shifts.

Velocities y without mass take no impulse: with the rows B_y of [on, A] in them, and w their change,

    [ S  B_y^T ] [m, s]   [ c+ - c- ]        S = B_x^T M_x^-1 B_x + g B_y^T B_y,      L = [ M_x^-1 B_x   0 ]
    [ B_y  0   ] [  w ] = [    0    ],       c = B_x^T v_x + B_y^T v_y,                    [      0       1 ]

for any g > 0: it makes S definite, and B_y [m, s] = 0.  They are columns of their own behind the constraints, with S_jj = 0.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import casadi as ca

from phfmu.declare.entries.coefficients import coefficient
from phfmu.declare.error import DeclarationError
from phfmu.declare.event import Jump, StateEvent
from phfmu.declare.variable import VariableKind, _sx
from phfmu.terms.bare import depends
from phfmu.terms.canonical import Locator, components
from phfmu.terms.extraction.extract_energy import component_energies
from phfmu.terms.held import HeldConstraints, held, massless, rates, typical_mass
from phfmu.terms.term import CLOSED, MASS_BLOCK, Terms

#: states of a block of E whose inverse is written out
BLOCK = 8


@dataclass(frozen=True, eq=False)
class JumpColumns:
    """N columns: those of the n jumps, of ports where they are asked for, and of the constraints that are `held`.

    The last of those that are `held` may be velocities without mass.
    moved: states that L (moved x N) moves;  components: those whose energy they change;  c (components x N);  S (N x N);  e (n)
    """

    held: tuple[str, ...]
    moved: list[int]
    components: list[int]
    L: ca.SX
    c: ca.SX
    S: ca.SX
    e: ca.SX


def jump_columns(
    terms: Terms, events: Sequence[StateEvent], ports: Sequence[tuple[str, ca.SX]] = ()
) -> JumpColumns | None:
    """The columns of the events' jumps, and of `ports` (name, n1 x 1), None if there are none.

    DeclarationError names what does not fit.
    """
    found = [(e.guard.name, e.jump) for e in events if e.jump is not None]
    locator, model = Locator(terms.model, terms.pairs), terms.model
    own = ca.horzcat(
        ca.SX(terms.n1, 0), *(_column(terms, locator, name, jump) for name, jump in found), *(b for _, b in ports)
    )
    met = _met(terms, own, held(terms))
    if not own.shape[1] and not met.names:
        return None
    names = [f"jump '{name}'" for name, _ in found] + [f"the impulse at {name}" for name, _ in ports]
    names += [f"the constraint of {name} at state events" for name in met.names]
    both = ca.sparsify(ca.horzcat(own, met.A))
    _require_rates(terms, names, both)
    light = [i for i in massless(terms) if both[i, :].nnz()]
    heavy = ca.SX(both)
    heavy[light, :] = 0
    full = ca.sparsify(rates(terms, ca.sparsify(heavy)))
    moved = sorted(set(full.sparsity().get_triplet()[0]))
    L, psi = full[moved, :], model.x[moved]
    energies = component_energies(terms)
    inside = [i for i, h in enumerate(energies) if ca.depends_on(h, psi)]
    c = ca.vertcat(ca.SX(0, L.shape[1]), *(ca.mtimes(L.T, ca.gradient(energies[i], psi)).T for i in inside))
    S = ca.mtimes([L.T, ca.hessian(sum(energies, ca.SX(0)), psi)[0], L])
    S += ca.mtimes(both[light, :].T, both[light, :]) / typical_mass(terms)
    for j, name in enumerate(names):
        reason = _bent(L[:, j], S, j, psi)
        if reason:
            raise DeclarationError(f"{model.name}: {name}", *reason)
    _require_still(terms, names[own.shape[1] :], met)
    _require_other_modes(terms, events)
    e = ca.vertcat(ca.SX(0, 1), *(ca.SX(_sx(jump.restitution)) for _, jump in found))
    made = JumpColumns(met.names, moved, inside, L, c, S, e)
    return _with_massless(terms, made, light, both[light, :]) if light else made


def _with_massless(terms: Terms, made: JumpColumns, light: list[int], B: ca.SX) -> JumpColumns:
    """The columns with those of the velocities `light` behind them; B: rows of the others in these."""
    n, one = len(light), ca.SX.eye(len(light))
    c = ca.SX(made.c)
    c[0, :] += ca.mtimes(terms.model.x[light].T, B)  # its work is that of B_y [m, s] = 0
    names = tuple(f"the velocity {terms.state_names[i]} without mass" for i in light)
    return JumpColumns(
        (*made.held, *names),
        [*made.moved, *light],
        made.components,
        ca.diagcat(made.L, one),
        ca.horzcat(c, ca.SX(c.shape[0], n)),
        ca.blockcat([[made.S, B.T], [B, ca.SX(n, n)]]),
        made.e,
    )


def _met(terms: Terms, own: ca.SX, all_held: HeldConstraints) -> HeldConstraints:
    """The constraints that meet the jumps, through the energies and each other, or that modes change."""
    n, names = own.shape[1], all_held.names
    if not names:
        return all_held
    x = terms.model.x
    both = ca.sparsify(ca.horzcat(own, all_held.A))
    reach = ca.DM(both.sparsity(), 1)
    for t in terms.of(MASS_BLOCK, CLOSED):
        where = [r.index for r in t.rows]
        reach[where, :] = ca.repmat(ca.sum1(reach[where, :]), len(where), 1)
    reach = ca.sparsify(reach)
    coupled = ca.DM(ca.hessian(terms.model.hamiltonian, x)[0].sparsity(), 1)
    pattern = ca.SX(ca.sparsify(ca.mtimes([reach.T, coupled, reach])) + ca.DM.eye(n + len(names)))
    modes = {m for m in terms.model.modes}
    symbols = [
        s for v in terms.model.parameters for k, s in zip(v.names(), ca.vertsplit(v.sx), strict=True) if k in modes
    ]
    switched = {n + i for i in range(len(names)) if symbols and ca.depends_on(all_held.A[:, i], ca.vertcat(*symbols))}
    chosen = [part for part in components(pattern) if part[0] < n or switched & set(part)]
    return all_held.chosen(sorted(i - n for part in chosen for i in part if i >= n))


def _column(terms: Terms, locator: Locator, name: str, jump: Jump) -> ca.SX:
    out = ca.SX(terms.n1, 1)
    for v, value in jump.on.items():
        column = coefficient(value, v.n, 1)
        if v.kind is not VariableKind.STATE or column.shape != (v.n, 1):
            raise DeclarationError(
                f"{terms.model.name}: jump '{name}'", f"acts on {v.kind} '{v.name}' with {column.shape[0]} x {column.shape[1]}",
                f"give states and a column for each, here {v.n} x 1", "shape",
            )  # fmt: skip
        for j, at in enumerate(locator.of(v)):
            if column[j].nnz() and not column[j].is_zero():
                out[at.index] = column[j]
    return out


def _require_rates(terms: Terms, names: Sequence[str], A: ca.SX) -> None:
    """Raise DeclarationError if E^-1 A has no closed form, or a column is empty."""
    large = [t for t in terms.of(MASS_BLOCK) if len(t.rows) > BLOCK]
    odd = {r.index for t in (*large, *terms.of(CLOSED)) for r in t.rows}
    for j, name in enumerate(names):
        where = ca.sparsify(A[:, j]).sparsity().get_triplet()[0]
        if not where:
            reason = "moves no state", "give `on` the states that an impulse acts on", "shape"
            raise DeclarationError(f"{terms.model.name}: {name}", *reason)
        if bad := [terms.state_names[i] for i in where if i in odd]:
            what = (
                f"acts on {bad[0]}, whose E has no inverse in closed form (more than {BLOCK} states, or a closed pair)"
            )
            raise DeclarationError(
                f"{terms.model.name}: {name}", what, "use coordinates with a diagonal E", "descriptor"
            )


def _bent(column: ca.SX, S: ca.SX, j: int, psi: ca.SX) -> tuple[str, str, str] | None:
    """Reason, remedy and rule of an expression without closed form along column j; None if all have one."""
    if depends(column, psi):
        return "has a column that changes as it moves states", "let columns depend on other states", "symbol"
    if S[j, j].is_zero():
        return "moves states that store no energy", "let it act on momenta, fluxes or charges", "energy"
    if depends(S[:, j], psi):
        what = "moves states in which the energy is not quadratic, so its loss has no closed form"
        return what, "let it act on states in which H is quadratic", "energy"
    return None


def _require_still(terms: Terms, names: Sequence[str], met: HeldConstraints) -> None:
    """Raise DeclarationError for constraints that something besides the states moves: their impulse would do work there."""
    for j, name in enumerate(names):
        if not ca.simplify(met.c0[j]).is_zero():
            reason = "moves with time, so that its impulse would do work on what moves it"
            remedy = "let jumps act on states that only constraints at rest tie together"
            raise DeclarationError(f"{terms.model.name}: {name}", reason, remedy, "constraint")


def _require_other_modes(terms: Terms, events: Sequence[StateEvent]) -> None:
    """Raise DeclarationError for jumps that contain a parameter that their own event sets: they happen with its new value."""
    symbols = {n: s for v in terms.model.parameters for n, s in zip(v.names(), ca.vertsplit(v.sx), strict=True)}
    for e in events:
        if e.jump is None:
            continue
        used = ca.vertcat(*(ca.vec(ca.SX(_sx(m))) for m in e.jump.on.values()), ca.SX(_sx(e.jump.restitution)))
        for name in sorted(e.changed & symbols.keys()):
            if ca.depends_on(used, symbols[name]):
                raise DeclarationError(
                    f"{terms.model.name}: jump '{e.guard.name}'", f"depends on '{name}', which its event sets",
                    "write it without: a jump happens with the new values", "symbol",
                )  # fmt: skip
