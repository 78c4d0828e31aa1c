"""The couplings that the compiled master has: which of its solvers each is, where a call starts and what one leaves.

A solver in C (`ph_solver`) remembers what its coupling in Python keeps in solutions; each goes on from what the other left.
"""

from __future__ import annotations

import ctypes
from dataclasses import dataclass
from typing import Any, Protocol

import numpy as np
from numpy.typing import NDArray

from phfmu.engine.native.structures import Structures
from phfmu.network.couplings import anderson
from phfmu.network.couplings.acceptance import ITERATIONS, KNOWN
from phfmu.network.couplings.anderson import Anderson, Memory, Remembered
from phfmu.network.couplings.compiled.master_pattern import Exchanged, Pattern
from phfmu.network.couplings.coupling import Coupling, Solution
from phfmu.network.couplings.gauss_seidel import GaussSeidel
from phfmu.network.couplings.jacobi import Jacobi
from phfmu.network.couplings.newton import Newton
from phfmu.network.couplings.node_newton import NodeNewton, NodeSolution, Unknowns
from phfmu.network.interface.hidden import hidden_part
from phfmu.network.interface.joined import Joined
from phfmu.network.interface.matrices import assembled

Array = NDArray[Any]


@dataclass(frozen=True)
class Tables:
    """The tables that solvers are made of; `z`: the unknowns, which are those of the last step between calls."""

    joined: Joined
    found: Exchanged
    pattern: Pattern
    memory: Structures
    lib: ctypes.CDLL
    z: Array


class Solver(Protocol):
    """A solver of the master.

    name:        of the function that tells it, less `ph_solver_`
    held:        whether members exchange one held value each;  iterations: trials at most
    prepares:    whether it finds the junction unknowns before the first step
    fields:      of `ph_master` that are its own
    """

    name: str
    held: bool
    iterations: int
    prepares: bool
    fields: dict[str, Any]

    def spread(self, xi: Array) -> Array:
        """Values of all columns, those of junctions being xi; where it prepares."""
        ...

    def begin(self, struct: Any, last: Solution, h: float) -> bool:
        """The first step starts from `last`, which this has not left; whether as its continuation."""
        ...

    def solution(self, struct: Any, plain: Solution, h: float) -> Solution:
        """The solution of the last step of a call."""
        ...


class NewtonSolver:
    """`found`: unknowns of the last step;  `missed`: what the continuations of the last ones missed."""

    name, iterations, prepares = "newton", ITERATIONS, True

    def __init__(self, coupling: Newton | NodeNewton, t: Tables):
        self._coupling, self._t = coupling, t
        self.held = isinstance(coupling, Newton)
        self._found, self._missed = np.zeros(t.found.size), np.zeros((KNOWN, t.found.size))
        self.fields = {"found": self._found, "missed": self._missed, "memory": None}

    def spread(self, xi: Array) -> Array:
        return xi.copy() if isinstance(self._coupling, Newton) else self._coupling.exchange.of_columns(xi)

    def begin(self, struct: Any, last: Solution, h: float) -> bool:
        e, coupling = self._t.found, self._coupling
        if isinstance(coupling, Newton):
            self._t.z[:] = last.xi
            return False
        if isinstance(last, NodeSolution) and last.found is not None and last.h == h:
            self._found[:] = e.pack(last.found.flat)
            struct.known = len(last.missed)
            for to, missed in zip(self._missed, last.missed, strict=False):
                to[:] = e.pack(missed)
            return True
        self._t.z[:] = e.pack(coupling.start(last, h).flat)
        return False

    def solution(self, struct: Any, plain: Solution, h: float) -> Solution:
        if self.held:
            return plain
        e = self._t.found
        z = e.unpack(self._found)
        found = Unknowns(z[: e.nodes], z[e.nodes :].reshape(2, -1))
        missed = tuple(e.unpack(m) for m in self._missed[: struct.known])
        return NodeSolution(plain.xi, plain.y, plain.iterations, plain.accepted_by, found=found, h=h, missed=missed)


