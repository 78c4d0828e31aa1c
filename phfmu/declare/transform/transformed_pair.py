"""The gradient pair (E~, z~) of a transformed declaration.

E~ = U^T (E o phi) Dphi in the fewest blocks;  z~ = U^-1 (z o phi) where H and E~ do not determine it.
"""

from __future__ import annotations

from typing import Any

import casadi as ca
import numpy as np
from numpy.typing import NDArray

from phfmu.declare.entries.coefficients import square, stacked
from phfmu.declare.error import DeclarationError
from phfmu.declare.transform.change import ZERO, VariableChange, span
from phfmu.declare.transform.inverse import blocks
from phfmu.declare.transform.regular import undetermined
from phfmu.declare.variable import Variable, VariableKind, key

Array = NDArray[Any]
Key = Variable | tuple[Variable, ...]


def costates(change: VariableChange) -> dict[Variable, Any]:
    """Given efforts: those of unchanged variables, and z2~ of new algebraic variables where it is not x2~."""
    out: dict[Variable, Any] = {v: change.at_old(e) for v, e in change.model.z.items() if key(v) not in change.row}
    if not change.algebraics:
        return out
    z2 = ca.mtimes(change.inverse[change.algebraics, :], _old_costates(change, change.inverse[change.algebraics, :]))
    place = {c: i for i, c in enumerate(change.algebraics)}
    for v in change.new:
        if v.kind is VariableKind.ALGEBRAIC:
            expr = z2[[place[c] for c in span(change.column[key(v)])]]
            value, own = change.sampled([expr, v.sx])
            if not np.all(np.abs(value - own) <= ZERO * np.maximum(1.0, np.abs(own))):
                change.given[key(v)] = out[v] = expr
    return out


def _old_costates(change: VariableChange, rows: ca.SX) -> ca.SX:
    """z o phi of the old variables, given or from z~ of the new states; needed where `rows` has entries."""
    z = ca.vertcat(*(v.z if v.kind is VariableKind.STATE else ca.SX(v.n, 1) for v in change.new))
    given = {key(v): e for v, e in change.model.z.items()}
    needed = set(rows.sparsity().get_triplet()[1])
    parts = []
    for v in change.old:
        where = span(change.row[key(v)])
        if v.kind is VariableKind.ALGEBRAIC:
            states = [w for w in change.old if w.kind is VariableKind.STATE]
            olds, news = [], []
            for w in states:
                olds.append(w.z)
                news.append(ca.mtimes(change.U[change.row[key(w)], :], z))
            expr = change.at_old(change.model.effort(v))
            parts.append(ca.substitute([expr], [ca.vertcat(*olds)], [ca.vertcat(*news)])[0] if olds else expr)
        elif key(v) in given:
            parts.append(change.at_old(given[key(v)]))
        else:
            if change.U[where, change.algebraics].nnz() and needed & set(where):
                raise DeclarationError(
                    f"{change.model.name}: z of '{v.name}'",
                    "is needed for the effort of a new algebraic variable",
                    "give "
                    "its z in the declaration, or choose U with zeros between old states and new algebraic variables",
                )
            parts.append(ca.mtimes(change.U[where, :], z))
    return ca.vertcat(*parts)


def descriptor(change: VariableChange) -> dict[Key, Any]:
    """E~ in blocks, without the identity ones; DeclarationError unless algebraic rows and columns vanish."""
    E = ca.diag(ca.vertcat(*(ca.SX.ones(v.n) if v.kind is VariableKind.STATE else ca.SX(v.n, 1) for v in change.old)))
    out: dict[Key, Any] = {}
    for where, value in change.model.E.items():
        rows = [i for v in stacked(where) if key(v) in change.row for i in span(change.row[key(v)])]
        if not rows:
            out[where] = change.at_old(value)
            continue
        E[rows, rows] = square(value, len(rows))
    E = change.at_old(ca.sparsify(E))
    new, value = change.product(change.U.T, E, change.T.jacobian)
    _require_semi_explicit(change, value)
    return out | _grouped([v for v in change.new if v.kind is VariableKind.STATE], change.column, new, value)


def _require_semi_explicit(change: VariableChange, value: Array) -> None:
    names = [n for v in change.new for n in v.names()]
    for i, j in np.argwhere((value != 0).any(axis=0)):
        if i in change.algebraics or j in change.algebraics:
            a, what = (i, "row") if i in change.algebraics else (j, "column")
            raise DeclarationError(
                change.model.name,
                f"the {what} of '{names[a]}' in E~ is not zero, E~[{names[i]}, {names[j]}] = "
                f"{value[0, i, j]:.6g}; an algebraic variable needs a zero row (U) and column (phi of the states must not "
                "depend on it)",
                "make it a state, or change phi or U",
                "descriptor",
            )


def singular_costates(change: VariableChange, E: dict[Key, Any]) -> dict[Variable, Any]:
    """Given z~ of new states whose E~ is singular: H and E~ do not determine it."""
    out: dict[Variable, Any] = {}
    for where, matrix in E.items():
        variables = stacked(where)
        if (
            not any(key(v) in change.column for v in variables)
            or undetermined(change.sampled([ca.SX(matrix)])[0][0]) < 0
        ):
            continue
        given = {key(v) for v in change.model.z}
        missing = [v.name for v in change.old if v.kind is VariableKind.STATE and key(v) not in given]
        if missing:
            raise DeclarationError(
                change.model.name,
                f"E~ of {', '.join(v.name for v in variables)} is singular, so z is needed as data",
                f"give z of {', '.join(missing)}",
                "descriptor",
            )
        old = ca.vertcat(*(change.at_old(_given(change, v)) for v in change.old))
        z = ca.mtimes(change.inverse, old)
        out |= {v: z[change.column[key(v)]] for v in variables}
    return out


def _given(change: VariableChange, v: Variable) -> Any:
    return next((e for w, e in change.model.z.items() if key(w) == key(v)), v.sx)


def _grouped(states: list[Variable], column: dict[int, slice], E: ca.SX, value: Array) -> dict[Key, Any]:
    """Blocks of E on the fewest variables; identity blocks are left out."""
    n = len(states)
    pattern = ca.DM(n, n)
    for i, v in enumerate(states):
        for j, w in enumerate(states):
            if i == j or E[column[key(v)], column[key(w)]].nnz():
                pattern[i, j] = 1
    out: dict[Key, Any] = {}
    for rows, cols in blocks(ca.SX(ca.sparsify(pattern))):
        group = [states[i] for i in sorted({*rows, *cols})]
        where = [i for v in group for i in span(column[key(v)])]
        numbers = value[np.ix_(range(len(value)), where, where)]
        identity = np.abs(numbers - np.eye(len(where))).max(initial=0.0) <= ZERO
        if not identity:
            out[group[0] if len(group) == 1 else tuple(group)] = E[where, where]
    return out
