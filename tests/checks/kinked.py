"""Energies with kinks, and how they are run."""

from __future__ import annotations

from collections.abc import Callable
from functools import cache

import casadi as ca
import numpy as np

from phfmu import (
    PHDAE,
    Collocated,
    NativeInstance,
    PythonInstance,
    build_model,
    energy,
    skew,
    state,
)
from phfmu.declare.energy import Energy

#: energies of the position beside q^2/2, and the same for numbers
STOPS: dict[str, tuple[Callable[[ca.SX], ca.SX], Callable[[float], float]]] = {
    "stop": (lambda q: 20 * ca.fmax(q - 1, 0), lambda q: 20 * max(q - 1, 0.0)),
    "contact": (lambda q: 50 * ca.fmax(q - 1, 0) ** 2, lambda q: 50 * max(q - 1, 0.0) ** 2),
    "Hertz": (lambda q: 100 * ca.fmax(q - 1, 0) ** 2.5, lambda q: 100 * max(q - 1, 0.0) ** 2.5),
    "wedge": (lambda q: 3 * ca.fabs(q - 0.7), lambda q: 3 * abs(q - 0.7)),
    "if_else": (lambda q: ca.if_else(q > 1, ca.sin(5 * q - 5), 0), lambda q: np.sin(5 * q - 5) if q > 1 else 0.0),
    "two sides": (lambda q: 8 * ca.fmax(q - 1, ca.fmax(-0.5 - q, 0)), lambda q: 8 * max(q - 1, -0.5 - q, 0.0)),
    "table": (lambda q: ca.pw_lin(q, [-3, -1, 0, 2, 3], [4, 1, 0, 3, 7]), lambda q: float(_table(q))),
}
SCHEMES = {f"order {2 * k}": Collocated(k) for k in (1, 2, 3)}


def _table(q: float) -> float:
    return np.interp(q, [-3, -1, 0, 2, 3], [4, 1, 0, 3, 7])


def oscillator(*potentials: Callable[[ca.SX], ca.SX | Energy]) -> PHDAE:
    """H = p^2/2 + q^2/2 + V(q),  q' = p,  p' = -q - V'."""
    q, p = state("q", start=2.0), state("p")
    more = [e if isinstance(e, Energy) else energy(e) for e in (of(q.sx) for of in potentials)]
    return PHDAE(
        "stop", states=(q, p), energies=(energy(p.sx**2 / 2 + q.sx**2 / 2), *more), structure=(skew(q, p, 1.0),)
    )


@cache
def instance(name: str, scheme: str, native: bool = False):
    return (NativeInstance if native else PythonInstance)(build_model(oscillator(STOPS[name][0]), SCHEMES[scheme]))


def run(unit, x: tuple[float, float], h: float, n: int) -> tuple[np.ndarray, np.ndarray]:
    """States and stored energies of n steps."""
    unit.reset()
    unit.set_x(0.0, np.array(x))
    unit.initialise()
    states, stored = [unit.x], []
    for i in range(n):
        unit.do_step(i * h, h)
        states.append(unit.x)
        stored.append(unit.ledger()["stored"].sum())
    return np.array(states), np.array(stored)


def energies(name: str, states: np.ndarray) -> np.ndarray:
    """H of every state, worked out without CasADi."""
    return np.array([(q * q + p * p) / 2 + STOPS[name][1](q) for q, p in states])


#: operations an energy has no use for: structure of vectors, calls, printing; atan2 has a cut where it jumps by 2 pi
LEFT_OUT = "PARAMETER CALL FIND LOW MAP MTIMES SOLVE TRANSPOSE DETERMINANT INVERSE DOT BILIN RANK1 HORZCAT VERTCAT DIAGCAT " \
    "HORZSPLIT VERTSPLIT DIAGSPLIT RESHAPE SUBREF SUBASSIGN GETNONZEROS GETNONZEROS_PARAM ADDNONZEROS ADDNONZEROS_PARAM " \
    "SETNONZEROS SETNONZEROS_PARAM PROJECT ASSERTION MONITOR NORM2 NORM1 NORMINF NORMF MMIN MMAX HORZREPMAT HORZREPSUM " \
    "PRINTME LIFT EINSTEIN BSPLINE CONVEXIFY SPARSITY_CAST LOGSUMEXP DUMP KRON KRON_CONTRACT ASSIGN INPUT OUTPUT CONST " \
    "ERFINV ATAN2"  # fmt: skip
#: arguments moved into the domain of an operation
DOMAIN = {
    "LOG": lambda a: a**2 + 0.5, "SQRT": lambda a: a**2 + 0.5, "INV": lambda a: a**2 + 0.5, "LOG1P": lambda a: a**2,
    "ASIN": lambda a: ca.sin(a) * 0.9, "ACOS": lambda a: ca.sin(a) * 0.9, "ATANH": lambda a: ca.sin(a) * 0.9,
    "ACOSH": lambda a: a**2 + 1.5, "TAN": lambda a: ca.sin(a), "EXP": lambda a: ca.sin(a), "EXPM1": lambda a: ca.sin(a),
    "SINH": lambda a: ca.sin(a), "COSH": lambda a: ca.sin(a),
}  # fmt: skip
OPERATIONS = sorted(n[3:] for n in dir(ca) if n.startswith("OP_") and n[3:] not in LEFT_OUT.split())
TWO = {"ADD", "SUB", "MUL", "DIV", "POW", "CONSTPOW", "LT", "LE", "EQ", "NE", "AND", "OR", "FMOD", "COPYSIGN",
       "IF_ELSE_ZERO", "FMIN", "FMAX", "HYPOT", "REMAINDER"}  # fmt: skip


def applied(name: str, a: ca.SX, b: ca.SX) -> ca.SX:
    op = getattr(ca, "OP_" + name)
    if name == "CONSTPOW":
        return ca.SX.binary(op, a**2 + 0.2, ca.SX(1.7))
    if name in ("POW", "DIV"):
        return ca.SX.binary(op, a**2 + 0.5, ca.sin(b) + 2)
    if name in ("FMOD", "REMAINDER"):
        return ca.SX.binary(op, a, ca.SX(0.7))
    if name in TWO:
        return ca.SX.binary(op, a, b)
    return ca.SX.unary(op, DOMAIN.get(name, lambda v: v)(a))
