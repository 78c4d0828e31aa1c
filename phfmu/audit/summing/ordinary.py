"""Blocks of ordinary steps, summed and judged in one pass of compiled code: the same bits as by arrays, without their columns."""

from __future__ import annotations

import ctypes
from collections.abc import Sequence
from functools import cache
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from phfmu.audit.booked_steps import varying_energy
from phfmu.audit.booking import PROJECTION, Booking
from phfmu.audit.judge import ComponentBalance, Judge
from phfmu.audit.summing.run_sums import RunSums
from phfmu.audit.summing.sums import CompensatedSum, Floats
from phfmu.outcome.steps import Steps

_SIZE, _REAL, _AT = ctypes.c_ssize_t, ctypes.c_double, ctypes.c_void_p
#: sums of the ledger in compiled code, in its order
_SUMS = (
    *("dissipated", "supplied", "numerical", "stored", "gap", "missed", "squares", "gross"),
    *("port", "junction", "exchanged", "created", "part"),
    *("dissipation", "external", "residual", "unexplained", "dH", "loss", "left"),
)


@cache
def _structure(lanes: int) -> type[ctypes.Structure]:
    """`ph_accounts` of runtime/ordinary.h, whose numbers are those of so many runs side by side."""
    number = _REAL if lanes == 1 else _REAL * lanes
    fields = [
        *((name, _SIZE) for name in ("n", "c", "q", "junctions", "parts", "loose")),
        ("rtol", _REAL),
        *((name, _AT) for name in ("H0", "H", "stored", "dissipated", "supplied", "numerical", "moved", "pairs", "works")),
        ("varying", _AT),
        *((name, _AT) for name in ("judged", "owner", "port", "junction", "outside", "part_junction", "projection")),
        ("before", _AT),
        *((f"{part}_{name}", _AT) for name in _SUMS for part in ("high", "low")),
        *((name, _AT) for name in ("reach", "largest", "stirred", "turnover", "passed")),
        *((name, _AT) for name in ("worst", "worst_residual", "worst_row", "worst_junction", "worst_part")),
        ("worst_unexplained", number),
        ("scratch", _AT),
        ("violated", number),
    ]  # fmt: skip
    return type("Accounts", (ctypes.Structure,), {"_fields_": fields})


