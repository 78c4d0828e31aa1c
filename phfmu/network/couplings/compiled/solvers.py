"""Solvers of the compiled master by coupling: their tables, the start of a call, and the memory that one leaves.

A solver in C (`ph_solver`) remembers what the next step goes on from.  Solutions keep a copy of it, so that
a run can go on from an earlier step.
"""

from __future__ import annotations

import ctypes
from collections.abc import Callable
from dataclasses import dataclass
from typing import Any, Protocol
from weakref import ref

import numpy as np
from numpy.typing import NDArray

from phfmu.engine.native.structures import Structures
from phfmu.network.couplings import anderson
from phfmu.network.couplings.acceptance import ITERATIONS, KNOWN
from phfmu.network.couplings.anderson import Anderson
from phfmu.network.couplings.compiled.master_pattern import ExchangeTables, MasterPattern
from phfmu.network.couplings.coupling import Coupling, InTurn, Moves, Solution, Starts
from phfmu.network.couplings.newton import Continuation, Newton
from phfmu.network.interface.coupled_members import CoupledMembers
from phfmu.network.interface.hidden import hidden_part
from phfmu.network.interface.matrices import assembled

Array = NDArray[Any]

#: steps whose lengths differ by less than this part, what a clock's rounding makes of equal ones, go on from each other
SAME = 1e-9


@dataclass(frozen=True)
class SolverTables:
    """The tables that solvers are made of; `z`: the unknowns, which are those of the last step between calls."""

    joined: CoupledMembers
    found: ExchangeTables
    pattern: MasterPattern
    memory: Structures
    lib: ctypes.CDLL
    z: Array


class MasterSolver(Protocol):
    """A solver of the master.

    name:        of the function that tells it, less `ph_solver_`
    held:        whether members exchange one held value each;  iterations: trials at most
    words:       what it is, for failures; "" where it does not iterate
    fields:      of `ph_master` that are its own
    failure:     what a rule in Python raised in the last call
    """

    failure: Exception | None

    name: str
    held: bool
    iterations: int
    sweeps: int
    words: str
    fields: dict[str, Any]

    def spread(self, xi: Array) -> Array:
        """Values of all columns, those of junctions being xi."""
        ...

    def begin(self, struct: Any, last: Solution, h: float) -> bool:
        """The first step starts from `last`, which this has not left; whether as its continuation."""
        ...

    def memory(self, struct: Any) -> Any:
        """Memory that the next step starts from, after the last step of a call."""
        ...


class NewtonSolver:
    """Newton's method in C; `found`: unknowns of the last step;  `missed`: the errors of the last continuations."""

    name, iterations, sweeps, words, failure = "newton", ITERATIONS, 0, "interface Newton", None

    def __init__(self, coupling: Newton, t: SolverTables):
        self._coupling, self._t = coupling, t
        self.held = coupling.exchange is None
        self._found, self._missed = np.zeros(t.found.size), np.zeros((KNOWN, t.found.size))
        self.fields = {"found": self._found, "missed": self._missed, "memory": None}

    def spread(self, xi: Array) -> Array:
        exchange = self._coupling.exchange
        return xi.copy() if exchange is None else exchange.of_columns(xi)

    def begin(self, struct: Any, last: Solution, h: float) -> bool:
        before = last.memory if isinstance(last.memory, Continuation) else None
        if before is None or last.h == 0.0:
            self._t.z[:] = 0.0
            self._t.z[: self._t.found.nodes] = self.spread(last.xi)[self._t.found.column]
            return False
        self._found[:] = before.found
        if abs(h - last.h) > SAME * abs(h):
            self._t.lib.ph_master_further(ctypes.addressof(struct), h / last.h)
            return False
        struct.known = len(before.missed)
        for to, missed in zip(self._missed, before.missed, strict=False):
            to[:] = missed
        return True

    def memory(self, struct: Any) -> Continuation:
        return Continuation(self._found.copy(), tuple(m.copy() for m in self._missed[: struct.known]))


