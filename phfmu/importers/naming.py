"""Variables of a declaration for the coordinates of a linear system: names, units, starts and nominal values."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import casadi as ca
import numpy as np
import scipy.sparse as sp
from numpy.typing import NDArray

from phfmu.declare.error import DeclarationError
from phfmu.declare.observable import Observable, observable
from phfmu.declare.port import Domain, Port
from phfmu.declare.variable import Variable, VariableKind, algebraic, make_variable, state
from phfmu.importers.coordinates import Coordinates
from phfmu.importers.definite import Sparse, csc
from phfmu.importers.given import DescriptorSystem, symbolic

Array = NDArray[np.float64]

#: numbers whose products are powers in watt, where a domain is not known
PLAIN = Domain("plain", "u", "1", "y", "W", "effort")


@dataclass(frozen=True)
class NamedVariables:
    """Differential and algebraic variables, and the given states as observables where they are neither."""

    states: tuple[Variable, ...]
    algebraics: tuple[Variable, ...] = ()
    observables: tuple[Observable, ...] = ()


def named_states(name: str, states: Sequence[Variable] | None, n: int) -> tuple[Variable, ...]:
    """The n given states; DeclarationError if the variables are not as many."""
    found = (state("x", n),) if states is None else tuple(states)
    for v in found:
        if not isinstance(v, Variable) or v.kind is not VariableKind.STATE:
            raise DeclarationError(f"{name}: states", f"one of them is {v!r}", "make them with state(..)", "type")
    if sum(v.n for v in found) != n:
        sizes = " + ".join(f"{v.name}: {v.n}" for v in found)
        reason = f"they have {sum(v.n for v in found)} entries ({sizes}), J has {n} rows"
        raise DeclarationError(f"{name}: states", reason, "give a variable, or an entry of one, for each row", "shape")
    return found


def named_ports(name: str, ports: Sequence[Port] | None, m: int) -> tuple[Port, ...]:
    """Ports for m inputs, in the order of the columns of G; DeclarationError if they are not as many."""
    if ports is None:
        return (Port("port", PLAIN, "effort", {}, size=m if m > 1 else None),) if m else ()
    found = tuple(ports)
    for p in found:
        if not isinstance(p, Port) or p.on:
            remedy = "make them with Port(name, domain, given, {}, size=..); G and P say what they act on"
            raise DeclarationError(f"{name}: ports", f"one of them is {getattr(p, 'name', p)!r}", remedy, "type")
    if sum(p.n for p in found) != m:
        sizes = " + ".join(f"{p.name}: {p.n}" for p in found)
        reason = f"they have {sum(p.n for p in found)} inputs ({sizes}), G has {m} columns"
        raise DeclarationError(f"{name}: ports", reason, "give an input for each column", "shape")
    return found


def scalar_names(variables: Sequence[Variable | Port]) -> list[str]:
    return [n for v in variables for n in v.names()]


def entries(variables: Sequence[Variable]) -> list[Variable]:
    """Scalar views of all entries."""
    return [v if v.size is None else v.part(i, 1) for v in variables for i in range(v.n)]


def named(
    given: DescriptorSystem, c: Coordinates, x: tuple[Variable, ...], label: str, reported: bool
) -> NamedVariables:
    """Variables for the coordinates: `x` itself where it is one of them, else vectors `label` and `algebraic`."""
    n = c.V1.shape[0]
    if not c.n2 and _is_identity(c.V1, n):
        return NamedVariables(x)
    if label == "differential" and _selects(given, c):
        return _selected(x, set(c.V2.tocoo().row.tolist()), reported)
    start, nominal = (np.array([s for v in x for s in getattr(v, what)]) for what in ("start", "nominal"))
    E1 = c.E1.toarray()
    to_x1 = np.linalg.solve(E1, (c.U1.T @ given.E).toarray()) if c.n1 else np.zeros((0, n))
    to_z2 = (c.U2.T @ given.Q).toarray()
    text = f"of {', '.join(v.name for v in x)}"
    states = _vector(state, label, to_x1, start, nominal, f"coordinates {text}")
    rest = _vector(algebraic, "algebraic", to_z2, start, nominal, f"costates {text} in the kernel of E^T")
    return NamedVariables(states, rest, _reports(given, c, x, (*states, *rest)) if reported else ())


def _vector(make, name: str, rows: Array, start: Array, nominal: Array, text: str) -> tuple[Variable, ...]:  # noqa: ANN001
    k = len(rows)
    if not k:
        return ()
    size = np.max(np.abs(rows) * nominal, axis=1, initial=0.0)
    return (
        make(name, k if k > 1 else None, start=rows @ start, nominal=np.where(size > 0, size, 1.0), description=text),
    )


def _reports(
    given: DescriptorSystem, c: Coordinates, x: tuple[Variable, ...], new: tuple[Variable, ...]
) -> tuple[Observable, ...]:
    M = csc(sp.hstack(c.states(given.Q)))
    value = ca.mtimes(symbolic(M), ca.vertcat(*(v.sx for v in new)))
    parts = ca.vertsplit(value, np.cumsum([0, *(v.n for v in x)]).tolist())
    return tuple(
        observable(v.name, part, unit=v.unit, description=v.description) for v, part in zip(x, parts, strict=True)
    )


def _is_identity(matrix: Sparse, n: int) -> bool:
    return matrix.shape == (n, n) and abs(matrix - sp.eye(n)).nnz == 0


def _selects(given: DescriptorSystem, c: Coordinates) -> bool:
    """Every coordinate is one of the given states: x1 = x[differential], z2 = x[algebraic]."""
    same = all(a.shape == b.shape and abs(a - b).nnz == 0 for a, b in ((c.U1, c.V1), (c.U2, c.V2)))
    ones = all(m.nnz == m.shape[1] and (m.data == 1.0).all() for m in (c.V1, c.V2))
    return same and ones and _is_identity(c.U2.T @ given.Q @ c.V2, c.n2) and (c.U2.T @ given.Q @ c.V1).nnz == 0


def _selected(x: tuple[Variable, ...], inner: set[int], reported: bool) -> NamedVariables:
    """The given states, those in `inner` as algebraic variables; a vector that has both is split."""
    states, rest, reports, at = [], [], [], 0
    for v in x:
        A = [i for i in range(v.n) if at + i in inner]
        D = [i for i in range(v.n) if at + i not in inner]
        at += v.n
        if not A:
            states.append(v)
            continue
        if not D:
            rest.append(_part(v, VariableKind.ALGEBRAIC, v.name, v.size, A))
            continue
        states.append(_part(v, VariableKind.STATE, f"{v.name}.differential", len(D) if len(D) > 1 else None, D))
        rest.append(_part(v, VariableKind.ALGEBRAIC, f"{v.name}.algebraic", len(A) if len(A) > 1 else None, A))
        if reported:
            value = ca.SX(v.n, 1)
            value[D], value[A] = states[-1].sx, rest[-1].sx
            reports.append(observable(v.name, value, unit=v.unit, description=v.description))
    return NamedVariables(tuple(states), tuple(rest), tuple(reports))


def _part(v: Variable, kind: VariableKind, name: str, size: int | None, which: list[int]) -> Variable:
    start, nominal = ([values[i] for i in which] for values in (v.start, v.nominal))
    return make_variable(kind, name, size, v.unit, start, nominal, v.description)