class AndersonSolver:
    """Its differences, which a step may add `anderson.ITERATIONS` to."""

    name, held, iterations, prepares = "anderson", True, anderson.ITERATIONS, False

    def __init__(self, _: Anderson, t: Tables):
        self._t, n = t, t.found.nodes
        most = min(anderson.WINDOW, n)
        self._room = most + anderson.ITERATIONS
        self._X, self._F = np.zeros((2, self._room, n))
        self._size = np.zeros(n)
        values = {
            "plain": hidden_part(assembled(t.joined.C, ()), t.joined.face.nominal).nnz == 0, "most": most, "room": self._room,
            "begun": 0, "count": 0, "newest": 0, "count_before": 0, "newest_before": 0, "X": self._X, "F": self._F,
            "size": self._size, "size_before": np.zeros(n), "xi": np.zeros(n), "f": np.zeros(n), "Q": np.zeros((most, n)),
            "R": np.zeros((most, most)), "c": np.zeros(most), "kept": np.zeros(most, np.int32),
        }  # fmt: skip
        self._own = t.memory.fill("ph_anderson", values)
        nothing = np.zeros(0)
        self.fields = {"found": nothing, "missed": nothing, "memory": ctypes.addressof(self._own)}

    def spread(self, xi: Array) -> Array:
        return xi

    def begin(self, struct: Any, last: Solution, h: float) -> bool:
        t, own = self._t, self._own
        t.z[:] = last.xi
        memory = last.memory if isinstance(last, Remembered) else None
        own.begun, own.count, own.newest = 0, 0, 0
        self._size[:] = anderson.first_sizes(t.joined)
        if memory is None:
            return False
        own.count = memory.X.shape[1]
        self._X[: own.count], self._F[: own.count], self._size[:] = memory.X.T, memory.F.T, memory.size
        t.pattern.take(memory.M)
        own.begun = int(t.lib.ph_matrix_factor(ctypes.addressof(struct)) == 0)
        return False

    def solution(self, struct: Any, plain: Solution, h: float) -> Solution:
        own, memory = self._own, None
        if own.begun:
            at = (own.newest + np.arange(own.count)) % self._room
            M = self._t.pattern.matrix()
            memory = Memory(self._X[at].T, self._F[at].T, self._size.copy(), M, bool(own.plain))
        return Remembered(plain.xi, plain.y, plain.iterations, plain.accepted_by, memory=memory)


class InTurnSolver:
    """Groups of members that step one after the other."""

    name, held, iterations, prepares = "in_turn", True, 1, False

    def __init__(self, coupling: GaussSeidel | Jacobi, t: Tables):
        self._t, e = t, t.found
        n, nshare = e.nodes, len(e.parts)
        groups = coupling.groups(t.joined)
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
        self._asked: Array = values["asked"]
        self._own = t.memory.fill("ph_in_turn", values)
        nothing = np.zeros(0)
        self.fields = {"found": nothing, "missed": nothing, "memory": ctypes.addressof(self._own)}

    def spread(self, xi: Array) -> Array:
        return xi

    def begin(self, struct: Any, last: Solution, h: float) -> bool:
        self._t.z[:] = last.xi
        self._asked[:] = 0
        return False

    def solution(self, struct: Any, plain: Solution, h: float) -> Solution:
        return plain


def _by_row(n: int, rows: list[Any], width: int) -> tuple[Array, Array]:
    """The first place of each of n rows among tuples (row, ..), in their order, and these as columns."""
    table = np.array(rows, float).reshape(-1, width)
    table = table[np.argsort(table[:, 0], kind="stable")]
    return np.searchsorted(table[:, 0], np.arange(n + 1)), table.T


#: couplings that have one
SOLVERS: dict[type, Any] = {
    Newton: NewtonSolver, NodeNewton: NewtonSolver, Anderson: AndersonSolver, GaussSeidel: InTurnSolver, Jacobi: InTurnSolver,
}  # fmt: skip


def solver_of(coupling: Coupling) -> Any:
    """The maker of the solver of a coupling; None of those that the master does not have."""
    return SOLVERS.get(type(coupling))
