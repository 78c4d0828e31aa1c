"""Unknowns and equations of an operating point, sparse, without composing the network.

Unknowns are the states and algebraic variables of every member, the common variable of every junction (two numbers
where it is three-phase and balanced), the current of every port that gives no current as an output or is specified,
the signals between members, and the values that the specifications free.  Equations are

    f - w (S x + c) = 0,  r = 0  of each member,   sums at junctions = 0,   outputs = what the junction has,

and the specifications, all at one instant; see `rotation.py`.  Members alike but for their numbers share equations.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from math import pi
from typing import Any

import numpy as np
from numpy.typing import NDArray

from phfmu.declare.phdae import PHDAE
from phfmu.declare.port import Port
from phfmu.network.junction import End, Junction
from phfmu.network.network import Network
from phfmu.operating.rotation import BALANCED, EQUIVARIANT, TURN, MemberEquations, three_phase
from phfmu.operating.specifications import Load, Specification
from phfmu.signals import of_member, ordered_ports
from phfmu.words import meant

Array = NDArray[np.float64]
#: a sparse matrix of SciPy, whose types say less than its functions do
Sparse = Any

#: entries of the Jacobian this small beside their terms are what is left of a cancellation between the phases
CANCELLED = 1e-13


class NoOperatingPoint(ValueError):
    """There is no such point, or it was not found; the message says which member or bus stands out."""


@dataclass
class MemberGroup:
    """Members alike but for their numbers: `rows` and `places`, where each one's equations and z begin."""

    equations: MemberEquations
    members: list[str]
    rows: int = 0
    places: int = 0


