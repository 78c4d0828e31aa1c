"""Extraction of the masses: rows of E other than identity, and closed-form pairs, which bring their own."""

from __future__ import annotations

import casadi as ca
import numpy as np

from phfmu.declare.entries.coefficients import square, stacked
from phfmu.declare.error import DeclarationError
from phfmu.declare.phdae import PHDAE
from phfmu.declare.transform.regular import undetermined
from phfmu.declare.variable import ValueKind, VariableKind
from phfmu.terms.canonical import Locator, make_term, scalars
from phfmu.terms.located import Row, RowAt
from phfmu.terms.term import CLOSED, MASS, MASS_BLOCK, Terms


def masses(model: PHDAE, out: Terms, locator: Locator) -> dict[int, ca.SX]:
    """Terms of the rows of E other than identity; returns the diagonal entries, state index -> expression."""
    diagonal: dict[int, ca.SX] = {}
    for key, value in model.E.items():
        variables = stacked(key)
        label = f"E of {', '.join(repr(v.name) for v in variables)}"
        if any(v.kind is not VariableKind.STATE for v in variables):
            raise DeclarationError(
                label,
                "E acts on states; an algebraic variable has zero rows of E",
                "leave it out of E, or make it a state",
                "symbol",
            )
        where = [at.index for v in variables for at in locator.of(v)]
        x, z = ca.vertcat(*(v.sx for v in variables)), ca.vertcat(*(v.z for v in variables))
        n = x.numel()
        matrix = square(value, n)
        if matrix.shape != (n, n):
            raise DeclarationError(
                label,
                f"is {matrix.shape[0]} x {matrix.shape[1]}, expected {n} x {n}",
                "make it as large as its variables",
                "shape",
            )
        constant = all(locator.find(s, label).kind is ValueKind.PARAMETER for s in ca.symvar(matrix))
        if constant and matrix.sparsity().is_diag():
            for i, m, s in zip(where, scalars(matrix), ca.vertsplit(x), strict=True):
                diagonal[i] = m
                out.terms.append(make_term(MASS, {"m": m}, locator, label, rows=[RowAt(Row.BALANCE, i)], extra=[s]))
        else:
            if constant:
                _require_regular(label, model, matrix)
            exprs = {"E": matrix, "z": z}
            out.terms.append(
                make_term(MASS_BLOCK, exprs, locator, label, rows=[RowAt(Row.BALANCE, i) for i in where],
                          extra=[*ca.vertsplit(x), *ca.vertsplit(z)])
            )  # fmt: skip
    return diagonal


def _require_regular(label: str, model: PHDAE, matrix: ca.SX) -> None:
    p = ca.vertcat(ca.SX(0, 1), *(q.sx for q in model.parameters))
    value = ca.Function("E", [p], [ca.densify(matrix)])([s for q in model.parameters for s in q.start])
    if undetermined(np.array(value)) >= 0:
        raise DeclarationError(
            f"{model.name}: {label}",
            "is singular, so z and the rates do not follow from it",
            "give z of its variables and use reduce_descriptor(model)",
            "descriptor",
        )


def closed_pairs(model: PHDAE, out: Terms, locator: Locator) -> None:
    """A term for each closed-form pair."""
    for pair in model.closed:
        x = ca.vertcat(*(v.sx for v in pair.variables))
        d = ca.SX.sym("d", x.numel())
        where = [at.index for v in pair.variables for at in locator.of(v)]
        exprs = {"H": pair.hamiltonian, "E": pair.E, "z": pair.z}
        if pair.ebar is not None and pair.zbar is not None:
            exprs |= {"ebar": pair.ebar(x, d), "zbar": pair.zbar(x, d)}
        out.terms.append(
            make_term(CLOSED, exprs, locator.also(d, ValueKind.INCREMENT, where), "closed-form pair",
                      rows=[RowAt(Row.BALANCE, i) for i in where], owner=out.member(pair.owner),
                      extra=[*ca.vertsplit(x), *ca.vertsplit(d)])
        )  # fmt: skip
