"""The master in compiled code: members of native engines and units, stepped and joined without returning to Python.

One loop for all couplings that are solvers of it (`solvers.py`).  They iterate as their files in Python do, with the same rules;
equal to rounding, since linear systems are solved by the sparse factors of the runtime.  What does not go as usual is left to
these: a step that is refused by the compiled loop is taken by them, or refused with their words.
"""

from __future__ import annotations

import ctypes
from collections.abc import Sequence
from time import perf_counter
from typing import Any

import numpy as np
from numpy.typing import NDArray

from phfmu.engine.native.structures import Structures
from phfmu.gradients.quadrature import nodes
from phfmu.network.couplings.compiled.master_library import HEADER, START_TRIALS, library
from phfmu.network.couplings.compiled.master_pattern import Exchanged, Part, Pattern, Told, exchanged
from phfmu.network.couplings.compiled.shares import Make, Own, own_share, watched
from phfmu.network.couplings.compiled.solvers import Solver, Tables, solver_of
from phfmu.network.couplings.compiled.threads import Pace, crew
from phfmu.network.couplings.coupling import Coupling, Solution
from phfmu.network.couplings.signals.held_signals import HeldSignals
from phfmu.network.couplings.unconverged import plain
from phfmu.network.interface.end_sums import EndSums
from phfmu.network.interface.joined import Joined
from phfmu.outcome.status import StepFailure
from phfmu.outcome.steps import Steps
from phfmu.plan.ordering import StructurallySingular
from phfmu.schemes.impulses import POINTS

Array = NDArray[Any]

#: what `timed` tells of, as `ph_part` does
PARTS = ("join", "steps", "exchange", "solve")
#: words for ph_accepted
ACCEPTED = np.array(["", "energy", "rounding floor"])
LEDGER = ("stored", "dissipated", "supplied", "numerical", "moved", "pairs")


