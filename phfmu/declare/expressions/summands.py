"""An energy that is a sum, taken apart: a term for every set of states, so that equal summands share one kernel.

An energy of a length, phi(C(x)) with C = |A x + a|^2: recognised, so that it is discretised as `strain_energy` is.
"""

from __future__ import annotations

from collections.abc import Iterator
from collections.abc import Set as AbstractSet
from dataclasses import dataclass, replace

import casadi as ca
import numpy as np

from phfmu.declare.energy import Energy, EnergyKind, resolve_kind
from phfmu.declare.expressions.operations import Instruction, degree_of, function_of, instructions, operation


def as_strain(term: Energy, states: AbstractSet[int]) -> Energy:
    """`term` as a strain term where it is a function of one squared length of states (given by their element hashes).

    The length has two components at least: a square of one coordinate has no rotation to be kept.  A term whose
    correction is to go to states that were chosen stays as it is.
    """
    if term.kind is not EnergyKind.GENERAL or term.correct:
        return term
    x = ca.vertcat(*(s for s in ca.symvar(term.expr) if s.element_hash() in states))
    found = _InvariantSearch(x).of(term.expr) if x.numel() > 1 else None
    if found is None or not _is_length(found[0], x):
        return term
    invariant, s, phi = found
    return replace(
        term,
        kind=EnergyKind.STRAIN,
        invariant=invariant,
        phi=lambda c: ca.substitute(phi, s, c),
        expr=ca.substitute(phi, s, invariant),
    )


@dataclass(frozen=True)
class _PolynomialValue:
    """A value of a walk: degree 0, 1 or 2 in x, or None for a function of the symbol that stands for C."""

    expr: ca.SX
    degree: int | None


class _InvariantSearch:
    """Search for C through the operations of a function: all that is not quadratic in x depends on one quadratic C."""

    def __init__(self, x: ca.SX):
        self.x, self.s = x, ca.SX.sym("s")
        self.invariant: ca.SX | None = None

    def of(self, expr: ca.SX) -> tuple[ca.SX, ca.SX, ca.SX] | None:
        """C, s and phi(s); None if `expr` is of another form."""
        f, rest = function_of(ca.cse(expr), self.x)
        held: dict[int, _PolynomialValue] = {}
        result = None
        for n in instructions(f):
            if n.op == ca.OP_OUTPUT:
                result = held[n.inputs[0]]
            elif n.op == ca.OP_INPUT:
                own = n.inputs[0] == 0
                held[n.outputs[0]] = _PolynomialValue((self.x if own else rest)[n.inputs[1]], int(own))
            elif n.op == ca.OP_CONST:
                held[n.outputs[0]] = _PolynomialValue(ca.SX(n.value), 0)
            else:
                value = self._result(n, [held[i] for i in n.inputs])
                if value is None:
                    return None
                held[n.outputs[0]] = value
        if result is None or result.degree is not None or self.invariant is None:
            return None
        return self.invariant, self.s, result.expr

    def _result(self, n: Instruction, given: list[_PolynomialValue]) -> _PolynomialValue | None:
        if all(v.degree is not None for v in given):
            found = degree_of(n, [float(v.degree or 0) for v in given], [_number(v.expr) for v in given])
            if found <= 2:
                return _PolynomialValue(operation(n.op, [v.expr for v in given]), int(found))
        exprs = [self._through(v) for v in given]
        known = [e for e in exprs if e is not None]
        return _PolynomialValue(operation(n.op, known), None) if len(known) == len(exprs) else None

    def _through(self, v: _PolynomialValue) -> ca.SX | None:
        """The value by the symbol; None for one that is not a function of C."""
        if v.degree in (0, None):
            return v.expr
        if v.degree == 2 and self.invariant is None:
            self.invariant = v.expr
        same = self.invariant is not None and v.expr.element_hash() == self.invariant.element_hash()
        return self.s if same else None


def _number(expr: ca.SX) -> float:
    return float(expr) if expr.is_constant() else float("inf")


def _is_length(c: ca.SX, x: ca.SX) -> bool:
    """Whether the Hessian of C is semidefinite and of rank two at least, at parameters chosen at random."""
    hessian = ca.hessian(c, x)[0]
    p = ca.vertcat(ca.SX(0, 1), *ca.symvar(hessian))
    values = np.random.default_rng(4).uniform(0.5, 2.0, p.numel())
    eigenvalues = np.linalg.eigvalsh(np.asarray(ca.Function("h", [p], [ca.densify(hessian)])(values)))
    size = np.abs(eigenvalues).max()
    return bool(eigenvalues[0] >= -1e-12 * size and np.count_nonzero(eigenvalues > 1e-12 * size) >= 2)


def summands(term: Energy, states: AbstractSet[int]) -> list[Energy]:
    """`term` as terms of the summands of H that act on the same states (given by their element hashes).

    Quadratic and strain terms stay whole; so does a term whose correction is to go to states that a summand lacks.
    Constants go with the first term.  Functions of a length are strain terms.
    """
    if term.kind is not EnergyKind.GENERAL:
        return [term]
    groups: dict[frozenset[int], ca.SX] = {}
    constant = ca.SX(0)
    for part in _parts(term.expr, states):
        own = _own(part, states)
        if own:
            groups[own] = groups[own] + part if own in groups else part
        else:
            constant += part
    chosen = {v.sx[j].element_hash() for v in term.correct for j in range(v.n)}
    if len(groups) < 2 or (chosen and any(chosen.isdisjoint(own) for own in groups)):
        return [as_strain(term, states)]
    first, *others = groups.values()
    return [as_strain(resolve_kind(replace(term, expr=e), states), states) for e in (first + constant, *others)]


def _own(expr: ca.SX, states: AbstractSet[int]) -> frozenset[int]:
    return frozenset(s.element_hash() for s in ca.symvar(expr)) & states


def _parts(expr: ca.SX, states: AbstractSet[int]) -> Iterator[ca.SX]:
    """The summands of a scalar expression from left to right, each with its sign and the factors without states before it."""
    stack = [(expr, ca.SX(1))]
    while stack:
        e, factor = stack.pop()
        rest, more = _factored(e, states)
        if rest.is_op(ca.OP_ADD) or rest.is_op(ca.OP_SUB):
            factor = factor * more
            stack.append((rest.dep(1), -factor if rest.is_op(ca.OP_SUB) else factor))
            stack.append((rest.dep(0), factor))
        else:
            yield factor * e


def _factored(expr: ca.SX, states: AbstractSet[int]) -> tuple[ca.SX, ca.SX]:
    """The rest of `expr` without its factors that no state is in, and these factors."""
    factor = ca.SX(1)
    while True:
        if expr.is_op(ca.OP_NEG):
            expr, factor = expr.dep(0), -factor
        elif expr.is_op(ca.OP_TWICE):
            expr, factor = expr.dep(0), 2 * factor
        elif expr.is_op(ca.OP_MUL) and not _own(expr.dep(0), states):
            expr, factor = expr.dep(1), factor * expr.dep(0)
        elif expr.is_op(ca.OP_MUL) and not _own(expr.dep(1), states):
            expr, factor = expr.dep(0), factor * expr.dep(1)
        elif expr.is_op(ca.OP_DIV) and not _own(expr.dep(1), states):
            expr, factor = expr.dep(0), factor / expr.dep(1)
        else:
            return expr, factor
