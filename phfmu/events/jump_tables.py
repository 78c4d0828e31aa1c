"""Jumps of state events as one kernel: L, c by component, S and e of all of them at a state.

    x+ = x- + L m,   c = on^T z = L^T grad H,   L = E^-1 on,   S = L^T H'' L.

H must be quadratic along L and L must not change along its shifts; then c+ = c- + S m, m = -S^-1 (1 + e) c-, and the jump costs

    lost = -1/2 m^T (c- + c+) = (1 - e^2)/2 c-^T S^-1 c-   (common e).
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import casadi as ca
import numpy as np

from phfmu.declare.dense import coefficient
from phfmu.declare.error import DeclarationError
from phfmu.declare.event import Jump, StateEvent
from phfmu.declare.value import Value
from phfmu.declare.variable import _sx
from phfmu.plan.address import Address, row
from phfmu.plan.plan import Floats, Group, Ints
from phfmu.plan.spec import Spec, build
from phfmu.terms.bare import depends
from phfmu.terms.canonical import Locator, make_term, member
from phfmu.terms.located import Row, RowAt
from phfmu.terms.port_impulses import constrained, masses
from phfmu.terms.term import CLOSED, MASS_BLOCK, TermKind, Terms

JUMP = TermKind("jump")


@dataclass(frozen=True, eq=False)
class JumpTables:
    """The n jumps of a model.

    of:      event -> its jump, -1 for none;  moved (m): states that jump;  component (c): those whose energy they change
    owner (n): component that a jump's loss is booked at;  most (n): largest |c|
    group:   one kernel of x and p with the results [c by component (c n) | L by column (m n) | S (n n) | e (n)]
    """

    of: Ints
    moved: Ints
    component: Ints
    owner: Ints
    most: Floats
    group: Group

    @property
    def n(self) -> int:
        return len(self.owner)

    @property
    def size(self) -> int:
        """Length of the results."""
        return self.n * (len(self.component) + len(self.moved) + self.n + 1)


def jump_tables(terms: Terms, events: Sequence[StateEvent]) -> JumpTables | None:
    """The jumps of the events, None if there are none.  DeclarationError names what does not fit."""
    found = [(e.guard.name, e.jump) for e in events if e.jump is not None]
    if not found:
        return None
    locator, x = Locator(terms.model, terms.pairs), terms.model.x
    full = ca.horzcat(*(_column(terms, locator, name, jump) for name, jump in found)) / ca.repmat(
        masses(terms), 1, len(found)
    )
    full = ca.sparsify(full)
    moved = sorted(set(full.sparsity().get_triplet()[0]))
    L, psi = full[moved, :], x[moved]
    energies = _energies(terms)
    component = [c for c, h in enumerate(energies) if ca.depends_on(h, psi)]
    c = ca.vertcat(*(ca.mtimes(L.T, ca.gradient(energies[i], psi)).T for i in component))
    S = ca.mtimes([L.T, ca.hessian(sum(energies, ca.SX(0)), psi)[0], L])
    _require_fit(terms, [name for name, _ in found], full, S, psi)
    e = ca.vertcat(*(ca.SX(_sx(jump.restitution)) for _, jump in found))
    results = ca.vertcat(ca.vec(c.T), ca.vec(L), ca.vec(S), e)
    term = make_term(
        JUMP, {"f": ca.densify(results)}, locator, "the jumps of state events", rows=[RowAt(Row.OBSERVABLE, 0)]
    )
    if extra := sorted(k.value for k in term.index.keys() - {Value.STATE, Value.PARAMETER}):
        reason = f"columns or restitution depend on values of the kinds {', '.join(extra)}"
        raise DeclarationError(
            f"{terms.model.name}: jump '{found[0][0]}'",
            reason,
            "jumps may depend on states and parameters only",
            "symbol",
        )
    f = term.data["f"]
    out = [(Address(row, j), 0, f[j]) for j in range(f.numel())]
    kernel = build(Spec(1, term.symbols(Value.STATE), term.symbols(Value.PARAMETER), [], out, report=True))
    tables = [term.indices(Value.STATE), (), term.indices(Value.PARAMETER), range(f.numel())]
    arrays = [np.array(list(t), np.int32).reshape(1, -1) for t in tables]
    group = Group(kernel, 1, 1, *arrays, power=np.zeros(f.numel(), np.int8), owner=np.zeros(1, np.int32))
    numbers = iter(range(len(found)))
    return JumpTables(
        np.array([-1 if e.jump is None else next(numbers) for e in events], np.int32),
        np.array(moved, np.int32),
        np.array(component, np.int32),
        np.array([member(terms.members, jump.owner) for _, jump in found], np.int32),
        np.array([jump.most for _, jump in found], float),
        group,
    )


def _column(terms: Terms, locator: Locator, name: str, jump: Jump) -> ca.SX:
    out = ca.SX(terms.n1, 1)
    for v, value in jump.on.items():
        column = coefficient(value, v.n, 1)
        if v.role != "state" or column.shape != (v.n, 1):
            raise DeclarationError(
                f"{terms.model.name}: jump '{name}'", f"acts on {v.role} '{v.name}' with {column.shape[0]} x {column.shape[1]}",
                f"give states and a column for each, here {v.n} x 1", "shape",
            )  # fmt: skip
        for j, at in enumerate(locator.of(v)):
            if column[j].nnz() and not column[j].is_zero():
                out[at.index] = column[j]
    return out


def _energies(terms: Terms) -> list[ca.SX]:
    """H of every component."""
    model = terms.model
    out = [ca.SX(0) for _ in terms.members]
    for e in model.energies:
        out[member(terms.members, e.owner)] += e.expr
    for pair in model.closed:
        out[member(terms.members, pair.owner)] += pair.hamiltonian
    return out


def _require_fit(terms: Terms, names: list[str], L: ca.SX, S: ca.SX, psi: ca.SX) -> None:
    """DeclarationError where an impulse along L is not what the equations of this file say."""
    odd, bound = {r.index for t in terms.of(MASS_BLOCK, CLOSED) for r in t.rows}, constrained(terms)
    for j, name in enumerate(names):
        where = L[:, j].sparsity().get_triplet()[0]
        found = [(terms.state_names[i], i) for i in where]
        reason = _unfit(found, L[:, j], S, j, psi, odd, bound)
        if reason:
            raise DeclarationError(f"{terms.model.name}: jump '{name}'", *reason)


def _unfit(
    where: list[tuple[str, int]], column: ca.SX, S: ca.SX, j: int, psi: ca.SX, odd: set[int], bound: dict[int, str]
) -> tuple[str, str, str] | None:
    """Reason, remedy and rule of what is wrong with jump j."""
    if not where:
        return "moves no state", "give `on` the states that an impulse acts on", "shape"
    for state, i in where:
        if i in odd:
            return (
                f"acts on {state}, whose E is no constant diagonal",
                "use coordinates with a diagonal E",
                "descriptor",
            )
        if i in bound:
            what = f"would break the hidden constraint of {bound[i]} by moving {state}"
            return what, "let it act on states that no constraint ties together", "constraint"
    if depends(column, psi):
        return "has a column that changes as it moves states", "let columns depend on other states", "symbol"
    if S[j, j].is_zero():
        return "moves states that store no energy", "let it act on momenta, fluxes or charges", "energy"
    if depends(S[:, j], psi):
        what = "moves states in which the energy is not quadratic, so its loss has no closed form"
        return what, "let it act on states in which H is quadratic", "energy"
    return None
