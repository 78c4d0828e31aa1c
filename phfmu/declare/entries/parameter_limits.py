"""Limits of parameters: declared, or derived where the declaration proves them.

A parameter is at least 0 if a diagonal entry of W (the summed blocks of R) or a curvature d2H/dx2 of a quadratic energy
has its sign, whatever the states and the other parameters, as long as those are positive: a resistance R, a conductance
1/R, a mass, a stiffness, an inductance in flux^2/(2 L).  It is above 0 if the entry, or a diagonal entry of E, has no
finite inverse or value at 0.  A negative value would make the component active, or its energy unbounded below.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from dataclasses import dataclass, replace

import casadi as ca
import numpy as np
from numpy.typing import NDArray

from phfmu.declare.energy import EnergyKind
from phfmu.declare.entries.entries import Entries, normal_form
from phfmu.declare.entries.entry_kind import EntryKind
from phfmu.declare.phdae import PHDAE
from phfmu.declare.variable import ValueKind, Variable

Array = NDArray[np.float64]

#: magnitudes at which the sign of an entry is compared with that of its parameter
MAGNITUDES = (1e-3, 1.0, 1e3)
#: how many sets of states and other parameters
DRAWS = 3


@dataclass(frozen=True)
class ParameterLimit:
    """min <= value <= max; `above`: min itself is not allowed.

    `because`: what proves a derived limit;  `waived`: a declaration may do without it, with `min=-inf`
    """

    min: float = -np.inf
    max: float = np.inf
    above: bool = False
    because: str = ""
    waived: bool = False

    def allows(self, value: float) -> bool:
        return (self.min < value if self.above else self.min <= value) and value <= self.max

    def __str__(self) -> str:
        low = "" if self.min == -np.inf else f"above {self.min:g}" if self.above else f"at least {self.min:g}"
        return " and ".join(t for t in (low, "" if self.max == np.inf else f"at most {self.max:g}") if t)


@dataclass(frozen=True)
class _Sign:
    """An expression whose sign a parameter may have, and what it is; `mass`: it must not be 0."""

    expr: ca.SX
    what: str
    mass: bool = False
    energy: bool = False


def limits(model: PHDAE) -> dict[str, ParameterLimit]:
    """Scalar name of a parameter -> its limit; parameters without one are left out."""
    if not model.parameters:
        return {}
    entries = Entries(model)
    normal_form(entries)
    return limits_of(entries)


def limits_of(entries: Entries) -> dict[str, ParameterLimit]:
    """The same from the sound entries of a model."""
    return _limits(entries.model, _derived(entries))


def declared_limits(model: PHDAE) -> dict[str, ParameterLimit]:
    """Those that are declared; the derived ones hold wherever a parameter is positive."""
    return _limits(model, {})


def _limits(model: PHDAE, proven: Mapping[str, ParameterLimit]) -> dict[str, ParameterLimit]:
    found = {}
    for v in model.parameters:
        for j, name in enumerate(v.names()):
            limit = _declared(v, j, proven.get(name, ParameterLimit()))
            if limit.min > -np.inf or limit.max < np.inf:
                found[name] = limit
    return found


def _declared(v: Variable, j: int, proven: ParameterLimit) -> ParameterLimit:
    """The declared limit of entry j; what is not declared is `proven`."""
    low, high = None if v.min is None else v.min[j], np.inf if v.max is None else v.max[j]
    if v.positive:
        return ParameterLimit(max(low or 0.0, 0.0), high, above=low is None or low <= 0.0)
    if low is None:
        return replace(proven, max=high)
    return ParameterLimit(low, high, proven.above and low == 0.0)


def _derived(entries: Entries) -> dict[str, ParameterLimit]:
    """Scalar name -> the limit the declaration proves."""
    p = ca.vertcat(*(v.sx for v in entries.model.parameters))
    names = [n for v in entries.model.parameters for n in v.names()]
    signs = [s for s in (*_damping(entries), *_curvature(entries)) if ca.depends_on(s.expr, p)]
    if not signs:
        return {}
    masses = [s for s in _masses(entries) if ca.depends_on(s.expr, p)]
    rows = [*signs, *masses]
    depends = _pattern(ca.vertcat(*(s.expr for s in rows)), p)
    values = _Trials(ca.vertcat(*(s.expr for s in rows)), p)
    found: dict[str, ParameterLimit] = {}
    for colour in _colours(depends):
        up, down, zero = (values.at(colour, sign) for sign in (1.0, -1.0, 0.0))
        for j in colour:
            mine = np.flatnonzero(depends[:, j])
            proofs = [i for i in mine[mine < len(signs)] if (up[i] > 0).all() and (down[i] < 0).all()]
            if not proofs:
                continue
            singular = [i for i in mine if not np.isfinite(zero[i]).all() or (rows[i].mass and (zero[i] == 0).any())]
            first = signs[proofs[0]]
            found[names[j]] = ParameterLimit(0.0, above=bool(singular), because=first.what, waived=first.energy)
    return found


def _pattern(expr: ca.SX, p: ca.SX) -> NDArray[np.bool_]:
    """The rows of `expr` that depend on each entry of `p`."""
    dense = np.zeros((expr.numel(), p.numel()), bool)
    row, col = ca.jacobian_sparsity(expr, p).get_triplet()
    dense[row, col] = True
    return dense


def _colours(depends: NDArray[np.bool_]) -> list[list[int]]:
    """Groups of parameters of which no row has two: they are varied together."""
    groups: list[tuple[list[int], NDArray[np.bool_]]] = []
    for j in range(depends.shape[1]):
        for members, rows in groups:
            if not (rows & depends[:, j]).any():
                members.append(j)
                rows |= depends[:, j]
                break
        else:
            groups.append(([j], depends[:, j].copy()))
    return [members for members, _ in groups]


class _Trials:
    """Rows at several magnitudes of some parameters and random positive values of the others."""

    def __init__(self, rows: ca.SX, p: ca.SX):
        known = {p[j].element_hash() for j in range(p.numel())}
        others = ca.vertcat(*(s for s in ca.symvar(rows) if s.element_hash() not in known))
        count = DRAWS * len(MAGNITUDES)
        rng = np.random.default_rng(3)
        self._others = rng.uniform(-1.0, 1.0, (others.numel(), count))
        self._p = np.exp(rng.uniform(-1.0, 1.0, (p.numel(), count)))
        self._magnitude = np.tile(MAGNITUDES, DRAWS)
        self._f = ca.Function("rows", [others, p], [ca.densify(rows)]).map(count)

    def at(self, varied: list[int], sign: float) -> Array:
        """Rows x trials with the parameters `varied` at the magnitudes times `sign`."""
        p = self._p.copy()
        p[varied] = sign * self._magnitude
        return np.asarray(self._f(self._others, p).full())


def _damping(entries: Entries) -> Iterator[_Sign]:
    """Diagonal of W, the sum of all blocks of R."""
    rows: dict[int, ca.SX] = {}
    names: dict[int, str] = {}
    for e in entries.of(EntryKind.R):
        for i, (name, s) in enumerate(zip(e.names(), (s for v in e.rows for s in ca.vertsplit(v.sx)), strict=True)):
            rows[s.element_hash()] = rows.get(s.element_hash(), ca.SX(0)) + e.expr[i, i]
            names[s.element_hash()] = name
    for at, expr in rows.items():
        yield _Sign(expr, f"R on '{names[at]}'")


def _curvature(entries: Entries) -> Iterator[_Sign]:
    """d2H/dx2 of states that occur in quadratic terms only."""
    quadratic = [e.expr for e in entries.of(EntryKind.H) if e.origin.kind is EnergyKind.QUADRATIC]
    if not quadratic:
        return
    general = ca.vertcat(
        ca.SX(0, 1), *(e.expr for e in entries.of(EntryKind.H) if e.origin.kind is not EnergyKind.QUADRATIC)
    )
    elsewhere = {s.element_hash() for s in ca.symvar(general)}
    total = ca.sum1(ca.vertcat(*quadratic))
    x = [s for s in ca.symvar(total) if entries.known[s.element_hash()].kind is ValueKind.STATE]
    diagonal = ca.diag(ca.hessian(total, ca.vertcat(*x))[0])
    for j, s in enumerate(x):
        if s.element_hash() not in elsewhere and not diagonal[j].is_zero():
            yield _Sign(diagonal[j], f"energy along '{entries.known[s.element_hash()].name}'", energy=True)


def _masses(entries: Entries) -> Iterator[_Sign]:
    """Diagonal of E; points without mass are left to the constraints."""
    if entries.of(EntryKind.CONSTRAINT):
        return
    for e in entries.of(EntryKind.E):
        for j, name in enumerate(e.names()):
            yield _Sign(e.expr[j, j], f"E of '{name}'", mass=True)
