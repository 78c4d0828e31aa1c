"""A member that the compiled master calls back: in Python, in a process of its own, of another tool, or landing inside its steps.

Its functions (`ph_kind`) are those of `Member` and `NodeValues`.  An exception in one of them ends the step; it is kept, and told
when the master has brought all members back.
"""

from __future__ import annotations

import ctypes
from collections.abc import Callable, Mapping
from typing import Any
from weakref import ref

import numpy as np
from numpy.typing import NDArray

from phfmu.engine.native.structures import Structures
from phfmu.network.couplings.compiled.master_pattern import MemberRows, ShareTables
from phfmu.network.members.engine_member import EngineMember
from phfmu.network.members.predicted_member import PredictedMember
from phfmu.outcome.status import EndRequested, Status, StepFailure

Array = NDArray[Any]

OK, REFUSED, NO_SENSITIVITY = (list(Status).index(s) for s in (Status.OK, Status.UNIT, Status.NO_SENSITIVITY))
_SHARE, _TIME = ctypes.c_void_p, ctypes.c_double
_PLAIN = ctypes.CFUNCTYPE(ctypes.c_int, _SHARE)
_STEP = ctypes.CFUNCTYPE(ctypes.c_int, _SHARE, _TIME, _TIME)
_RECORD = ctypes.CFUNCTYPE(ctypes.c_int, _SHARE, ctypes.c_void_p)


#: of a ledger: what its pairs would be by the values that were exchanged
EXCHANGED = "exchanged"


