"""Members as the compiled master sees them: native instances, and units of this package in this process, which it steps itself,
and all others, which it calls back.

A native member: `ph_native`, and what its rows tell.
"""

from __future__ import annotations

import ctypes
from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import contextmanager
from typing import TYPE_CHECKING, Any, Protocol

import numpy as np
from numpy.typing import NDArray

from phfmu.engine.native.native import NativeInstance
from phfmu.engine.native.structures import Structures
from phfmu.network.couplings.compiled.called_share import CalledShare
from phfmu.network.couplings.compiled.master_library import CALLED
from phfmu.network.couplings.compiled.master_pattern import MemberRows, ShareTables
from phfmu.network.members.engine_member import EngineMember
from phfmu.network.members.member import Member

if TYPE_CHECKING:
    from phfmu.network.couplings.compiled.unit_share import UnitShare


Array = NDArray[Any]


class NativeShare:
    """Share of a member that a native instance steps; `values`: fields of `ph_share` that belong to the member."""

    def __init__(self, part: ShareTables, m: Structures, lib: ctypes.CDLL):
        self._part = part
        self._member: Any = part.member
        instance = self._member.instance
        handle, self._plan, self._layout = instance.handle, instance.model.step, instance.layout
        #: length of the signal table
        self._signals = max(s.stop for s in self._layout.values())
        start, ncomp, nq = handle.signals, self._plan.ncomp, self._plan.nq
        self.values: dict[str, Any] = {
            "kind": lib.ph_kind_native(), "of": ctypes.addressof(self._filled(handle, m)), "ncomp": ncomp, "stride": nq,
            "length": self._signals + 5 * ncomp + nq,
            "outputs": start + 8 * self._layout["y_step"].start if part.held else handle.node_outputs,
            "energies": start + 8 * self._layout["H"].start, "end": start + 8 * self._layout["y_end"].start,
        }  # fmt: skip

    def _filled(self, handle: Any, m: Structures) -> Any:
        part, plan = self._part, self._plan
        chain = handle.tangents() if part.directions and not part.held else None
        kicks = handle.impulses() if part.kicks else handle.kicked
        own, width = kicks.n if kicks else 0, plan.nx + 1 + plan.na
        unit = np.zeros((part.directions, part.k * plan.nu))
        unit[np.arange(len(part.inputs)), part.inputs] = 1.0
        told = np.array([self._member.place(n) for n in part.told], np.int32).reshape(-1, 2)
        values = {
            "np": plan.np, "ntold": len(told), "ntaken": len(part.taken), "told_first": told[:, 0], "told_count": told[:, 1],
            "taken": self._member.parameter_places(part.taken), "p": np.zeros(plan.np),
            "in": handle.instance, "kicks": kicks.address if kicks else None,
            "chain": chain.address if chain else None,
            "parts": self._member.parts, "exact": int(self._member.together),
            "nq": plan.nq, "nsignal": self._signals, "width": width, "impulses": own,
            "signals": handle.signals, "values": kicks.values.ctypes.data if kicks else None,
            "du": unit, "ds": np.eye(part.kicks)[part.kicked], "ds_end": np.zeros((part.directions, part.kicks)),
            "kept": np.zeros(handle.state_size // 8 + 1), "copied": np.zeros(handle.state_size // 8 + 1),
            "kept_values": np.zeros(4 * own), "dx": np.zeros(max(part.directions * width, plan.nu**2)),
        }  # fmt: skip
        return m.fill("ph_native", values)

    def bind(self, values: Mapping[str, Any]) -> None:
        """It has memory of its own."""

    def begin(self, n: int) -> None:
        self._member.instance.expect(n * self._member.parts)

    def finish(self, t: float, h: float, row: Array, u: Array) -> None:
        """The instance is where its last step ended, t + h, under held inputs u, or values at nodes."""
        if self._part.held:
            self._member.took(u)

    def failure(self) -> None:
        """It can always be asked again."""

    def told(self, rows: Array, t: float, h: float) -> MemberRows:
        """Fields of its rows."""
        m, at, books = self._member, self._signals, dict[str, Array]()
        for name in ("stored", "dissipated", "supplied", "numerical", "moved", "pairs"):
            size = self._plan.nq if name == "pairs" else self._plan.ncomp
            found = rows[:, at : at + size]
            books[name] = m.pairs(found) if name == "pairs" else found
            at += size
        ends = rows[:, self._layout["y_end"]][:, : m.nu]
        return MemberRows(m.columns(rows[:, : self._signals]), rows[:, self._layout["H"]], ends, books)


class ShareMemory(Protocol):
    """The memory of a member's share; `values`: fields of `ph_share`."""

    values: dict[str, Any]

    def bind(self, values: Mapping[str, Any]) -> None:
        """Fields of its `ph_share`, which the master works on."""
        ...

    def begin(self, n: int) -> None:
        """Before at most n steps."""
        ...

    def finish(self, t: float, h: float, row: Array, u: Array) -> None:
        """The last step that was taken, from t by h under inputs u, has this row."""
        ...

    def failure(self) -> BaseException | None:
        """Why it refused the last step, where it knows or cannot be asked again; else it is asked for the step once more."""
        ...

    def told(self, rows: Array, t: float, h: float) -> MemberRows:
        """Fields of its rows, of steps of length h from t."""
        ...


#: of a part, where structures are kept, and the library of the master
ShareMaker = Callable[[ShareTables, Structures, ctypes.CDLL], ShareMemory]


def own_share(member: Member) -> ShareMaker:
    """The maker of the share of a member: what the master can step itself, and back, it does; others are called back."""
    if not member.saves:
        return CalledShare
    if isinstance(member, EngineMember):
        native = isinstance(member.instance, NativeInstance) and member.model.events is None
        return NativeShare if native else CalledShare
    return _unit_share(member) or CalledShare


@contextmanager
def watched(shares: Sequence[ShareMemory]) -> Iterator[None]:
    """While compiled code steps them, a crash in a unit tells its name."""
    if all(isinstance(s, NativeShare | CalledShare) for s in shares):
        yield
        return
    from phfmu.fmu.isolation import exit_guard
    from phfmu.network.couplings.compiled.unit_share import UnitShare

    units = [s for s in shares if isinstance(s, UnitShare)]
    exit_guard.current = lambda: [call for u in units if (call := u.under_way())]
    try:
        yield
    finally:
        exit_guard.current = None


def _unit_share(member: Member) -> ShareMaker | None:
    """Runs without units do not load their reader."""
    from phfmu.fmu.importer.access import access
    from phfmu.network.couplings.compiled.unit_share import UnitShare
    from phfmu.network.members.fmu_member import FMUMember

    found = access(member.unit) if isinstance(member, FMUMember) else None
    if found is None or found.prefix not in CALLED:
        return None

    def make(part: ShareTables, memory: Structures, lib: ctypes.CDLL) -> UnitShare:
        return UnitShare(part, memory, lib, found)

    return make
