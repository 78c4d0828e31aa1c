"""Linear port-Hamiltonian systems given by matrices."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from typing import Any, Literal

import casadi as ca
import numpy as np
import scipy.sparse as sp

from phfmu.declare.block import Block, block
from phfmu.declare.energy import Energy, energy
from phfmu.declare.phdae import PHDAE
from phfmu.declare.port import Port
from phfmu.declare.variable import Variable
from phfmu.importers.coordinates import Coordinates, semi_explicit, with_energy_states
from phfmu.importers.definite import Sparse, csc, parts
from phfmu.importers.given import DescriptorSystem, port_hamiltonian, read, symbolic
from phfmu.importers.naming import PLAIN as PLAIN
from phfmu.importers.naming import NamedVariables, entries, named, named_ports, named_states, scalar_names
from phfmu.importers.summed import MatrixSummand, pieces

Coordinate = Literal["auto", "given", "energy"]

#: entries in a row, on average over the rows that have some, from which a matrix counts as dense
DENSE_ROW = 12


def matrices(
    J: Any,
    R: Any,
    G: Any = None,
    *,
    E: Any = None,
    Q: Any = None,
    P: Any = None,
    S: Any = None,
    N: Any = None,
    name: str = "linear",
    states: Sequence[Variable] | None = None,
    ports: Sequence[Port] | None = None,
    coordinates: Coordinate = "auto",
    description: str = "",
) -> PHDAE:
    """The declaration of a linear port-Hamiltonian system with n states and m inputs,

        E x' = (J - R) Q x + (G - P) u,     y = (G + P)^T Q x + (S - N) u,     H = 1/2 x^T E^T Q x.

    J, R, E, Q:  n x n, R = None is no dissipation, E and Q default to the identity; either may be singular.
    G, P:        n x m.  S, N:  m x m, feedthrough.  Absent = zero.  NumPy arrays or SciPy sparse matrices.
    states:      variables with n entries in total, made with `state`: names, units, starts, nominal values; default `x`
    ports:       ports with m inputs in total, made with `Port(name, domain, given, {}, size=..)`; default one port of plain
                 numbers, inputs `port.u` and outputs `port.y`, whose products are watt
    coordinates: "given": the model has the given states.  "energy": it has the states `xi` with H = 1/2 |xi|^2 and a
                 diagonal dissipation, which is compact where the matrices are dense; the given states are observables if
                 `states` names them.  "auto": energy coordinates if E, E^T Q or R have more than 12 entries a row.

    A singular E is brought into semi-explicit form: states that E does not act on become algebraic variables of the same
    name; other kernels give the vectors `differential` and `algebraic`.

    DeclarationError lists what is not port-Hamiltonian with the direction that shows it: [R, P; P^T, S] or E^T Q not
    positive semidefinite, J or N not skew, R, S or E^T Q not symmetric; or states that no equation determines.
    Source: Mehrmann, Unger, Acta Numerica 32 (2023), Definition 4.1; Beattie, Mehrmann, Xu, Zwart (2018).
    """
    given = read(name, E=E, J=J, R=R, Q=Q, G=G, P=P, S=S, N=N)
    x = named_states(name, states, given.J.shape[0])
    ports = named_ports(name, ports, given.G.shape[1])
    given = port_hamiltonian(name, given, scalar_names(x), scalar_names(ports))
    c = semi_explicit(name, given, scalar_names(x))
    compact = coordinates == "energy" or (coordinates == "auto" and _dense(given))
    if compact and c.n1:
        c = with_energy_states(given, c)
    kept = named(given, c, x, "xi" if compact else "differential", reported=states is not None)
    return _declared(name, given, c, kept, ports, description)


def _dense(given: DescriptorSystem) -> bool:
    def a_row(m: Sparse) -> float:
        return m.nnz / max(1, np.count_nonzero(np.diff(sp.csr_matrix(m).indptr)))

    return max(a_row(m) for m in (given.E, given.H, given.R)) > DENSE_ROW


def _declared(
    name: str, given: DescriptorSystem, c: Coordinates, kept: NamedVariables, ports: tuple[Port, ...], description: str
) -> PHDAE:
    rows = (*kept.states, *kept.algebraics)
    scalars = entries(rows)
    acting = _acting(c.G, rows, ports)
    structure = [block(rows, symbolic(c.J))] if c.J.nnz else []
    if given.N.nnz:
        structure.append(block(acting, symbolic(given.N)))
    return PHDAE(
        name,
        states=kept.states,
        algebraics=kept.algebraics,
        energies=tuple(_energy(scalars, p) for p in pieces(c.H1)),
        E=_descriptor(scalars, c.E1),
        structure=tuple(structure),
        dissipation=(*(_damping(scalars, p) for p in pieces(c.R)), *_feedthrough(given, c, scalars, acting)),
        ports=acting,
        observables=kept.observables,
        description=description or f"linear port-Hamiltonian system, {c.n1} states, {given.G.shape[1]} inputs",
    )


def _acting(G: Sparse, rows: Sequence[Variable], ports: Sequence[Port]) -> tuple[Port, ...]:
    """The ports with their blocks of G."""
    made, column = [], 0
    for port in ports:
        on, row = {}, 0
        for v in rows:
            part = csc(G[row : row + v.n, column : column + port.n])
            row += v.n
            if part.nnz:
                on[v] = symbolic(part)
        made.append(replace(port, on=on))
        column += port.n
    return tuple(made)


def _energy(scalars: Sequence[Variable], piece: MatrixSummand) -> Energy:
    if piece.sign:  # as a square: it is zero where nothing is stretched
        a, b = (scalars[i].sx for i in piece.where)
        return energy(piece.matrix[0, 0] / 2 * (a + piece.sign * b) ** 2)
    x = ca.vertcat(*(scalars[i].sx for i in piece.where))
    return energy(ca.dot(x, ca.mtimes(symbolic(csc(piece.matrix)), x)) / 2)


def _damping(scalars: Sequence[Variable], piece: MatrixSummand) -> Block:
    return block([scalars[i] for i in piece.where], symbolic(csc(piece.matrix)))


def _feedthrough(
    given: DescriptorSystem, c: Coordinates, scalars: Sequence[Variable], ports: tuple[Port, ...]
) -> list[Block]:
    """The block [0, P; P^T, S] on the states P acts on and all ports."""
    if not c.P.nnz and not given.S.nnz:
        return []
    where = np.flatnonzero(np.diff(sp.csr_matrix(c.P).indptr)).tolist()
    P = c.P[where]
    W = csc(sp.bmat([[None, P], [P.T, given.S]])) if where else given.S
    return [block([*(scalars[i] for i in where), *ports], symbolic(W))]


def _descriptor(scalars: Sequence[Variable], E1: Sparse) -> dict[Variable | tuple[Variable, ...], Any]:
    """E1 by its connected parts; the identity is left out."""
    found: dict[Variable | tuple[Variable, ...], Any] = {}
    for where in parts(E1):
        part = E1[where][:, where].toarray()
        if len(where) == 1 and part[0, 0] != 1.0:
            found[scalars[where[0]]] = part[0, 0]
        elif len(where) > 1:
            found[tuple(scalars[i] for i in where)] = symbolic(csc(part))
    return found
