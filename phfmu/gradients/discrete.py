"""Discrete gradients by name: of one energy term at the nodes of a step, and on their own between two points.

A discrete gradient of H is continuous in (x, x') with

    W(x, x')^T (x' - x) = H(x') - H(x)   (directionality),      W(x, x) = grad H(x)   (consistency),

and the rows of a discrete Jacobian of F are discrete gradients of its components.
Source: O. Gonzalez, J. Nonlinear Sci. 6 (1996); Kinon, Morandin, Schulze (Appl. Numer. Math. 2026), Definitions 4-6.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field
from typing import Any

import casadi as ca
import numpy as np
from numpy.typing import ArrayLike

from phfmu.declare.energy import Energy, EnergyKind, energy, resolve_kind
from phfmu.declare.expressions.summands import summands
from phfmu.declare.variable import Variable
from phfmu.gradients import coordinate, gradients
from phfmu.gradients.gradient_names import GRADIENTS
from phfmu.gradients.gradients import Gradient
from phfmu.gradients.quadrature import Nodes, nodes


@dataclass(frozen=True)
class Summand:
    """One energy term: H(x), its kind; for the strain form C(x), phi(s) and s; the metric that weights a correction."""

    kind: EnergyKind
    h: ca.SX
    x: ca.SX
    strain: tuple[ca.SX, ca.SX, ca.SX] | None = None
    metric: np.ndarray | None = None


def node_gradients(method: str, term: Summand, d: ca.SX, nd: Nodes) -> Gradient:
    """W (n x k) and dH of one term with increments d (n x k); `method` of GRADIENTS, or "nodal" (no balance)."""
    h, x = term.h, term.x
    if method == "joint-gonzalez":
        return gradients.joint_gonzalez(h, x, d, nd)
    if method.startswith("itoh-abe"):
        return coordinate.itoh_abe(h, x, d, symmetric=method.endswith("symmetric"))
    if term.kind is EnergyKind.QUADRATIC:
        return gradients.quadratic(h, ca.gradient(h, x), x, d, nd)
    if method == "nodal":
        return gradients.nodal(h, x, d, nd)
    if method == "per-term" and term.strain is not None:
        return gradients.strain(*term.strain, x, d, nd)
    metric = term.metric if method == "per-term" and term.metric is not None else np.ones(x.numel())
    return gradients.general(h, x, d, nd, metric)


@dataclass(frozen=True)
class TwoPoint:
    """A discrete gradient or Jacobian as a function of two points.

    `dg(x, x1)` or `dg(x, x1, p)` with the values of the parameters; x, x1 (n), p as declared, numbers or `SX`.
    Returns (n) for a gradient, (m, n) for a Jacobian: an array, or an expression if an argument is one.
    """

    function: ca.Function = field(repr=False)
    vector: bool

    def __call__(self, x: Any, x1: Any, p: Any = ()) -> Any:
        arguments = [x, x1, p]
        if any(isinstance(a, ca.SX) for a in arguments):
            return self.function(*arguments)
        values = np.array(self.function(*(_column(self.function, i, a) for i, a in enumerate(arguments))))
        return values.ravel() if self.vector else values


def _column(function: ca.Function, i: int, values: ArrayLike) -> np.ndarray:
    array = np.asarray(values, float).ravel()
    if array.size != function.numel_in(i):
        raise ValueError(f"{('x', 'x1', 'p')[i]} has {array.size} entries, expected {function.numel_in(i)}")
    return array


def discrete_gradient(
    H: Any,
    x: Variable | ca.SX | Sequence[Variable],
    method: str = "per-term",
    *,
    parameters: Variable | ca.SX | Sequence[Variable] = (),
) -> TwoPoint:
    """A discrete gradient of H as a function of both points: W(x, x')^T (x' - x) = H(x') - H(x), W(x, x) = grad H(x).

    H: expression, `Energy`, or a sequence of them (a sum of terms);  x: states, as variables or one symbol (n x 1).
    method:
        "joint-gonzalez"      grad H(m) + [H(x') - H(x) - grad H(m)^T d] d / |d|^2,   m = x + d/2,  d = x' - x; symmetric
        "per-term"            of each term its own: midpoint (quadratic), secant (`strain_energy`, keeps momentum maps),
                              else mean value by quadrature with a correction; symmetric
        "mean-value"          int_0^1 grad H(x + s d) ds for terms of every kind; symmetric
        "itoh-abe", "itoh-abe-symmetric"    coordinate increments in the order of x; the mean of both orders
    ValueError for an unknown method and for symbols that are neither in x nor in `parameters`.
    """
    states, p = _symbols(x), _symbols(parameters)
    d = ca.SX.sym("d", states.numel())
    terms = [t if isinstance(t, Energy) else energy(t) for t in (H if isinstance(H, (list, tuple)) else [H])]
    if method == "joint-gonzalez":
        terms = [energy(sum((t.expr for t in terms), ca.SX(0)))]
    else:
        entries = {states[i].element_hash() for i in range(states.numel())}
        terms = [part for t in terms for part in summands(resolve_kind(t, entries), entries)]
    total = sum((_gradient(method, t, states, d, _nominals(x)) for t in terms), ca.SX.zeros(states.numel(), 1))
    return _two_point(ca.densify(total), states, d, p, vector=True)


def discrete_jacobian(
    F: Any,
    x: Variable | ca.SX | Sequence[Variable],
    method: str = "mean-value",
    *,
    parameters: Variable | ca.SX | Sequence[Variable] = (),
) -> TwoPoint:
    """A discrete Jacobian of F (m x 1): DF(x, x') (x' - x) = F(x') - F(x), DF(x, x) = DF(x); rows by `discrete_gradient`.

    For quadratic F all methods but the coordinate increments give DF at the midpoint, the choice of the constraints.
    """
    expr, states, p = ca.SX(getattr(F, "sx", F)), _symbols(x), _symbols(parameters)
    d = ca.SX.sym("d", states.numel())
    rows = [_gradient(method, energy(expr[i]), states, d, _nominals(x)).T for i in range(expr.numel())]
    return _two_point(ca.densify(ca.vertcat(*rows)), states, d, p, vector=False)


def _gradient(method: str, term: Energy, x: ca.SX, d: ca.SX, nominal: np.ndarray) -> ca.SX:
    if method not in GRADIENTS:
        raise ValueError(f"discrete gradient '{method}' unknown; there are: {', '.join(GRADIENTS)}")
    entries = [x[i].element_hash() for i in range(x.numel())]
    term = resolve_kind(term, set(entries))
    strain = None
    if term.invariant is not None and term.phi is not None:
        s = ca.SX.sym("s")
        strain = (term.invariant, term.phi(s), s)
    chosen = {v.sx[j].element_hash() for v in term.correct for j in range(v.n)} or set(entries)
    metric = np.array([h in chosen for h in entries]) / nominal**2
    return node_gradients(method, Summand(term.kind, term.expr, x, strain, metric), d, nodes(1))[0]


def _two_point(value: ca.SX, x: ca.SX, d: ca.SX, p: ca.SX, *, vector: bool) -> TwoPoint:
    known = {s.element_hash() for s in (*ca.symvar(x), *ca.symvar(p), *ca.symvar(d))}
    free = [str(s) for s in ca.symvar(value) if s.element_hash() not in known]
    if free:
        raise ValueError(f"the expression depends on {', '.join(free)}; list it in x or in parameters")
    x1 = ca.SX.sym("x1", x.numel())
    (expr,) = ca.substitute([value], [d], [x1 - x])
    return TwoPoint(ca.Function("dg", [x, x1, p], [expr], ["x", "x1", "p"], ["dg"]), vector)


def _parts(given: Variable | ca.SX | Sequence[Variable]) -> list[Variable | ca.SX]:
    return [given] if isinstance(given, (Variable, ca.SX)) else list(given)


def _symbols(given: Variable | ca.SX | Sequence[Variable]) -> ca.SX:
    return ca.vertcat(ca.SX(0, 1), *(v.sx if isinstance(v, Variable) else v for v in _parts(given)))


def _nominals(x: Variable | ca.SX | Sequence[Variable]) -> np.ndarray:
    return np.concatenate([v.nominal if isinstance(v, Variable) else np.ones(v.numel()) for v in _parts(x)])