class _MemorySolver:
    """Solver in C that goes on from a memory of its own, which `ph_solver` saves and loads."""

    _t: SolverTables
    sweeps = 0

    def spread(self, xi: Array) -> Array:
        return xi

    def begin(self, struct: Any, last: Solution, h: float) -> bool:
        self._t.z[:] = last.xi
        if last.memory is None:
            self._t.lib.ph_master_forget(ctypes.addressof(struct))
        else:
            self._t.lib.ph_master_load(ctypes.addressof(struct), last.memory.ctypes.data)
        return False

    def memory(self, struct: Any) -> Array:
        found = np.zeros(self._t.lib.ph_master_remembered(ctypes.addressof(struct)))
        self._t.lib.ph_master_save(ctypes.addressof(struct), found.ctypes.data)
        return found


class AndersonSolver(_MemorySolver):
    """Its differences, which a step may add `anderson.ITERATIONS` to."""

    name, held, iterations, failure = "anderson", True, anderson.ITERATIONS, None
    words = "interface iteration with Anderson's acceleration"

    def __init__(self, _: Anderson, t: SolverTables):
        self._t, n = t, t.found.nodes
        most = min(anderson.WINDOW, n)
        room = most + anderson.ITERATIONS
        values = {
            "plain": int(hidden_part(assembled(t.joined.C, ()), t.joined.face.nominal).nnz == 0), "most": most, "room": room,
            "begun": 0, "count": 0, "newest": 0, "count_before": 0, "newest_before": 0, "X": np.zeros((room, n)),
            "F": np.zeros((room, n)), "size": np.zeros(n), "size_before": np.zeros(n), "from": np.zeros(n),
            "xi": np.zeros(n), "f": np.zeros(n),
            "Q": np.zeros((most, n)), "R": np.zeros((most, most)), "c": np.zeros(most),
            "inverse": np.zeros(n), "kept": np.zeros(most, np.int32),
        }  # fmt: skip
        own, nothing = t.memory.fill("ph_anderson", values), np.zeros(0)
        self.fields = {"found": nothing, "missed": nothing, "memory": ctypes.addressof(own)}


class InTurnSolver(_MemorySolver):
    """Groups of members that step one after the other."""

    name, held, iterations, words, failure = "in_turn", True, 1, "", None

    def __init__(self, coupling: Any, t: SolverTables):
        self._t, e = t, t.found
        n, nshare = e.nodes, len(e.parts)
        groups = _sweeps(coupling, t.joined)
        terms = [
            (p.row[r], i, o, v)
            for i, p in enumerate(e.parts)
            for o, r, v in zip(p.left_output, p.left_row, p.left, strict=True)
        ]
        fed = [(c, i) for i, p in enumerate(e.parts) for c in p.col]
        term, fields = _by_row(n, terms, 4)
        skew, entries = _by_row(n, list(zip(e.skew_row, range(len(e.skew_row)), strict=True)), 2)
        feeds, shares = _by_row(n, fed, 2)
        values = {
            "ngroup": len(groups), "group": np.cumsum([0, *map(len, groups)]), "member": np.concatenate(groups),
            "term": term, "term_share": fields[1], "term_output": fields[2], "term_value": fields[3],
            "skew": skew, "skew_entry": entries[1], "fed": feeds, "fed_share": shares[1],
            "begun": 0, "nrow": 0, "nshare": 0, "nblock": 0,
            "used": np.zeros(n), "base": np.zeros(max((p.member.nu for p in e.parts), default=0)),
        }  # fmt: skip
        lengths = dict.fromkeys(("asked", "share", "share_marked"), nshare) | {"label": 2 * n, "first": n + 1}
        lengths |= dict.fromkeys(("row", "row_marked", "block", "block_marked", "step"), n)
        values |= {name: np.zeros(length, np.int32) for name, length in lengths.items()}
        own, nothing = t.memory.fill("ph_in_turn", values), np.zeros(0)
        self.fields = {"found": nothing, "missed": nothing, "memory": ctypes.addressof(own)}