class CalledShare:
    """Share of a member that compiled code calls back; `values`: fields of `ph_share` that belong to the member."""

    def __init__(self, part: ShareTables, memory: Structures, lib: ctypes.CDLL):
        self._part, self._member = part, part.member
        self._error: BaseException | None = None
        self._blocked, self._state = False, None
        #: whether its steps are put off, so that others step against a prediction
        self._late = isinstance(part.member, PredictedMember)
        #: what is told of each step
        self._rows: list[dict[str, Any]] = []
        #: pairs that books of its own could tell otherwise than the values that were exchanged, and their inputs
        self._pairs = _held_against(part)
        self._energy = np.zeros(len(self._pairs))
        k, nu, ncomp = part.k, part.nu, len(part.member.booking.components)
        self._outputs, self._energies, self._end = np.zeros((k, nu)), np.zeros(ncomp), np.zeros(nu)
        calls: list[Any] = [  # in the order of `ph_kind`
            _PLAIN(self._called("_keep")), _PLAIN(self._answered("_restore")), _STEP(self._called("_advance")),
            *(_PLAIN(self._called(f)) for f in ("_refresh", "_jump", "_more")), _PLAIN(self._answered("_along")),
            _PLAIN(self._called("_present")), _RECORD(self._called("_record")),
            *(_PLAIN(self._called(f)) for f in ("_tell", "_take")),
        ]  # fmt: skip
        self._kept_alive = calls
        self.values: dict[str, Any] = {
            "kind": memory.functions([*calls, ctypes.c_void_p(None)]), "of": None, "ncomp": ncomp, "stride": nu, "length": 1,
            "outputs": self._outputs, "energies": self._energies, "end": self._end,
        }  # fmt: skip

    def bind(self, values: Mapping[str, Any]) -> None:
        """Fields of its `ph_share`: inputs and what is to be filled in."""
        self._u, self._now, self._s = (values[n] for n in ("u", "now", "s"))
        self._told, self._taken, self._S = (values[n] for n in ("told", "taken", "jump"))
        self._dy, self._dend = values["dy"], values["dend"]

    def _called(self, name: str) -> Callable[..., int]:
        """Return the method `name` as C calls it; the reference is weak, as a unit may be the only one of its process."""
        own = ref(self)

        def call(_: int, *args: Any) -> int:
            share = own()
            if share is None or share._blocked:
                return REFUSED
            try:
                getattr(share, name)(*args)
            except BaseException as error:
                share._error = error
                share._blocked = not isinstance(error, StepFailure) or error.final or isinstance(error, EndRequested)
                return REFUSED
            return OK

        return call

    def _answered(self, name: str) -> Callable[..., int]:
        """The same of a function that has an answer of its own."""
        own = ref(self)

        def call(_: int) -> int:
            share = own()
            return REFUSED if share is None else getattr(share, name)()

        return call

    # -- functions of ph_kind -------------------------------------------------------------------------------------------

    def _keep(self) -> None:
        self._state = self._member.get_state() if self._member.saves else None

    def _restore(self) -> int:
        """Also after it has refused a step."""
        try:
            if self._state is not None:
                self._member.set_state(self._state)
        except BaseException as error:
            self._error = self._error or error
            return REFUSED
        return OK

    def _advance(self, t: float, h: float) -> None:
        self._error = None
        n = self._part.kicks
        impulses = (self._s[:n].copy(), self._s[n:].copy()) if n else None
        u = self._u.reshape(self._part.k, -1).copy()
        self._outputs[:] = self._part.values.step(u, impulses, t, h)
        if self._pairs:
            fed = [*self._pairs.values()]
            self._energy = h * self._part.weights @ (u[:, fed] * self._outputs[:, fed])

    def _refresh(self) -> None:
        self._energies[:] = self._member.energies()
        y = self._member.end_output()
        self._end[: len(y)] = y

    def _jump(self) -> None:
        self._S[:] = np.ravel(self._part.values.jump())

    def _more(self) -> None:
        self._part.values.add_impulse(self._s[: self._part.kicks].copy(), self._state)

    def _along(self) -> int:
        """Derivatives of the last step; what knows none is asked for differences."""
        part = self._part
        self._dy[:], self._dend[:] = 0.0, 0.0
        if not len(part.row) or not part.left.size:  # a relation, whose rows are in C
            return OK
        fed = [int(i) for i in part.inputs[: len(part.inputs) // part.k]]
        try:
            dy, dend = part.values.sensitivity(fed, bool(part.kicks))
        except StepFailure as failure:
            if failure.status is not Status.NO_SENSITIVITY:
                self._error = failure
            return NO_SENSITIVITY
        n, kicked = len(part.inputs), part.kicked
        columns = [*range(n), *(n + kicked), *(n + part.kicks + kicked)]
        self._dy[:] = dy[:, columns].T
        if dend is not None:
            self._dend[:] = dend[:, columns].T
        return OK

    def _present(self) -> None:
        self._member.set_input(self._now[: self._member.nu])

    def _record(self, _: int) -> None:
        self._refresh()
        m = self._member
        row: dict[str, Any] = {"columns": m.read(), "H": self._energies.copy(), "ends": self._end[: m.nu].copy()}
        book = {"numerical": np.zeros(len(self._energies)), "moved": np.abs(self._energies)} | m.ledger()
        if self._pairs:
            book[EXCHANGED] = book["pairs"].copy()
            book[EXCHANGED][[*self._pairs]] = self._energy
        if self._late:
            row["missed"] = m.output() - self._outputs[0]
        self._rows.append(row | {"book": book, "events": m.happened()})

    def _tell(self) -> None:
        self._told[:] = self._member.read_signals(self._part.told)

    def _take(self) -> None:
        self._member.write_signals(self._part.taken, self._taken)

    # -- steps ----------------------------------------------------------------------------------------------------------

    def begin(self, n: int) -> None:
        self._rows, self._error, self._blocked = [], None, False

    def finish(self, t: float, h: float, row: Array, u: Array) -> None:
        """It has taken the step itself."""

    def failure(self) -> BaseException | None:
        return self._error

    def told(self, rows: Array, t: float, h: float) -> MemberRows:
        """Rows of the steps, as they were read from the member at the end of each."""
        own = self._rows[: len(rows)]
        columns, H, ends = (np.array([r[n] for r in own]) for n in ("columns", "H", "ends"))
        missed = np.array([r["missed"] for r in own]) if self._late else None
        books = {n: np.array([r["book"][n] for r in own]) for n in own[0]["book"]}
        events = tuple((i, e) for i, r in enumerate(own) for e in r["events"])
        return MemberRows(columns, H, ends, books, events, missed)


def _held_against(part: ShareTables) -> dict[int, int]:
    """Pairs of a member's books -> its inputs, of a member that is neither stepped here nor a unit, keeps books, and takes no
    impulses.
    """
    member = part.member
    if isinstance(member, EngineMember) or part.kicks or member.booking.estimated or member.booking.silent:
        return {}
    from phfmu.network.members.fmu_member import FMUMember  # runs without units do not load their reader

    if isinstance(member, FMUMember):
        return {}
    pairs = [(p.component, p.port) for p in member.booking.ports]
    found: dict[int, int] = {}
    for name, place in member.places.items():
        own = [i for i, pair in enumerate(pairs) if pair == (member.name, name)]
        fed = [i for i in range(place.start, place.stop) if member.input_sign[i] == 1.0]
        if len(own) == len(fed):
            found |= dict(zip(own, fed, strict=True))
    return found
