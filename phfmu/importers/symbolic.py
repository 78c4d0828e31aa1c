"""Port-Hamiltonian systems given by expressions of SymPy."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import replace
from typing import Any

import casadi as ca

from phfmu.declare.block import block
from phfmu.declare.energy import energy
from phfmu.declare.error import DeclarationError
from phfmu.declare.phdae import PHDAE
from phfmu.declare.port import Port
from phfmu.declare.variable import Variable, VariableKind, algebraic, parameter, state
from phfmu.importers.naming import PLAIN, entries, scalar_names
from phfmu.importers.sympy_expressions import Converter


def from_sympy(
    H: Any,
    states: Sequence[Any],
    J: Any,
    R: Any = None,
    B: Any = None,
    *,
    E: Any = None,
    inputs: Sequence[Any] = (),
    parameters: Mapping[Any, float] | Sequence[Variable] = (),
    name: str = "model",
    show: Callable[[str], object] | None = None,
    description: str = "",
) -> PHDAE:
    """The declaration of E(x) x' = (J(x) - R(x)) z(x) + B(x) u, y = B(x)^T z(x), E^T z = grad H, given in SymPy.

    Symbols are found by their names.

    H:          energy, J
    states:     n in total: symbols, names, or variables made with `state` (units, starts, nominal values; the entries of a
                vector `q` are the symbols `q[1]`, `q[2]`, ..).  One that E does not act on, in a row or column, and H does
                not depend on is an algebraic variable, which is its own effort
    J, R, E:    n x n, R = None is no dissipation, E = None the identity;  B: n x m
    inputs:     m in total: symbols or names (one port of plain numbers each, `tau.u` and `tau.y`), or ports made with
                `Port(name, domain, given, {})`
    parameters: symbol or name -> value, or variables made with `parameter`
    show:       takes a line for every entry as it was converted, e.g. `print`

    DeclarationError names unknown symbols and functions with their entry, and shapes that do not fit.  Whether J is skew
    and R semidefinite is what `phfmu.check` says.
    """
    x = tuple(v if isinstance(v, Variable) else state(str(v)) for v in states)
    p = as_parameters(parameters)
    ports = as_ports(inputs)
    n, m = sum(v.n for v in x), sum(q.n for q in ports)
    x, E = _split(name, x, H, E, n)
    symbols = {s: v.sx[i] for v in (*x, *p) for i, s in enumerate(v.names())}
    convert = Converter(name, symbols)
    matrix = _converted(name, convert, {"J": (J, (n, n)), "R": (R, (n, n)), "E": (E, (n, n)), "B": (B, (n, m))})
    if m and B is None:
        raise DeclarationError(f"{name}: B", f"is missing, there are {m} inputs", "give B, n x m", "shape")
    hamiltonian = convert.expression("H", H)
    if show is not None:
        show(f"H = {hamiltonian}")
        show_matrices(show, matrix, scalar_names(x), scalar_names(ports))
    inner = [i for i, v in enumerate(entries(x)) if v.kind is VariableKind.STATE]
    held = tuple(entries(x)[i] for i in inner)
    E1 = matrix["E"][inner, inner] if "E" in matrix else None
    return PHDAE(
        name,
        states=tuple(v for v in x if v.kind is VariableKind.STATE),
        algebraics=tuple(v for v in x if v.kind is VariableKind.ALGEBRAIC),
        parameters=p,
        energies=(energy(hamiltonian),),
        E={} if E1 is None else {held: E1},
        structure=(block(x, matrix["J"]),),
        dissipation=(block(x, matrix["R"]),) if "R" in matrix else (),
        ports=acting(ports, x, matrix.get("B")),
        description=description,
    )


def _converted(name: str, convert: Converter, given: Mapping[str, tuple[Any, tuple[int, int]]]) -> dict[str, Any]:
    """Those of the matrices that are there, of the shapes that they should have."""
    there = {k: shaped(name, k, value, shape) for k, (value, shape) in given.items() if value is not None}
    return {k: convert.matrix(k, value) for k, value in there.items()}


def as_parameters(given: Mapping[Any, float] | Sequence[Variable]) -> tuple[Variable, ...]:
    """Parameters of a mapping of values, or as they are."""
    if isinstance(given, Mapping):
        return tuple(parameter(str(s), float(value)) for s, value in given.items())
    return tuple(given)


def as_ports(inputs: Sequence[Any]) -> tuple[Port, ...]:
    """Ports as they are, and one of plain numbers for each symbol or name."""
    return tuple(q if isinstance(q, Port) else Port(str(q), PLAIN, "effort", {}) for q in inputs)


def shaped(model: str, what: str, value: Any, shape: tuple[int, int]) -> Any:
    """The matrix; DeclarationError if it is not of that shape."""
    found = getattr(value, "shape", None)
    if found != shape:
        said = "no matrix" if found is None else f"{found[0]} x {found[1]}" if len(found) == 2 else str(found)
        raise DeclarationError(
            f"{model}: {what}", f"is {said}, expected {shape[0]} x {shape[1]}",
            "give a Matrix of SymPy: `states` gives its rows, `inputs` the columns of B", "shape",
        )  # fmt: skip
    return value


def _split(name: str, x: tuple[Variable, ...], H: Any, E: Any, n: int) -> tuple[tuple[Variable, ...], Any]:
    """The variables, with those E does not act on as algebraic ones."""
    if E is None:
        return x, E
    shaped(name, "E", E, (n, n))
    used, found, at = {str(s) for s in H.free_symbols}, [], 0
    for v in x:
        rows = range(at, at + v.n)
        at += v.n
        idle = all(E[i, j] == 0 and E[j, i] == 0 for i in rows for j in range(n)) and used.isdisjoint(v.names())
        found.append(
            algebraic(v.name, v.size, unit=v.unit, start=v.start, nominal=v.nominal, description=v.description)
            if idle else v
        )  # fmt: skip
    return tuple(found), E


def acting(ports: tuple[Port, ...], x: tuple[Variable, ...], B: ca.SX | None) -> tuple[Port, ...]:
    """The ports, on the variables x by their columns of B."""
    made, column = [], 0
    for port in ports:
        on, row = {}, 0
        for v in x:
            part = ca.sparsify(B[row : row + v.n, column : column + port.n]) if B is not None else ca.SX(v.n, port.n)
            row += v.n
            if part.nnz():
                on[v] = part
        made.append(replace(port, on=on))
        column += port.n
    return tuple(made)


def show_matrices(
    show: Callable[[str], object], matrix: Mapping[str, ca.SX], rows: Sequence[str], inputs: Sequence[str]
) -> None:
    """A line for each entry of matrices that act on `rows`, of B on `inputs`."""
    for what, m in matrix.items():
        columns = inputs if what == "B" else rows
        for r, c in zip(*m.sparsity().get_triplet(), strict=True):
            show(f"{what}[{rows[r]}, {columns[c]}] = {m[r, c]}")