class Ordinary:
    """Takes the blocks of one booking for the sums and the judge of a run.

    lanes: of how many runs side by side each number is one, for compiled code that judges their steps (`accounts`).
    """

    def __init__(self, library: Any, booking: Booking, sums: RunSums, judge: Judge, lanes: int = 1):
        self.booking, self._library, self._sums, self._judge = booking, library, sums, judge
        self._c, self._q = len(booking.components), len(booking.ports)
        self._junctions, self._parts = list(booking.junctions), list(booking.parts)
        self._known: dict[bool, tuple[Sequence[ComponentBalance], list[CompensatedSum]]] = {}
        sums.meet(booking)
        c, m = self._c, len(self._junctions)
        widths = dict.fromkeys(_SUMS[:8], c) | {
            "port": len(booking.scalars),
            "junction": m,
            "exchanged": m,
            "created": m,
        }
        widths |= {"part": len(self._parts)} | dict.fromkeys(_SUMS[13:], 1)
        self._many = sum(widths.values())
        most = dict.fromkeys(("before", "reach", "largest", "stirred", "turnover", "worst", "worst_residual"), c)
        most |= {"passed": m, "worst_junction": m, "worst_part": len(self._parts), "scratch": 7 * (c + m)}
        #: sums, high parts and then low ones, and what else goes in and comes out
        self._state = np.zeros(lanes * (2 * self._many + sum(most.values())))
        self._rows = np.empty(c, np.intp)
        self._own: Any = _structure(lanes)(0, c, self._q, m, len(self._parts), booking.loose, judge.rtol)
        begin = self._state.ctypes.data
        for part in ("high", "low"):
            for name, width in widths.items():
                setattr(self._own, f"{part}_{name}", begin)
                begin += 8 * lanes * width
        for name, width in most.items():
            setattr(self._own, name, begin)
            begin += 8 * lanes * width
        self._booked = self._tables()  # compiled code reads them
        for name, array in (self._booked | {"worst_row": self._rows}).items():
            setattr(self._own, name, array.ctypes.data)

    def _tables(self) -> dict[str, NDArray[Any]]:
        """The booking by columns."""
        b = self.booking
        component, port = ({name: i for i, name in enumerate(own)} for own in (b.components, b.scalars))
        junction, outside = {name: i for i, name in enumerate(b.junctions)}, np.zeros(self._q)
        for column, sign in b.external:
            outside[column] = sign
        return {
            "judged": np.array(b.exact, np.intp),
            "owner": np.array([component.get(p.component, -1) for p in b.ports], np.intp),
            "port": np.array([port[p.component, p.port] for p in b.ports], np.intp),
            "junction": np.array([-1 if p.junction is None else junction[p.junction] for p in b.ports], np.intp),
            "outside": outside,
            "part_junction": np.array([junction[key.junction] for key in b.parts], np.intp),
            "projection": np.array([key.part == PROJECTION for key in b.parts], np.intp),
        }

    @property
    def accounts(self) -> tuple[int, NDArray[Any]]:
        """For compiled code that judges its own steps: the address of the accounts, and the memory of all that they add up, which
        is zero at the start."""
        return ctypes.addressof(self._own), self._state

    def take(self, steps: Steps, H0: ArrayLike | None) -> list[int] | None:
        """Add the steps, if all are ordinary; the row that is now the worst of each component, or -1.  Else nothing, None."""
        columns = self._columns(steps, H0)
        if columns is None:
            return None
        own, lost = self._own, "numerical" in columns
        if lost not in self._known:
            accounts = self._judge.known(self.booking, columns["H0"])
            self._known[lost] = accounts, self._by_order(accounts, lost)
        accounts, sums = self._known[lost]
        self._begin(accounts, sums)
        own.n, own.numerical, own.moved, own.works = len(columns["H"]), None, None, None
        for name, array in columns.items():
            setattr(own, name, array.ctypes.data)
        if not self._library.ph_ordinary(ctypes.byref(own), len(self.booking.scalars)):
            return None
        self._keep(accounts, sums, columns["H"])
        return self._rows.tolist()

    def _columns(self, s: Steps, H0: ArrayLike | None) -> dict[str, Floats] | None:
        """The columns of the steps; None where one has not the shape that it should have, or is not summed here."""
        names = ("H", "stored", "dissipated", "supplied", "numerical", "moved", "pairs", "works")
        if s.exchanged is not None:
            return None
        asked = {name: x for name in names if (x := getattr(s, name)) is not None}
        asked["H0"] = np.asarray(s.H) - s.stored if H0 is None else H0
        found = {name: np.ascontiguousarray(x, np.float64) for name, x in asked.items()}
        n, width = len(found["H"]), {"pairs": self._q, "works": len(self._parts)}
        right = all(x.shape == (n, width.get(name, self._c)) for name, x in found.items())
        if not (n and right and ("works" in found) == bool(self._parts)):
            return None
        found["varying"] = varying_energy(self.booking, found["H0"], found["H"])
        return found

    def _by_order(self, accounts: Sequence[ComponentBalance], lost: bool) -> list[CompensatedSum]:
        """The sums in the order of compiled code; those of what the steps lack are for nothing."""
        by, b, names, junctions = self._sums.by, self.booking, self.booking.components, self._junctions
        keys = [(key, name) for key in ("dissipated", "supplied", "numerical", "stored") for name in names]
        network = {"dissipated": True, "external": b.external, "junction_residual": junctions, "unexplained": True}
        network |= {"dH": True, "numerical": lost}
        return [
            *(by[key] if lost or key[0] != "numerical" else CompensatedSum() for key in keys),
            *(a.gap for a in accounts),
            *(a.missed for a in accounts),
            *(a.squares for a in accounts),
            *(by["gross", name] for name in names),
            *(by[("port", *key)] for key in b.scalars),
            *(by[key, name] for key in ("junction", "exchanged", "created") for name in junctions),
            *(by["part", key.junction, key.part] for key in self._parts),
            *(by[(key,)] if there else CompensatedSum() for key, there in network.items()),
            self._judge.squares,
        ]

    def _begin(self, accounts: Sequence[ComponentBalance], sums: Sequence[CompensatedSum]) -> None:
        """The values that compiled code goes on from."""
        worst, parts, passed = self._sums.junctions, self._sums.parts, self._judge.passed
        state = [
            *(s.high for s in sums),
            *(s.low for s in sums),
            *(a.H_end + a.jumps for a in accounts),
            *(a.reach for a in accounts),
            *(a.largest for a in accounts),
            *(a.moved for a in accounts),
            *(a.turnover for a in accounts),
            *(a.worst_ratio for a in accounts),
            *(a.worst_residual for a in accounts),
            *(passed.get(name, 0.0) for name in self._junctions),
            *(worst.get(name, 0.0) for name in self._junctions),
            *(parts.get(key, 0.0) for key in self._parts),
        ]
        self._state[: len(state)] = state
        self._rows[:] = -1
        self._own.worst_unexplained = self._sums.unexplained

    def _keep(self, accounts: Sequence[ComponentBalance], sums: Sequence[CompensatedSum], H: Floats) -> None:
        """The values that the last row leaves behind."""
        state = self._state.tolist()
        for each, high, low in zip(sums, state, state[self._many :], strict=False):
            each.high, each.low = high, low
        c, m, at = self._c, len(self._junctions), 2 * self._many + self._c
        reach, largest, stirred, turnover, worst, residual = (state[at + k * c : at + (k + 1) * c] for k in range(6))
        for i, (account, end) in enumerate(zip(accounts, H[-1].tolist(), strict=True)):
            account.reach, account.largest, account.moved = reach[i], largest[i], stirred[i]
            account.turnover = turnover[i]
            account.worst_ratio, account.worst_residual = worst[i], residual[i]
            account.H_end, account.jumps = end, 0.0
        at += 6 * c
        self._judge.passed.update(zip(self._junctions, state[at:], strict=False))
        self._sums.junctions.update(zip(self._junctions, state[at + m :], strict=False))
        self._sums.parts.update(zip(self._parts, state[at + 2 * m :], strict=False))
        self._sums.unexplained = self._own.worst_unexplained
