"""An energy of a length, phi(C(x)) with C = |A x + a|^2: recognised, so that it is discretised as `strain_energy` is."""

from __future__ import annotations

from collections.abc import Set as AbstractSet
from dataclasses import dataclass, replace

import casadi as ca
import numpy as np

from phfmu.declare.energy import Energy, EnergyKind
from phfmu.declare.operations import Instruction, degree_of, function_of, instructions, operation


def as_strain(term: Energy, states: AbstractSet[int]) -> Energy:
    """`term` as a strain term where it is a function of one squared length of states (given by their element hashes).

    The length has two components at least: a square of one coordinate has no rotation to be kept.  A term whose
    correction is to go to states that were chosen stays as it is.
    """
    if term.kind is not EnergyKind.GENERAL or term.correct:
        return term
    x = ca.vertcat(*(s for s in ca.symvar(term.expr) if s.element_hash() in states))
    found = _Walk(x).of(term.expr) if x.numel() > 1 else None
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
class _Value:
    """A value of a walk: degree 0, 1 or 2 in x, or None for a function of the symbol that stands for C."""

    expr: ca.SX
    degree: int | None


class _Walk:
    """Through the operations of a function: everything that is not quadratic in x depends on one quadratic value C."""

    def __init__(self, x: ca.SX):
        self.x, self.s = x, ca.SX.sym("s")
        self.invariant: ca.SX | None = None

    def of(self, expr: ca.SX) -> tuple[ca.SX, ca.SX, ca.SX] | None:
        """C, s and phi(s); None if `expr` is of another form."""
        f, rest = function_of(ca.cse(expr), self.x)
        held: dict[int, _Value] = {}
        result = None
        for n in instructions(f):
            if n.op == ca.OP_OUTPUT:
                result = held[n.inputs[0]]
            elif n.op == ca.OP_INPUT:
                own = n.inputs[0] == 0
                held[n.outputs[0]] = _Value((self.x if own else rest)[n.inputs[1]], int(own))
            elif n.op == ca.OP_CONST:
                held[n.outputs[0]] = _Value(ca.SX(n.value), 0)
            else:
                value = self._result(n, [held[i] for i in n.inputs])
                if value is None:
                    return None
                held[n.outputs[0]] = value
        if result is None or result.degree is not None or self.invariant is None:
            return None
        return self.invariant, self.s, result.expr

    def _result(self, n: Instruction, given: list[_Value]) -> _Value | None:
        if all(v.degree is not None for v in given):
            found = degree_of(n, [float(v.degree or 0) for v in given], [_number(v.expr) for v in given])
            if found <= 2:
                return _Value(operation(n.op, [v.expr for v in given]), int(found))
        exprs = [self._through(v) for v in given]
        known = [e for e in exprs if e is not None]
        return _Value(operation(n.op, known), None) if len(known) == len(exprs) else None

    def _through(self, v: _Value) -> ca.SX | None:
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