class Master:
    """Compiled steps of `joined` under `coupling`; ledger rows and columns are those of `Coupled`."""

    def __init__(
        self,
        joined: Joined,
        coupling: Coupling,
        found: Exchanged,
        makes: Sequence[Make],
        works: bool = False,
        threads: int | None = None,
        signals: HeldSignals | None = None,
    ):
        self.joined, self.coupling, self.found, self._works = joined, coupling, found, works
        #: after which members cannot be asked again
        self.failure: StepFailure | None = None
        #: threads used last
        self.pace, self.threads = Pace(len(found.parts), threads), 1
        self._pattern, self.memory = Pattern(found), Structures(HEADER)
        self._lib = library()
        self._inputs: list[Array] = []
        #: held signals that members take but by ports, as they are now
        self._taken = [np.zeros(len(p.taken)) for p in found.parts]
        self._own = [make(p, self.memory, self._lib) for make, p in zip(makes, found.parts, strict=True)]
        self._signals, self._held = signals, None if signals is None else self._held_wires(signals)
        shares = [self._share(i, own) for i, own in enumerate(self._own)]
        tables = Tables(joined, found, self._pattern, self.memory, self._lib, np.zeros(found.size))
        self._z = tables.z
        self._solver: Solver = solver_of(coupling)(coupling, tables)
        #: the solution and length of the last step that was taken here, which the memory of the loop goes on from
        self._left: tuple[Solution, float] | None = None
        #: steps that were taken here;  rules of the iteration (`ph_rules`)
        self.taken, self.rules = 0, self.memory.fill("ph_rules", self._rules())
        self._array = self.memory.array(shares)
        self._struct = self.memory.fill("ph_master", self._values())
        self._lib.ph_master_lu_init(ctypes.addressof(self._struct))

    def advance(self, last: Solution, sums: EndSums, grid: tuple[float, float, int], n: int) -> tuple[Steps, Solution]:
        """As many of n steps k = first.. from t0 + k h (grid: t0, h, first) as go as usual, and the last of their solutions.

        The members are at the end of these.  The first steps of a run tell how long a trial takes, and what threads gain.
        """
        parts: list[Steps] = []
        t0, h, first = grid
        while n:
            k, self.threads = self.pace.part(n)
            steps, last = self._advance(last, sums, (t0, h, first), k)
            if len(steps.H):
                parts.append(steps)
            first, n = first + k, n - k if len(steps.H) == k else 0
        return Steps.joined(parts) if parts else Steps.stacked([]), last

    def prepare(self, guess: Array, t0: float, h: float) -> tuple[Array, Array] | None:
        """Junction unknowns before the first step: means of a trial step, and those of the instant; None: this one cannot.

        `guess`: where the trial starts from.  The members stay where they are.
        """
        if not self._solver.prepares:
            return None
        e, s, n = self.found, self._struct, len(self.joined.face.names)
        start, (mean, begin) = self._solver.spread(guess), np.zeros((2, e.columns))
        rows = [np.empty((1, own.values["length"])) for own in self._own]
        given = [self._given(i, (t0, h, 0), 1) for i in range(len(rows))]
        for struct, row, followed in zip(self._array, rows, given, strict=True):
            struct.record = row.ctypes.data
            struct.given = None if followed is None else followed.ctypes.data
        xi, trials, accepted = np.empty((1, 2 * e.columns)), np.zeros(1, np.int32), np.zeros(1, np.int32)
        s.xi, s.trials, s.accepted, s.work, s.cost = (
            xi.ctypes.data,
            trials.ctypes.data,
            accepted.ctypes.data,
            None,
            None,
        )
        samples = self._begin_held(1)
        arrays = (start.ctypes.data, mean.ctypes.data, begin.ctypes.data)
        with watched(self._own):
            status = self._lib.ph_master_prepare(ctypes.addressof(s), t0, h, *arrays)
        del samples
        self.failure = next((f for own in self._own if (f := own.failure())), None)
        return None if status or self.failure else (mean[:n], begin[:n])

    @property
    def solver(self) -> str:
        """Name of its solver, less `ph_solver_`."""
        return self._solver.name

    def spread(self, xi: Array) -> Array:
        """Values of all columns, those of junctions being xi."""
        return self._solver.spread(xi)

    def timed(self) -> Array:
        """Seconds of PARTS, to which the loop adds from now on, where one thread runs it: two readings of a clock a call."""
        spent = np.zeros(len(PARTS))
        clock = self.memory.fill("ph_clock", {"spent": spent, "last": 0.0, "part": 0})
        for struct in (self._struct, *self._array):
            struct.clock = ctypes.addressof(clock)
        return spent

    def _advance(self, last: Solution, sums: EndSums, grid: tuple[float, float, int], n: int) -> tuple[Steps, Solution]:
        t0, h, first = grid
        e, s = self.found, self._struct
        next_ = self._begin(last, h)
        members = [np.empty((n, own.values["length"])) for own in self._own]
        given = [self._given(i, grid, n) for i in range(len(members))]
        for struct, rows, followed in zip(self._array, members, given, strict=True):
            struct.record = rows.ctypes.data
            struct.given = None if followed is None else followed.ctypes.data
        xi = np.empty((n, 2 * e.columns))
        trials, accepted = np.zeros(n, np.int32), np.zeros(n, np.int32)
        works = np.empty((n, e.size)) if self._works else None
        s.xi, s.trials, s.accepted = xi.ctypes.data, trials.ctypes.data, accepted.ctypes.data
        s.work = None if works is None else works.ctypes.data
        s.cost = self.pace.cost.ctypes.data if self.pace.measures else None
        samples = self._begin_held(n)
        done, spent = self._run(grid, n, next_)
        if self._signals and self._held and samples is not None:
            self._signals.took(samples[:done], self._before if self._held.known else None, self._held.last)
        self.taken += done
        self.pace.took(self.threads, done, np.maximum(trials[:done], 1), spent)
        self.failure = next((f for own in self._own if (f := own.failure())), None)
        if done == 0:
            return Steps.stacked([]), last
        for own, rows, u in zip(self._own, members, self._inputs, strict=True):
            own.finish(t0 + (first + done - 1) * h, h, rows[done - 1], u)
        names = len(self.joined.face.names)  # signals are no columns
        xi, end = xi[:done, :names], xi[:done, e.columns : e.columns + names]
        rows = self._steps([own.told(m[:done], h) for own, m in zip(self._own, members, strict=True)], xi, end, sums)
        if works is not None:
            rows["works"] = works[:done, e.unpacked]
        solution = self._solution(xi[done - 1].copy(), int(trials[done - 1]), str(ACCEPTED[accepted[done - 1]]), h)
        self._left = solution, h
        return Steps(**rows, iterations=trials[:done], accepted_by=ACCEPTED[accepted[:done]]), solution

    def _run(self, grid: tuple[float, float, int], n: int, next_: int) -> tuple[int, float]:
        """Steps that were taken, seconds.  A crash in a unit tells its name."""
        t0, h, first = grid
        for own in self._own:
            own.begin(n)
        with crew(self._lib, self.threads) as self._struct.crew, watched(self._own):
            begun = perf_counter()
            done = self._lib.ph_master_run(ctypes.addressof(self._struct), t0, h, n, first, next_)
            spent = perf_counter() - begun
        self._struct.crew = None
        return done, spent

    def _given(self, i: int, grid: tuple[float, float, int], n: int) -> Array | None:
        """Free inputs of a member at the nodes of n steps (n x k x nu) where some follow data."""
        followed, place = self.joined.followed, self.joined.places[i]
        if followed is None or not len(followed.own(place)):
            return None
        return followed.at_nodes(self.joined.free[place], place, nodes(self.found.parts[i].k).c, grid, n)

    def _begin(self, last: Solution, h: float) -> int:
        """The start of the first step; 1: the continuation of the step before, which is made there.

        Time decides where calls end, so it must not matter: what one has left, the next goes on from.
        """
        if self._left is not None and self._left[0] is last and self._left[1] == h:
            return 1
        return int(self._solver.begin(self._struct, last, h))

    def _solution(self, xi: Array, trials: int, accepted_by: str, h: float) -> Solution:
        if self.failure:  # nobody goes on from here
            return Solution(xi, np.zeros(len(self.joined.free)), trials, accepted_by)
        y = np.concatenate([p.member.output() for p in self.found.parts])
        return self._solver.solution(self._struct, Solution(xi, y, trials, accepted_by), h)

    def _steps(self, members: list[Told], xi: Array, end: Array, sums: EndSums) -> dict[str, Any]:
        """Fields of `Steps` from what was recorded."""
        signals = [*(m.columns for m in members), xi, sums.of_rows(end, np.hstack([m.ends for m in members]))]
        rows = {"signals": np.hstack(signals), "H": np.hstack([m.H for m in members])}
        return rows | {name: np.hstack([m.books[name] for m in members]) for name in LEDGER}

    # -- structures -----------------------------------------------------------------------------------------------

    def _share(self, i: int, own: Own) -> Any:
        part, nu = self.found.parts[i], self.found.parts[i].member.nu
        kn, all_ = part.k * nu, part.directions
        self._inputs.append(np.zeros(kn))
        values = own.values | {
            "nu": nu, "k": part.k,
            "ninput": len(part.inputs), "nkick": part.kicks, "nbare": len(part.kicked), "ncol": len(part.col),
            "nrow": len(part.row), "nright": len(part.right), "nleft": len(part.left), "col": part.col, "row": part.row,
            "entry": self._pattern.entries[i], "input": part.inputs, "kicked": part.kicked,
            "kicked_output": part.kicked_output, "right_direction": part.right_direction,
            "right_col": part.right_col, "right": part.right, "left_output": part.left_output, "left_row": part.left_row,
            "left": part.left, "jump_entry": _jump_entries(part, self.found), "weights": part.weights,
            "at_end": nodes(part.k).value(1.0), "nominal": np.asarray(part.member.nominal, float), "now": np.zeros(nu),
            "free": self.joined.free[self.joined.places[i]].ctypes.data,
            "told": np.zeros(len(part.told)), "taken": self._taken[i], "given": None,
            "u": self._inputs[-1], "s": np.zeros(2 * part.kicks),
            "y": np.zeros(kn + nu), "dy": np.zeros((all_, kn)), "dend": np.zeros((all_, nu)),
            "across": np.zeros((len(part.row), all_)), "jump": np.zeros(part.kicks**2), "record": None, "clock": None,
        }  # fmt: skip
        return self.memory.fill("ph_share", values)

    def _held_wires(self, signals: HeldSignals) -> Any:
        e, joined, wires = self.found, self.joined, signals.held
        own = {m.name: i for i, m in enumerate(joined.members)}
        first, n = [p.start for p in joined.places], len(wires)
        source, target = (
            [own[name] for name in names] for names in zip(*((w.source, w.target) for w in wires), strict=True)
        )
        port = [joined.taken.get((w.target, w.input), -1) for w in wires]
        values = {
            "n": n, "nstage": len(signals.stages), "stage": np.cumsum([0, *map(len, signals.stages)]), "source": source,
            "told": [e.parts[i].told.index(w.output) for i, w in zip(source, wires, strict=True)], "target": target,
            "taken": [e.parts[i].taken.index(w.input) if p < 0 else -1 for i, p, w in zip(target, port, wires, strict=True)],
            "input": [p - first[i] if p >= 0 else 0 for i, p in zip(target, port, strict=True)],
            "factor": [w.factor for w in wires], "offset": [w.offset for w in wires], "low": signals.limits[0],
            "high": signals.limits[1], "extrapolated": signals.extrapolated, "known": 0, "known_kept": 0, "last": 0.0,
            "last_kept": 0.0, "now": joined.sampled, "before": np.zeros(n), "row": None,
            **{name: np.zeros(n) for name in ("now_kept", "before_kept", "values")},
        }  # fmt: skip
        self._before: Array = values["before"]
        return self.memory.fill("ph_held", values)

    def _begin_held(self, n: int) -> Array | None:
        """Room for the samples of n steps; what members have taken is what was sampled last."""
        signals, struct = self._signals, self._held
        if signals is None or struct is None:
            return None
        struct.known = signals.before is not None
        if signals.before is not None:
            self._before[:], struct.last = signals.before, signals.last
        for w, value in zip(signals.held, self.joined.sampled, strict=True):
            i = next(i for i, m in enumerate(self.joined.members) if m.name == w.target)
            if w.input in (own := self.found.parts[i].taken):
                self._taken[i][own.index(w.input)] = value
        rows = np.zeros((n, len(signals.held)))
        struct.row = rows.ctypes.data
        return rows

    def _rules(self) -> dict[str, Any]:
        return {"held": self._solver.held, "iterations": self._solver.iterations}

    def _values(self) -> dict[str, Any]:
        e, p, n = self.found, self._pattern, self.found.size
        square = int(e.square[-1])
        angles = (2 * np.arange(POINTS) + 1) * np.pi / (4 * POINTS)
        nominal = np.full(e.columns, np.inf)  # signals are no columns
        nominal[: len(self.joined.face.names)] = self.joined.face.nominal
        work = {name: np.zeros(n) for name in ("rows", "size", "move", "scale", "plain")}
        work |= {name: np.zeros(square) for name in ("S0", "S1", "mixed", "T")}
        work |= {name: np.zeros(len(e.bare)) for name in ("moved", "sums")}
        work |= {"a": p.a, "scaled": np.zeros(len(p.rowind))}
        lu = np.zeros(self._lib.ph_master_lu_size(n, len(p.rowind), p.capacity) // 8 + 1)
        return work | self._solver.fields | {
            "solver": getattr(self._lib, f"ph_solver_{self._solver.name}")(),
            "held": None if self._held is None else ctypes.addressof(self._held),
            "rules": ctypes.addressof(self.rules), "shares": self._array,
            "nshare": len(e.parts), "nxi": e.nodes, "nbare": len(e.bare), "ncolumn": e.columns, "nskew": len(e.skew),
            "ncluster": len(e.cluster) - 1, "nahead": len(e.ahead), "nnz": len(p.rowind), "capacity": p.capacity,
            "nwire": len(e.wires), "factor": e.factors,
            **{f"wire_{name}": e.wires[:, i].copy() for i, name in enumerate(("source", "output", "target", "input"))},
            "points": POINTS, "cosines": np.cos(angles) ** 2, "weights": e.weights, "at_end": e.at_ends,
            "at_begin": e.at_starts, "nominal": nominal, "column": e.column,
            "tried": np.zeros(2 * START_TRIALS * e.columns), "refused": 0,
            "bare_column": e.bare, "skew_row": e.skew_row, "skew_col": e.skew_col, "skew_entry": p.skew, "skew": e.skew,
            "least": e.least, "cluster": e.cluster, "square": e.square, "law_entry": p.law, "own_entry": p.own,
            "signs": e.signs, "ahead_to": e.ahead_to, "ahead_from": e.ahead_from, "ahead": e.ahead,
            "colptr": p.colptr, "rowind": p.rowind, "order": p.order, "prefer": p.prefer, "z": self._z,
            "known": 0, "row": 0,
            "lu": lu, "crew": None,
            "status": np.zeros(len(e.parts), np.int32), "cost": None, "clock": None, "xi": None, "work": None, "trials": None,
            "accepted": None,
        }  # fmt: skip


def _jump_entries(part: Part, found: Exchanged) -> Array:
    """Places of the S of a member among the blocks of all clusters, -1: at no bare node."""
    cluster = np.searchsorted(found.cluster, part.bare, "right") - 1
    at = np.where(part.bare >= 0, part.bare - found.cluster[cluster], -1)
    width = np.diff(found.cluster)[cluster[part.bare >= 0][:1]] if len(part.bare) else 0
    entries = found.square[cluster][:, None] + at[:, None] * width + at
    return np.where((at[:, None] >= 0) & (at >= 0), entries, -1).astype(np.int32).ravel()


def master(
    joined: Joined,
    coupling: Coupling,
    works: bool = False,
    threads: int | None = None,
    signals: HeldSignals | None = None,
) -> Master | None:
    """The compiled twin of a coupling; None for couplings, or members, that have none.

    What is done with steps that do not converge is done in Python, with these only.  `works`: whether energies of unknowns at
    their junctions are wanted;  `threads`: None chooses;  `signals`: those that are held over steps.
    """
    coupling = plain(coupling)
    if solver_of(coupling) is None:
        return None
    makes = [make for m in joined.members if (make := own_share(m))]
    if len(makes) < len(joined.members):
        return None
    try:
        held = signals.held if signals else ()
        return Master(joined, coupling, exchanged(joined, coupling, held), makes, works, threads, signals)
    except StructurallySingular:  # the twin tells where
        return None