class System:
    """Unknowns and equations of the point: F(v) = Q out(P v + constant) + A v + b, and the specifications' rows."""

    def __init__(self, net: Network, specifications: Sequence[Specification], omega: float):
        self.net, self.specifications, self.omega = net, specifications, omega
        self.declared = net.declared
        if net.units:
            raise NoOperatingPoint(f"{net.name}: {', '.join(net.units)} are units, whose equations are not known")
        self.start: list[float] = []
        self.named: list[str] = []  #: of each unknown, for messages; parts of one variable share it
        self._P, self._Q, self._A = Triplets(), Triplets(), Triplets()
        self.b: list[tuple[int, float]] = []
        self.rows = 0
        self.kinds = self._kinds()
        self._require_symmetric()
        self.at_port = {end: (j, port) for j in net.junctions for end, port in j.ports(self.declared).items()}
        self.specified = {self._end(s): s for s in specifications}
        self._place_members()
        self.turns = {j.name: j.shared == "effort" and _three_phase(j, self.declared) for j in net.junctions}
        self.common = {j.name: self._junction(j) for j in net.junctions}
        self.current: dict[End, tuple[int, bool]] = {}
        self.tie: dict[
            End, int
        ] = {}  #: row that sets the output of a port equal to its own current, or to the common variable
        for end, (junction, port) in self.at_port.items():
            self._join(end, junction, port)
        self.names_freed: dict[End, Sequence[str]] = {}
        self.freed = self._free()
        self._wires()
        self.first_specified = self._take_rows(sum(s.count for s in specifications))
        self._require_square()
        n, local = len(self.start), len(self.constant)
        self.P, self.A = self._P.matrix((local, n)), self._A.matrix((self.rows, n))
        self.Q = self._Q.matrix((self.rows, self._outputs))
        self.offset = np.zeros(self.rows)
        for row, value in self.b:
            self.offset[row] += value

    # -- unknowns and equations -----------------------------------------------------------------------------------

    def _kinds(self) -> dict[tuple[Any, ...], MemberGroup]:
        read: dict[str, list[str]] = {}
        for wire in self.net.wires:
            read.setdefault(wire.source, []).append(wire.output)
        found: dict[tuple[Any, ...], MemberGroup] = {}
        for name, model in self.declared.items():
            key = (*_shape(model), *read.get(name, ()))
            if key not in found:
                found[key] = MemberGroup(MemberEquations(model, tuple(read.get(name, ()))), [])
            found[key].members.append(name)
        self.read = read
        return found

    def _require_symmetric(self) -> None:
        for kind in self.kinds.values():
            e = kind.equations
            if e.asymmetry > EQUIVARIANT:
                raise NoOperatingPoint(
                    f"{', '.join(kind.members)}: not symmetric under rotation of the phases (residual {e.asymmetry:.1e} of "
                    "its terms), so that there is no balanced steady state; give all phases the same values"
                )
            for name in kind.members:
                self._require_sources(name, e)

    def _require_sources(self, name: str, e: MemberEquations) -> None:
        """Sources must turn with the frequency of the point; those that are not three-phase must stand."""
        p = np.array([s for v in self.declared[name].parameters for s in v.start])
        for port, k in e.ports:
            if k not in e.sources:
                continue
            value, rate = (np.array(m.full()).ravel() for m in e.sources[k](p))
            wanted = self.omega * TURN @ value if three_phase(port) else np.zeros(port.n)
            size = self.omega * max(np.abs(value).max(), 1e-300)
            if np.abs(rate - wanted).max() > 1e-9 * size:
                raise NoOperatingPoint(
                    f"{name}: its source {port.name} does not turn with {self.omega / 2 / pi:g} Hz in phases a, b, c; "
                    "give its frequency, or take the source out"
                )

    def _new(self, name: str, values: Sequence[float] | Array) -> int:
        at = len(self.start)
        self.start.extend(float(v) for v in values)
        self.named.extend([name] * len(values))
        return at

    def _take_rows(self, n: int) -> int:
        self.rows += n
        return self.rows - n

    def _place_members(self) -> None:
        """z of all members, one kind after the other; unknown are states and algebraic variables, the rest is constant so far."""
        constant: list[float] = []
        self.place: dict[str, int] = {}
        self.output: dict[str, int] = {}
        self.kind_of: dict[str, MemberEquations] = {}
        self.state_at: dict[str, int] = {}
        self.row_of: dict[str, int] = {}
        self.rates: list[tuple[int, int, int]] = []  #: row, unknown and number of the states of each member
        self._outputs = 0
        for kind in self.kinds.values():
            e, n = kind.equations, kind.equations.size
            kind.places, kind.rows = len(constant), self._outputs
            for name in kind.members:
                model = self.declared[name]
                self.kind_of[name], self.place[name], self.output[name] = e, len(constant), self._outputs
                self.state_at[name] = len(self.start)
                for variable in (*model.states, *model.algebraics):
                    at = self._new(of_member(name, variable.name), variable.start)
                    self._P.eye(len(constant), at, variable.n)
                    constant.extend([0.0] * variable.n)
                constant.extend(s for port, _ in e.ports for s in port.input_starts())
                constant.extend(s for v in model.parameters for s in v.start)
                row = self.row_of[name] = self._take_rows(n.x + n.a)
                self.rates.append((row, self.state_at[name], n.x))
                self._Q.eye(row, self._outputs, n.x + n.a)
                self._rotating(name, row, e)
                self._outputs += n.rows
        self.constant = np.array(constant)

    def _rotating(self, name: str, row: int, e: MemberEquations) -> None:
        """- w (S x + c) in the rows of the rates."""
        at = self.state_at[name]
        for i, j in zip(*np.nonzero(e.S), strict=True):
            self._A.put(row + int(i), at + int(j), -self.omega * e.S[i, j])
        self.b += [(row + int(i), -self.omega * float(e.c[i])) for i in np.flatnonzero(e.c)]

    def _basis(self, port: Port) -> Array:
        return BALANCED if three_phase(port) else np.eye(port.n)

    def _junction(self, junction: Junction) -> tuple[int, int]:
        """Unknown and row of a junction: its common variable, and the sum of the other."""
        ports = junction.ports(self.declared)
        port = next((p for p in ports.values() if p.given == junction.shared), next(iter(ports.values())))
        basis = self._basis(port)
        start = basis.T @ np.array(port.input_starts() if port.given == junction.shared else np.zeros(port.n))
        if three_phase(port) and junction.shared == "effort" and not start.any():
            start = np.array([np.sqrt(1.5) * float(np.max(port.nominal)), 0.0])
        return self._new(junction.name, start), self._take_rows(basis.shape[1])

    def _join(self, end: End, junction: Junction, port: Port) -> None:
        """Input and output of a port at a junction, with its own unknown where it gives the common variable or is specified."""
        e = self.kind_of[end.member]
        k = next(k for p, k in e.ports if p.name == port.name)
        basis, n = self._basis(port), e.size
        common, total = self.common[junction.name]
        gives_common = port.given != junction.shared
        u, y = self.place[end.member] + n.x + n.a + k, self.output[end.member] + n.x + n.a + k
        if gives_common or end in self.specified:
            own = self._new(
                str(end), basis.T @ np.array(port.input_starts()) if gives_common else [0.0] * basis.shape[1]
            )
            row = self._take_rows(basis.shape[1])
            self.current[end], self.tie[end] = (own, three_phase(port)), row
            self._A.eye(total, own, basis.shape[1])
            self._A.eye(row, common if gives_common else own, basis.shape[1], -1.0)
        else:
            own, row = common, total
        self._P.block(u, own if gives_common else common, basis)
        self._Q.block(row, y, basis.T)
        self.constant[u : u + port.n] = 0.0

    def _end(self, specification: Specification) -> End:
        member, _, name = specification.port.partition(".")
        end = End(member, name)
        if end not in self.at_port:
            joined = [str(e) for e, (_, p) in self.at_port.items() if three_phase(p)]
            raise KeyError(
                f"no three-phase port '{specification.port}' at a junction; {meant(specification.port, joined)}"
            )
        if not three_phase(self.at_port[end][1]) or self.at_port[end][0].shared != "effort":
            raise NoOperatingPoint(f"{specification.port} is no three-phase port that shares its voltage")
        return end

    def _free(self) -> dict[str, int]:
        """The freed values: each is an unknown in the place of a constant."""
        out: dict[str, int] = {}
        for end, specification in self.specified.items():
            names = self.names_freed[end] = self._names_freed(end, specification)
            for name in names:
                place = self._value(name)
                if name in out:
                    raise NoOperatingPoint(f"{name} is freed twice; each specification needs two values of its own")
                start = self.constant[place]
                out[name] = self._new(name.partition("[")[0], [start])
                self._P.put(place, out[name], 1.0)
                self.constant[place] = 0.0
        return out

    def _names_freed(self, end: End, specification: Specification) -> Sequence[str]:
        if specification.free is not None:
            if len(specification.free) != specification.count:
                what = f"free = {list(specification.free)} for {specification.count} equations"
                raise NoOperatingPoint(f"{specification.port}: {what}; each equation frees one value")
            return specification.free
        model = self.declared[end.member]
        if isinstance(specification, Load):
            names = [v.name for v in model.parameters]
            if set(specification.freed) <= set(names):
                return [of_member(end.member, n) for n in specification.freed]
        joined = {e.port for e in self.at_port if e.member == end.member}
        inputs = [n for p, _ in ordered_ports(model) if p.external and p.name not in joined for n in p.input_names()]
        if len(inputs) == 2:
            return [of_member(end.member, n) for n in inputs]
        there = ", ".join([*inputs, *(n for v in model.parameters for n in v.names())])
        raise NoOperatingPoint(
            f"{specification.port}: say which values are found in exchange for its specification: free=(.., ..) of inputs "
            f"and parameters; {end.member} has {there}"
        )

    def _value(self, name: str) -> int:
        """Place in z of a free input or a parameter."""
        member, _, own = name.partition(".")
        model = self.declared.get(member)
        if model is None:
            raise KeyError(f"no member '{member}' for the free value '{name}'; {meant(member, self.declared)}")
        e, n = self.kind_of[member], self.kind_of[member].size
        names = [m if p.external else "" for p, _ in e.ports for m in p.input_names()]
        names += [m for v in model.parameters for m in v.names()]
        if own not in names:
            raise KeyError(f"{member} has no input or parameter '{own}'; {meant(own, filter(None, names))}")
        return self.place[member] + n.x + n.a + names.index(own)

    def _wires(self) -> None:
        """Signals: the input is an unknown, equal to the output times the factor plus the offset."""
        self.wired: list[tuple[int, int]] = []  #: row and unknown of each signal
        for wire in self.net.wires:
            n = self.kind_of[wire.source].size
            place = self._value(of_member(wire.target, wire.input))
            at = self._new(of_member(wire.target, wire.input), [self.constant[place]])
            row = self._take_rows(1)
            self._P.put(place, at, 1.0)
            self.constant[place] = 0.0
            seen = self.output[wire.source] + n.x + n.a + n.u + self.read[wire.source].index(wire.output)
            self.wired.append((row, at))
            self._A.put(row, at, -1.0)
            self._Q.put(row, seen, wire.factor)
            self.b.append((row, wire.offset))

    def first_junctions(self) -> dict[str, str]:
        """Member -> the junction of its first three-phase port."""
        first: dict[str, str] = {}
        for end, (j, port) in self.at_port.items():
            if three_phase(port):
                first.setdefault(end.member, j.name)
        return first

    def linear(self) -> tuple[list[int], list[int]]:
        """Rows and unknowns of the power flow: members without specifications, voltages, and currents that meet the others.

        Loads keep the parameters that they begin with.
        """
        stand_in = {end: s for end, s in self.specified.items() if not isinstance(s, Load)}
        names = {end.member for end in stand_in}
        kept = [
            name
            for name, e in self.kind_of.items()
            if name not in names and all(three_phase(p) for p, _ in e.ports if p.source is None)
        ]
        rows: list[int] = []
        columns: list[int] = []
        for name in kept:
            n = self.kind_of[name].size.x + self.kind_of[name].size.a
            rows += range(self.row_of[name], self.row_of[name] + n)
            columns += range(self.state_at[name], self.state_at[name] + n)
        for junction, (at, total) in self.common.items():
            if self.turns[junction]:
                rows += (total, total + 1)
                columns += (at, at + 1)
        row = self.first_specified
        for end, specification in self.specified.items():
            if end in stand_in:
                rows += range(row, row + specification.count)
            row += specification.count
        for end, (own, phases) in self.current.items():
            if phases and (end in stand_in or end.member in kept):
                columns += (own, own + 1)
                rows += () if end in stand_in else (self.tie[end], self.tie[end] + 1)
        return rows, columns

    def _require_square(self) -> None:
        if self.rows != len(self.start):
            more = "too few values are freed" if self.rows > len(self.start) else "too many values are freed"
            raise NoOperatingPoint(f"{self.net.name}: {self.rows} equations for {len(self.start)} unknowns: {more}")

    def evaluate(self, v: Array) -> tuple[Array, Sparse]:
        """F and its Jacobian."""
        import scipy.sparse as sp

        z = self.P @ v + self.constant
        out, rows, columns, values = np.zeros(self._outputs), [], [], []
        for kind in self.kinds.values():
            e, m = kind.equations, len(kind.members)
            n = e.size
            found, nonzeros = e.evaluate(z[kind.places : kind.places + m * n.z].reshape(m, n.z))
            out[kind.rows : kind.rows + m * n.rows] = found.ravel()
            shift = np.arange(m)[:, None]
            rows.append((kind.rows + shift * n.rows + e.pattern[0]).ravel())
            columns.append((kind.places + shift * n.z + e.pattern[1]).ravel())
            values.append(nonzeros.ravel())
        J = sp.csr_matrix(
            (np.concatenate(values), (np.concatenate(rows), np.concatenate(columns))), shape=(self._outputs, len(z))
        )
        F = self.Q @ out + self.A @ v + self.offset
        inner = (self.Q @ J @ self.P).tocsr()
        terms = (abs(self.Q) @ abs(J) @ abs(self.P)).tocsr()
        inner.sort_indices()
        terms.sort_indices()
        if inner.nnz == terms.nnz:
            inner.data[np.abs(inner.data) < CANCELLED * terms.data] = 0.0
        more = Triplets()
        row = self.first_specified
        for end, specification in self.specified.items():
            at, own = self.common[self.at_port[end][0].name][0], self.current[end][0]
            free = [self.freed[name] for name in self.names_freed[end]]
            F[row : row + specification.count], by_v, by_i, by_free = specification.residual(
                v[at : at + 2], v[own : own + 2], v[free], self.omega
            )
            more.block(row, at, by_v)
            more.block(row, own, by_i)
            for j, place in enumerate(free):
                more.block(row, place, by_free[:, j : j + 1])
            row += specification.count
        whole = (inner + self.A + more.matrix(self.A.shape)).tocsr()
        whole.eliminate_zeros()
        return F, whole