class CalledSolver:
    """A coupling that says in Python how its unknowns move (`Moves`, `Starts`): the loop calls it back."""

    held, name = True, ""

    def __init__(self, coupling: Any, t: SolverTables):
        self._coupling, self._t = coupling, t
        self.sweeps = int(getattr(coupling, "sweeps", 0))
        self.iterations = self.sweeps or int(getattr(coupling, "iterations", ITERATIONS))
        self._rows, self.failure = np.zeros(t.found.size), None
        moves, starts = isinstance(coupling, Moves), isinstance(coupling, Starts)
        self.words = f"the interface iteration of {type(coupling).__name__}" if moves else ""
        none = ctypes.c_void_p(None)
        own = ref(self)  # what C holds does not keep the members

        def taken(rule: str) -> int:
            solver = own()
            return 1 if solver is None else solver._take(getattr(solver._coupling, rule))

        def start_from(_: int, __: int) -> None:
            taken("started")

        def move_on(_: int, __: int, ___: int) -> int:
            return taken("moved")

        start = ctypes.CFUNCTYPE(None, ctypes.c_void_p, ctypes.c_int)(start_from) if starts else none
        move = ctypes.CFUNCTYPE(ctypes.c_int, *[ctypes.c_void_p] * 2, ctypes.c_int)(move_on) if moves else none
        idle = ctypes.CFUNCTYPE(None, ctypes.c_void_p, ctypes.c_int)(lambda _, __: None)
        calls = [
            none,
            start if starts else idle,
            t.lib.ph_trial_take,
            move,
            *[none] * 10,
        ]  # in the order of `ph_solver`
        self._kept_alive = calls
        nothing = np.zeros(0)
        self.fields = {
            "found": nothing,
            "missed": nothing,
            "memory": None,
            "rows": self._rows,
            "solver": t.memory.functions(calls),
        }

    def spread(self, xi: Array) -> Array:
        return xi

    def begin(self, struct: Any, last: Solution, h: float) -> bool:
        self.failure = None
        self._t.z[:] = last.xi
        self._rows[:] = 0.0 if last.memory is None else last.memory
        return False

    def memory(self, struct: Any) -> Array:
        return self._rows.copy()

    def _take(self, rule: Callable[[CoupledMembers, Array, Array], Array]) -> int:
        """The unknowns by a rule; what it raises ends the step."""
        try:
            self._t.z[:] = rule(self._t.joined, self._t.z.copy(), self._rows.copy())
        except Exception as error:
            self.failure, self._t.z[:] = error, np.nan
        return int(self.failure is not None)


def _by_row(n: int, rows: list[Any], width: int) -> tuple[Array, Array]:
    """The first place of each of n rows among tuples (row, ..), in their order, and these as columns."""
    table = np.array(rows, float).reshape(-1, width)
    table = table[np.argsort(table[:, 0], kind="stable")]
    return np.searchsorted(table[:, 0], np.arange(n + 1)), table.T


def _sweeps(coupling: Any, joined: CoupledMembers) -> list[list[int]]:
    """The groups of a coupling in turn; raises ValueError where they are no sweeps over all members."""
    groups, n, name = coupling.groups(joined), len(joined.members), type(coupling).__name__
    every = [i for group in groups for i in group]
    if not every or any(sorted(every[at : at + n]) != list(range(n)) for at in range(0, len(every), n)):
        raise ValueError(f"{name}: the groups {groups} do not have each of {n} members once in a sweep")
    if len(every) > n and not coupling.repeats:
        raise ValueError(
            f"{name}: its groups take each member {len(every) // n} times, and it says that it repeats no step"
        )
    return groups


SOLVERS: dict[type, Any] = {Newton: NewtonSolver, Anderson: AndersonSolver}


def solver_of(coupling: Coupling) -> Any:
    """The maker of the solver of a coupling."""
    return InTurnSolver if isinstance(coupling, InTurn) else SOLVERS.get(type(coupling), CalledSolver)
