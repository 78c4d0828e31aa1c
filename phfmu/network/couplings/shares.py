"""Members that the compiled master steps itself: native instances, and units of this package in this process."""

from __future__ import annotations

import ctypes
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager
from typing import TYPE_CHECKING, Any, Protocol

from numpy.typing import NDArray

from phfmu.engine.native import NativeInstance
from phfmu.engine.status import StepFailure
from phfmu.engine.structures import Structures
from phfmu.network.couplings.master_library import CALLED
from phfmu.network.couplings.master_pattern import Part, Told
from phfmu.network.couplings.native_share import NativeShare
from phfmu.network.members.engine_member import EngineMember
from phfmu.network.members.member import Member

if TYPE_CHECKING:
    from phfmu.network.couplings.unit_share import UnitShare

Array = NDArray[Any]


class Own(Protocol):
    """What belongs to a member of its share; `values`: fields of `ph_share`."""

    values: dict[str, Any]

    def begin(self) -> None:
        """Before steps."""
        ...

    def finish(self, t: float, h: float, row: Array) -> None:
        """The last step that was taken, from t by h, has this row."""
        ...

    def failure(self) -> StepFailure | None:
        """Of the last step, if it cannot be asked again; else what refused one is left to the loop in Python."""
        ...

    def told(self, rows: Array, h: float) -> Told:
        """Fields of its rows, of steps of length h."""
        ...


#: of a part, where structures are kept, and the library of the master
Make = Callable[[Part, Structures, ctypes.CDLL], Own]


def own_share(member: Member) -> Make | None:
    """What makes the share of a member; None of those that are stepped in Python."""
    if isinstance(member, EngineMember):
        native = isinstance(member.instance, NativeInstance) and member.model.events is None
        return NativeShare if native else None
    return _unit_share(member)


@contextmanager
def watched(shares: Sequence[Own]) -> Iterator[None]:
    """While compiled code steps them, a crash in a unit tells its name."""
    if all(isinstance(s, NativeShare) for s in shares):
        yield
        return
    from phfmu.fmu import exit_guard
    from phfmu.network.couplings.unit_share import UnitShare

    units = [s for s in shares if isinstance(s, UnitShare)]
    exit_guard.current = lambda: [call for u in units if (call := u.under_way())]
    try:
        yield
    finally:
        exit_guard.current = None


def _unit_share(member: Member) -> Make | None:
    """Runs without units do not load their reader."""
    from phfmu.fmu.access import access
    from phfmu.network.couplings.unit_share import UnitShare
    from phfmu.network.members.fmu_member import FMUMember

    found = access(member.unit) if isinstance(member, FMUMember) else None
    if found is None or found.prefix not in CALLED:
        return None

    def make(part: Part, memory: Structures, lib: ctypes.CDLL) -> UnitShare:
        return UnitShare(part, memory, lib, found)

    return make