class Triplets:
    """Entries of a sparse matrix as they come."""

    def __init__(self) -> None:
        self.rows: list[int] = []
        self.columns: list[int] = []
        self.values: list[float] = []

    def put(self, row: int, column: int, value: Any) -> None:
        self.rows.append(row)
        self.columns.append(column)
        self.values.append(float(value))

    def eye(self, row: int, column: int, n: int, value: float = 1.0) -> None:
        for i in range(n):
            self.put(row + i, column + i, value)

    def block(self, row: int, column: int, values: Any) -> None:
        for i, entries in enumerate(values.tolist(), row):
            for j, value in enumerate(entries, column):
                if value:
                    self.put(i, j, value)

    def matrix(self, shape: tuple[int, int]) -> Sparse:
        import scipy.sparse as sp

        return sp.csr_matrix((self.values, (self.rows, self.columns)), shape=shape)


def _three_phase(junction: Junction, declared: dict[str, PHDAE]) -> bool:
    return three_phase(next(iter(junction.ports(declared).values())))


def _shape(model: PHDAE) -> tuple[Any, ...]:
    """Key that members share if they are alike but for their numbers."""
    return (
        model.name,
        *((v.name, v.n) for v in (*model.states, *model.algebraics, *model.parameters)),
        *((p.name, p.given, p.n, p.source is None) for p in model.ports),
    )
