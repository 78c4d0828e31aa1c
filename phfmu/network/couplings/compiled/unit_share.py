"""A unit of this package as the compiled master sees it: `ph_unit`, and what its rows tell."""

from __future__ import annotations

import ctypes
from collections.abc import Iterator, Mapping, Sequence
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from phfmu.engine.native.structures import Structures
from phfmu.fmu.importer.access import Access
from phfmu.network.couplings.compiled.master_library import HEADER
from phfmu.network.couplings.compiled.master_pattern import MemberRows, ShareTables
from phfmu.outcome.steps import StepEvent

if TYPE_CHECKING:
    from phfmu.fmu.importer.refusal import UnitFailure
    from phfmu.fmu.importer.unit_interface import Scalar
    from phfmu.fmu.importer.values import References

Array = NDArray[Any]

FATAL = 4  # of fmi2Status and fmi3Status


class UnitShare:
    """Share of a unit that compiled code steps; `values`: fields of `ph_share` that belong to the member."""

    def __init__(self, part: ShareTables, m: Structures, lib: ctypes.CDLL, access: Access):
        self._part, self._memory, self._access = part, m, access
        self._member: Any = part.member
        self._face = access.values.interface
        nu, k = self._member.nu, part.k
        self._y, self._now = np.zeros(k * nu), np.zeros(nu + 1)
        self._events = self._member.events_told
        self._before = np.zeros(len(self._events.names))
        self._row = self._recorded()
        self._place = {n: i for i, n in enumerate(self._row)}
        self._columns = [self._place[n] for n in self._member.names]
        #: which compiled code writes over, and the unit frees
        self._kept = self._member.get_state()
        self._struct = m.fill("ph_unit", self._fields(lib, ctypes.addressof(self._kept.handle)))
        self.values: dict[str, Any] = {
            "kind": lib.ph_kind_unit(), "of": ctypes.addressof(self._struct), "ncomp": 1, "stride": nu,
            "length": len(self._row) + 2 * k * nu, "outputs": self._y.ctypes.data,
            "energies": self._now[nu:].ctypes.data, "end": self._now.ctypes.data,
        }  # fmt: skip

    def _fields(self, lib: ctypes.CDLL, state: int) -> dict[str, Any]:
        """A master restores no state of a time before the step that it takes, also where it repeats that: no_set_prior."""
        part, access, v = self._part, self._access, self._access.values
        version = getattr(lib, f"ph_unit_{access.prefix}")()
        own, held, given, out = v.nu, self._held(), v.input_sign, v.output_sign
        kicked = self._member.unit.at_nodes.kicked if part.kicks else []
        impulses = (
            self._scalars(v.impulses.scalars, range(2 * part.kicks), np.tile(given[kicked], 2)) if part.kicks else None
        )
        n = part.kicks
        triangle = (np.tril_indices(n)[0] * n + np.tril_indices(n)[1]).tolist()
        ends = [*range(own), *self._member.sent.values(), self._member.nu]
        told = [*v.y_end.scalars, *self._named(self._member.sent), *access.books.stored.scalars]
        unknown, at, sign = self._outputs()
        if part.kicks:
            unknown, at = [*unknown, *v.y_end.scalars], [*at, *(part.k * self._member.nu + i for i in range(own))]
            sign = np.append(sign, out)
        return {
            "version": version, "functions": self._memory.functions(access.functions(HEADER.functions(f"ph_{access.prefix}"))),
            "instance": access.instance, "state": state,
            "input": held if part.held else self._at_nodes(), "held": held, "impulse": impulses,
            "output": self._scalars(*self._outputs()),
            "present": self._scalars(told, ends, np.concatenate([out, np.ones(len(told) - own)])),
            "jump": self._scalars(v.jump.scalars, triangle, np.ones(len(triangle))) if part.kicks else None,
            "told": self._scalars(self._named(part.told), range(len(part.told)), np.ones(len(part.told))),
            "taken": self._scalars(self._named(part.taken), range(len(part.taken)), np.ones(len(part.taken))),
            "row": self._scalars(self._named(self._row), range(len(self._row)), np.ones(len(self._row))),
            "unknown": self._scalars(unknown, at, sign), "known": self._memory.array(self._known(kicked)),
            "nrow": len(self._row), "y": self._y, "now": self._now,
            "impulses": np.zeros(2 * part.kicks), "no_set_prior": 1, "time": 0.0, "length": 0.0, "answer": 0,
            "call": None, "refused": None,
        }  # fmt: skip

    # -- variables --------------------------------------------------------------------------------------------------

    def _named(self, names: Any) -> list[Scalar]:
        return self._face.scalars(list(names), "variable")

    def _recorded(self) -> list[str]:
        """Names of what is told of a step, each once."""
        v, books = self._access.values, self._access.books
        groups = (v.y_end, v.pair_energies, books.stored, books.step)
        own = [s.name for r in groups for s in r.scalars]
        return [*dict.fromkeys([*self._member.names, *self._member.sent, *own, *self._events.names])]

    def _held(self) -> int:
        """Inputs from now on: of ports, and of signals by their own names."""
        v, taken = self._access.values, self._member.taken
        sign = np.append(v.input_sign, np.ones(len(taken)))
        return self._scalars([*v.u.scalars, *self._named(taken)], range(v.nu + len(taken)), sign)

    def _at_nodes(self) -> int:
        """Inputs at the nodes of a step: of ports, then of signals."""
        v, k = self._access.values, self._part.k
        at = [*self._nodes(range(v.nu)), *self._nodes(self._member.taken.values())]
        sign = np.append(np.tile(v.input_sign, k), np.ones(v.taken.n))
        return self._scalars([*v.u_nodes.scalars, *v.taken.scalars], at, sign)

    def _outputs(self) -> tuple[list[Scalar], list[int], Array]:
        """Outputs of a step, at its nodes or their means: scalars, places among all, signs."""
        v, k = self._access.values, self._part.k
        if self._part.held:
            assert v.y_mean is not None
            return [*v.y_mean.scalars], [*range(v.nu)], v.output_sign
        at = [*self._nodes(range(v.nu)), *self._nodes(self._member.sent.values())]
        sign = np.append(np.tile(v.output_sign, k), np.ones(v.sent.n))
        return [*v.y_nodes.scalars, *v.sent.scalars], at, sign

    def _nodes(self, places: Any) -> list[int]:
        """Places at all nodes of places among the nu, node by node."""
        own = list(places)
        return [node * self._member.nu + i for node in range(self._part.k) for i in own]

    def _known(self, kicked: Sequence[int]) -> list[Any]:
        """The variables that each direction is along, one call each."""
        part, v, nu = self._part, self._access.values, self._member.nu
        found: list[tuple[Scalar, float]] = []
        for at in part.inputs.tolist():
            node, j = divmod(at, nu)
            if j >= v.nu:
                found.append((v.taken.scalars[node * len(self._member.taken) + j - v.nu], 1.0))
            else:
                inputs = v.u if part.held else v.u_nodes
                found.append((inputs.scalars[node * v.nu + j], float(v.input_sign[j])))
        for end in range(2):
            own = part.kicked.tolist()
            found += [(v.impulses.scalars[end * part.kicks + i], float(v.input_sign[kicked[i]])) for i in own]
        return [self._struct_of([s], [0], [sign], seed=s.entry) for s, sign in found]

    def _scalars(self, scalars: Sequence[Scalar], at: Any, sign: Any) -> int:
        return ctypes.addressof(self._struct_of(scalars, at, sign))

    def _struct_of(self, scalars: Sequence[Scalar], at: Any, sign: Any, seed: int | None = None) -> Any:
        """`ph_scalars`; seed: the entry of the value that is one."""
        r: References = self._access.references(scalars)
        of = r.by_type[0] if r.n else None
        if of is not None and seed is not None:
            of.buffer[seed] = 1.0
        values = {
            "reference": of.references if of else None, "nreference": of.n if of else 0, "nvalue": of.total if of else 0,
            "n": r.n, "place": of.picks if of else np.zeros(0), "at": list(at), "sign": sign,
            "value": of.address if of else None,
        }  # fmt: skip
        return self._memory.fill("ph_scalars", values)

    # -- steps ------------------------------------------------------------------------------------------------------

    def bind(self, values: Mapping[str, Any]) -> None:
        """It has memory of its own."""

    def begin(self, n: int) -> None:
        """Reads what only events change, as it is before the steps."""
        if len(self._before):
            self._before = self._member.unit.get(self._events.names)

    def finish(self, t: float, h: float, row: Array, u: Array) -> None:
        """The last step that was taken, from t by h under inputs u, has this row."""
        if self._part.held:
            self._member.took(u)
        first, k, nu = len(self._row), self._part.k, self._member.nu
        given = row[first : first + k * nu].reshape(k, nu)[:, : self._access.values.nu]
        self._access.stepped(t, h, given, self._part.held)

    def failure(self) -> UnitFailure | None:
        """The fatal error after which the unit is dead."""
        if self._struct.answer != FATAL:
            return None
        function = ctypes.string_at(self._struct.refused).decode()
        return self._access.failure(function, FATAL, self._struct.time, self._struct.length)

    def under_way(self) -> tuple[str, str, tuple[float, ...]] | None:
        """The call of a function of the unit that is being made."""
        if not self._struct.call:
            return None
        function = ctypes.string_at(self._struct.call).decode()
        if function.endswith("DoStep"):
            return self._member.name, "doStep", (self._struct.time,)
        return self._member.name, function, ()

    def told(self, rows: Array, t: float, h: float) -> MemberRows:
        """Fields of its rows."""
        v, books, first, shape = (
            self._access.values,
            self._access.books,
            len(self._row),
            (self._part.k, self._member.nu),
        )
        if v.pair_energies.n:
            pairs = self._read(rows, v.pair_energies)
        else:
            given, y = (rows[:, first:].reshape(len(rows), 2, *shape)[:, i, :, : v.nu] for i in range(2))
            pairs = books.through(h, given, y)
        H = self._read(rows, books.stored)
        zero = {"numerical": np.zeros_like(H), "moved": np.abs(H)}
        book = self._member.booked(zero | books.named(self._read(rows, books.step)) | {"pairs": pairs})
        ends = np.zeros((len(rows), self._member.nu))
        ends[:, : v.nu] = self._read(rows, v.y_end) * v.output_sign
        return MemberRows(rows[:, self._columns], H, ends, book, tuple(self._happened(rows, t, h)))

    def _happened(self, rows: Array, t: float, h: float) -> Iterator[tuple[int, StepEvent]]:
        """Events within the steps, by number of the step."""
        if not len(self._before):
            return
        values = np.vstack([self._before, rows[:, [self._place[n] for n in self._events.names]]])
        for i in np.flatnonzero((values[1:] != values[:-1]).any(axis=1)).tolist():
            for event in self._events.told(t + (i + 1) * h, values[i], values[i + 1]):
                yield i, event

    def _read(self, rows: Array, r: References) -> Array:
        return rows[:, [self._place[s.name] for s in r.scalars]]
