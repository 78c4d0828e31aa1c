"""The compiled master: members stepped and joined without returning to Python but for those that only Python can step.

One loop for all couplings, which are solvers of it (`solvers.py`).  A step that a member refuses, or whose rows do not converge,
ends a call with all members at its start, and is told as an exception.
"""

from __future__ import annotations

import ctypes
from collections.abc import Callable, Sequence
from dataclasses import replace
from time import perf_counter
from typing import Any

import numpy as np
from numpy.typing import NDArray

from phfmu.engine.native.structures import Structures
from phfmu.gradients.quadrature import nodes
from phfmu.network.couplings.acceptance import ACCEPTED
from phfmu.network.couplings.compiled.called_share import EXCHANGED, CalledShare
from phfmu.network.couplings.compiled.master_library import HEADER, START_TRIALS, library
from phfmu.network.couplings.compiled.master_pattern import (
    ExchangeTables,
    MasterPattern,
    MemberRows,
    ShareTables,
    exchange_tables,
)
from phfmu.network.couplings.compiled.shares import ShareMaker, ShareMemory, own_share, watched
from phfmu.network.couplings.compiled.solvers import MasterSolver, SolverTables, solver_of
from phfmu.network.couplings.compiled.threads import ThreadNumber, crew
from phfmu.network.couplings.coupling import Coupling, Solution, Unconverged
from phfmu.network.couplings.newton import Newton
from phfmu.network.couplings.signals.sampled_signals import SampledSignals
from phfmu.network.couplings.unconverged import AcceptingPolicy, plain
from phfmu.network.interface.coupled_members import CoupledMembers
from phfmu.network.interface.instant import InstantSolver, regular
from phfmu.network.interface.junction_values import JunctionValues
from phfmu.network.members.member import Member
from phfmu.outcome.status import Status, StepFailure
from phfmu.outcome.steps import StepEvent, Steps
from phfmu.plan.ordering import StructurallySingular
from phfmu.schemes.constraints.impulses import POINTS

Array = NDArray[Any]

#: what `timed` tells of, as `ph_part` does
PARTS = ("join", "steps", "exchange", "solve", "readings")
LEDGER = ("stored", "dissipated", "supplied", "numerical", "moved", "pairs")


class Master:
    """Compiled steps of `joined` under `coupling`; ledger rows and columns are those of `Coupled`."""

    def __init__(
        self,
        joined: CoupledMembers,
        coupling: Coupling,
        found: ExchangeTables,
        makes: Sequence[ShareMaker],
        works: bool = False,
        threads: int | None = None,
        signals: SampledSignals | None = None,
    ):
        self.joined, self.coupling, self.found, self._works = joined, plain(coupling), found, works
        self._keeps = isinstance(coupling, AcceptingPolicy)
        #: why the last call did not take all of its steps;  whether the member that refused takes the step when asked again
        self.refusal: BaseException | None = None
        self.passing = False
        self._pattern, self.memory = MasterPattern(found), Structures(HEADER)
        self._lib = library()
        self._inputs, self._shares = list[Array](), list[dict[str, Any]]()
        #: held signals that members take but by ports, as they are now
        self._taken = [np.zeros(len(p.taken)) for p in found.parts]
        self._own = [make(p, self.memory, self._lib) for make, p in zip(makes, found.parts, strict=True)]
        #: whether some are stepped in Python, by one thread
        self.calls = any(isinstance(own, CalledShare) for own in self._own)
        #: threads used last
        self.thread_number, self.threads = ThreadNumber(len(found.parts), 1 if self.calls else threads), 1
        self._signals, self._held = signals, None if signals is None else self._held_wires(signals)
        shares = [self._share(i, own) for i, own in enumerate(self._own)]
        tables = SolverTables(joined, found, self._pattern, self.memory, self._lib, np.zeros(found.size))
        self._z = tables.z
        self._solver: MasterSolver = solver_of(self.coupling)(self.coupling, tables)
        #: the solution and length of the last step that was taken here, which the memory of the loop goes on from
        self._left: tuple[Solution, float] | None = None
        #: steps that were taken here;  rules of the iteration (`ph_rules`)
        self.taken, self.rules = 0, self.memory.fill("ph_rules", self._rules())
        self._array = self.memory.array(shares)
        self._struct = self.memory.fill("ph_master", self._values())
        self._lib.ph_master_lu_init(ctypes.addressof(self._struct))

    def advance(
        self, last: Solution, sums: JunctionValues, grid: tuple[float, float, int], n: int
    ) -> tuple[Steps, Solution]:
        """Take n steps k = first.. from t0 + k h (grid: t0, h, first); the accepted ones, and the solution at their end.

        `refusal` is the failure that ended them early, None if all were accepted.
        """
        t0, h, first = grid
        parts, self.refusal = list[Steps](), None
        while n:
            k, self.threads = self.thread_number.part(n)
            steps, last = self._advance(last, sums, (t0, h, first), k)
            if len(steps.H):
                parts.append(steps)
            first, n = first + k, n - k if len(steps.H) == k else 0
        return Steps.joined(parts) if parts else Steps.stacked([]), last

    def recorded(self, sums: JunctionValues, t: float, h: float, steps: Steps) -> Steps:
        """The record of the one step that was taken last, from t by h, read again from members that have changed since."""
        for own in self._own:
            own.begin(1)
        rows = [np.empty((1, own.values["length"])) for own in self._own]
        for struct, row in zip(self._array, rows, strict=True):
            struct.record = row.ctypes.data
        if self._lib.ph_shares_finish(ctypes.addressof(self._struct), 0):
            raise self._refused(t, h)
        n, e = len(self.joined.face.names), self.found.columns
        xi, members, works = self._xi[:, :n], self._told(rows, t, h), steps.works
        told = self._steps(members, xi, self._xi[:, e : e + n], sums, h)
        if works is not None:
            missed = self._estimated(members, xi, h)
            works = np.hstack([works[:, : works.shape[1] - sum(m.shape[1] for m in missed)], *missed])
        return replace(
            steps, signals=told["signals"], H=told["H"], events=told["events"], works=works,
            **{k: told[k] for k in (*LEDGER, EXCHANGED) if k in told},
        )  # fmt: skip

    def prepare(self, guess: Array, t0: float, h: float, limit: bool = True) -> tuple[Array, Array] | None:
        """Junction unknowns before the first step: means of a trial step, and those of the instant.

        guess:  where the trial starts from;  limit: whether those of the instant are the limit of short steps, or the same means
        The members stay where they are.  None: `refusal` says why.
        """
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
        self._left = None
        for own in self._own:
            own.begin(1)
        self._solver.begin(self._struct, Solution(guess), h)
        arrays = (start.ctypes.data, mean.ctypes.data, begin.ctypes.data)
        with watched(self._own):
            status = self._lib.ph_master_prepare(ctypes.addressof(s), t0, h, START_TRIALS if limit else 1, *arrays)
        del samples
        self.refusal = self._refused(t0, h) if status else None
        return None if status else (mean[:n], begin[:n])

    @property
    def solver(self) -> str:
        """Name of its solver, less `ph_solver_`."""
        return self._solver.name

    @property
    def unknowns(self) -> Array:
        """z = (xi at nodes | impulses at start | at end) of the step that was taken last."""
        return self._z

    def spread(self, xi: Array) -> Array:
        """Values of all columns, those of junctions being xi."""
        return self._solver.spread(xi)

    def timed(self) -> Array:
        """Seconds of PARTS, to which the loop adds from now on, where one thread runs it; its clock is read twice a call."""
        spent = np.zeros(len(PARTS))
        clock = self.memory.fill("ph_clock", {"spent": spent, "last": 0.0, "lap": 0.0, "part": 0})
        for struct in (self._struct, *self._array):
            struct.clock = ctypes.addressof(clock)
        return spent

    def _advance(
        self, last: Solution, sums: JunctionValues, grid: tuple[float, float, int], n: int
    ) -> tuple[Steps, Solution]:
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
        s.cost = self.thread_number.cost.ctypes.data if self.thread_number.measures else None
        samples = self._begin_held(n)
        done, spent = self._run(grid, n, next_)
        if self._signals and self._held and samples is not None:
            self._signals.took(samples[:done], self._before if self._held.known else None, self._held.last)
        self.taken += done
        self.thread_number.took(self.threads, done, np.maximum(trials[:done], 1), spent)
        t = t0 + (first + done) * h
        self.refusal = self._refused(t, h) if done < n else None
        if done == 0:
            return Steps.stacked([]), last
        for own, rows, u in zip(self._own, members, self._inputs, strict=True):
            own.finish(t0 + (first + done - 1) * h, h, rows[done - 1], u)
        names, self._xi = len(self.joined.face.names), xi[done - 1 : done]  # signals are no columns
        xi, end = xi[:done, :names], xi[:done, e.columns : e.columns + names]
        told = self._told([m[:done] for m in members], t0 + first * h, h)
        rows = self._steps(told, xi, end, sums, h)
        if works is not None:
            rows["works"] = np.hstack([works[:done, e.unpacked], *self._estimated(told, xi, h)])
        solution = Solution(xi[-1].copy(), end[-1].copy(), h, self._solver.memory(self._struct))
        self._left = solution, h
        by = np.array(ACCEPTED)[accepted[:done]] if self._solver.words else None
        return Steps(**rows, iterations=trials[:done], accepted_by=by), solution

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

    def _told(self, members: list[Array], t: float, h: float) -> list[MemberRows]:
        """Fields of the rows of all members, of steps from t."""
        return [own.told(m, t, h) for own, m in zip(self._own, members, strict=True)]

    def _steps(
        self, members: list[MemberRows], xi: Array, end: Array, sums: JunctionValues, h: float
    ) -> dict[str, Any]:
        """Fields of `Steps` from what was recorded."""
        signals = [*(m.columns for m in members), xi, sums.of_rows(end, np.hstack([m.ends for m in members]))]
        rows = {"signals": np.hstack(signals), "H": np.hstack([m.H for m in members])}
        rows |= {name: np.hstack([m.books[name] for m in members]) for name in LEDGER}
        if any(EXCHANGED in m.books for m in members):
            rows[EXCHANGED] = np.hstack([m.books.get(EXCHANGED, m.books["pairs"]) for m in members])
        return rows | {"events": tuple(self._events(members))}

    def _events(self, members: list[MemberRows]) -> list[tuple[int, StepEvent]]:
        """Events within the steps, by number of the step and in order of time; energies by component of all."""
        n, found = len(self.joined.booking.components), list[tuple[int, StepEvent]]()
        for part, m in zip(self.found.parts, members, strict=True):
            own = self.joined.components(part.member.name) if m.events else slice(0, 0)
            for i, e in m.events:
                energy, lost = np.zeros((2, n))
                energy[own], lost[own] = e.energy, e.lost
                found.append((i, replace(e, energy=energy, lost=lost)))
        return sorted(found, key=lambda f: (f[0], f[1].t))

    def _estimated(self, members: list[MemberRows], xi: Array, h: float) -> list[Array]:
        """Energies at junctions that predictions of members miss, by column [J], if there are such members."""
        if not self.joined.put_off:
            return []
        missed = [
            np.zeros((len(xi), p.member.nu)) if m.missed is None else m.missed
            for p, m in zip(self.found.parts, members, strict=True)
        ]
        return [h * xi * np.array([self.joined.face.summed(y) for y in np.hstack(missed)])]

    # -- refusals -------------------------------------------------------------------------------------------------

    def _refused(self, t: float, h: float) -> BaseException:
        """Why the step from t by h, of which the members are at the start, was not taken."""
        status, self.passing = list(Status)[self._struct.refused], False
        told = next((f for own in self._own if (f := own.failure())), self._solver.failure)
        if told is not None:
            return told
        for i in np.flatnonzero(self._status).tolist():
            return self._of_member(i, t, h, status)
        if not self._solver.words:
            return self._of_instant(t, h, status)
        e, s, n = self.found, self._struct, self.found.nodes
        rows, size, z = (np.ctypeslib.as_array(self._arrays[name]) for name in ("rows", "size", "z"))
        left = np.abs(rows[: n + len(e.bare)])
        scaled = np.nan_to_num(left / (size[: len(left)] + e.least), nan=np.inf)
        worst = int(np.argmax(scaled)) if len(scaled) else 0
        names = column_names(self.joined, self.coupling)
        name = names[int([*e.column, *e.bare][worst])] if len(scaled) else ""
        history = self._arrays["history"][: s.ntrial].tolist()
        last = ", ".join(f"{v:.3g}" for v in history[-3:])
        row = f"junction row of {name}{self._at(worst)} = {z[worst] if worst < n else 0.0:.6g}"
        return Unconverged(
            status, self.joined.network.name, t, h, equation=row, residual=float(left[worst]) if len(left) else float("nan"),
            iterations=len(history), tried=f"{self._solver.words} (last scaled residuals {last}); all members are back at t",
            joined=True, history=history, composable=self.joined.network.composable,
        )  # fmt: skip

    def _at(self, row: int) -> str:
        """Place of a row in the step, in words."""
        if row >= self.found.nodes:
            return " at the end of the step"
        column = self.found.column[row]
        first = int(np.argmax(self.found.column == column))
        return "" if self._solver.held else f" at node {row - first + 1}"

    def _of_member(self, i: int, t: float, h: float, status: Status) -> BaseException:
        """The refusal of a member that does not say why: it is asked once more from Python, and brought back."""
        part, inputs = self.found.parts[i], self._inputs[i].reshape(self.found.parts[i].k, -1).copy()
        s = self._shares[i]["s"]
        state = part.member.get_state()
        try:
            part.values.step(inputs, (s[: part.kicks].copy(), s[part.kicks :].copy()) if part.kicks else None, t, h)
            part.member.end_output()
            part.member.energies()
            part.member.read()
        except BaseException as error:
            return error
        finally:
            part.member.set_state(state)
        self.passing = True
        name = part.member.name or self.joined.network.name
        return StepFailure(status, name, t, h, tried="the step of this member, under the inputs that the others give")

    def _of_instant(self, t: float, h: float, status: Status) -> BaseException:
        """The refusal of a coupling that solves for the junctions at the start of the step."""
        xi = self._z[: len(self.joined.face.names)].copy()
        try:
            self.joined.apply(xi)
            regular(self.joined, self.joined.instant_matrix(xi))
            InstantSolver().solve(self.joined, xi, t)
        except (StepFailure, ValueError) as error:
            return error
        return StepFailure(status, self.joined.network.name, t, h, joined=True, tried="the junctions at one instant")

    # -- structures -----------------------------------------------------------------------------------------------

    def _share(self, i: int, own: ShareMemory) -> Any:
        part = self.found.parts[i]
        nu, kn, all_ = part.nu, part.k * part.nu, part.directions
        self._inputs.append(np.zeros(kn))
        values = own.values | {
            "nu": nu, "k": part.k,
            "ninput": len(part.inputs), "nkick": part.kicks, "nbare": len(part.kicked), "ncol": len(part.col),
            "nrow": len(part.row), "nright": len(part.right), "nleft": len(part.left), "col": part.col, "row": part.row,
            "entry": self._pattern.entries[i], "input": part.inputs, "kicked": part.kicked,
            "kicked_output": part.kicked_output, "right_direction": part.right_direction,
            "right_col": part.right_col, "right": part.right, "left_output": part.left_output, "left_row": part.left_row,
            "left": part.left, "jump_entry": _jump_entries(part, self.found), "weights": part.weights,
            "at_end": nodes(part.k).value(1.0), "nominal": _padded(part.member.nominal, nu), "now": np.zeros(nu),
            "free": self._free(i),
            "told": np.zeros(len(part.told)), "taken": self._taken[i], "given": None,
            "u": self._inputs[-1], "s": np.zeros(2 * part.kicks),
            "y": np.zeros(kn + nu), "dy": np.zeros((all_, kn)), "dend": np.zeros((all_, nu)),
            "across": np.zeros((len(part.row), all_)), "jump": np.zeros(part.kicks**2), "record": None, "clock": None,
        }  # fmt: skip
        own.bind(values)
        self._shares.append(values)
        return self.memory.fill("ph_share", values)

    def _free(self, i: int) -> Any:
        """Inputs that nothing feeds, where they are; a relation has none."""
        free = self.joined.free[self.joined.places[i]]
        return free.ctypes.data if self.found.parts[i].nu == len(free) else np.zeros(self.found.parts[i].nu)

    def _held_wires(self, signals: SampledSignals) -> Any:
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
            "high": signals.limits[1], "extrapolated": int(signals.extrapolated), "known": 0, "known_kept": 0, "last": 0.0,
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
        solver = self._solver
        repeated = self.joined.repeated
        trials = {"held": solver.held, "iterations": solver.iterations, "sweeps": solver.sweeps}
        return trials | {"accept": self._keeps or repeated > 0.0, "repeated": repeated}

    def _values(self) -> dict[str, Any]:
        e, p, n = self.found, self._pattern, self.found.size
        square = int(e.square[-1])
        angles = (2 * np.arange(POINTS) + 1) * np.pi / (4 * POINTS)
        nominal = np.full(e.columns, np.inf)  # signals are no columns
        nominal[: len(self.joined.face.names)] = self.joined.face.nominal
        work: dict[str, Any] = {name: np.zeros(n) for name in ("rows", "size", "move", "scale", "plain", "best")}
        work["history"] = np.zeros(self._solver.iterations)
        work |= {name: np.zeros(square) for name in ("S0", "S1", "mixed", "T")}
        work |= {name: np.zeros(len(e.bare)) for name in ("moved", "sums")}
        work |= {"a": p.a, "scaled": np.zeros(len(p.rowind))}
        self._status = np.zeros(len(e.parts), np.int32)
        lu = np.zeros(self._lib.ph_master_lu_size(n, len(p.rowind), p.capacity) // 8 + 1)
        if name := self._solver.name:
            work["solver"] = getattr(self._lib, f"ph_solver_{name}")()
        work |= self._solver.fields
        self._arrays = work | {"z": self._z}
        return work | {
            "held": None if self._held is None else ctypes.addressof(self._held),
            "rules": ctypes.addressof(self.rules), "shares": self._array,
            "nshare": len(e.parts), "nxi": e.nodes, "nbare": len(e.bare), "ncolumn": e.columns, "nskew": len(e.skew),
            "ncluster": len(e.cluster) - 1, "nahead": len(e.ahead), "nnz": len(p.rowind), "capacity": p.capacity,
            "nwire": len(e.wires), "factor": e.factors,
            **{f"wire_{name}": e.wires[:, i].copy() for i, name in enumerate(("source", "output", "target", "input"))},
            "points": POINTS, "cosines": np.cos(angles) ** 2, "weights": e.weights, "at_end": e.at_ends,
            "node": np.concatenate([np.zeros(0), *(nodes(int(k)).c for k in np.bincount(e.column))]),
            "at_begin": e.at_starts, "nominal": nominal, "column": e.column,
            "tried": np.zeros(2 * START_TRIALS * e.columns), "refused": 0,
            "bare_column": e.bare, "skew_row": e.skew_row, "skew_col": e.skew_col, "skew_entry": p.skew, "skew": e.skew,
            "least": e.least, "cluster": e.cluster, "square": e.square, "law_entry": p.law, "own_entry": p.own,
            "signs": e.signs, "ahead_to": e.ahead_to, "ahead_from": e.ahead_from, "ahead": e.ahead,
            "colptr": p.colptr, "rowind": p.rowind, "order": p.order, "prefer": p.prefer, "z": self._z,
            "known": 0, "row": 0, "ntrial": 0, "time": 0.0, "length": 0.0,
            "lu": lu, "crew": None,
            "status": self._status, "cost": None, "clock": None, "xi": None, "work": None, "trials": None,
            "accepted": None,
        }  # fmt: skip


def _jump_entries(part: ShareTables, found: ExchangeTables) -> Array:
    """Places of the S of a member among the blocks of all clusters, -1: at no bare node."""
    cluster = np.searchsorted(found.cluster, part.bare, "right") - 1
    at = np.where(part.bare >= 0, part.bare - found.cluster[cluster], -1)
    width = np.diff(found.cluster)[cluster[part.bare >= 0][:1]] if len(part.bare) else 0
    entries = found.square[cluster][:, None] + at[:, None] * width + at
    return np.where((at[:, None] >= 0) & (at >= 0), entries, -1).astype(np.int32).ravel()


def column_names(joined: CoupledMembers, coupling: Coupling) -> Sequence[str]:
    """Names of junction variables, then of signals and unknowns of relations that are exchanged at nodes."""
    exchange = coupling.exchange if isinstance(coupling, Newton) else None
    return exchange.names if exchange else joined.face.names


def _padded(values: Array, n: int) -> Array:
    return np.append(np.asarray(values, float), np.ones(n - len(values)))


def master(
    joined: CoupledMembers,
    coupling: Coupling,
    works: bool = False,
    threads: int | None = None,
    signals: SampledSignals | None = None,
    share: Callable[[Member], ShareMaker] | None = None,
) -> Master:
    """The compiled steps of members under a coupling; what is done with steps that do not converge is asked of its policy.

    `works`: whether energies of unknowns at their junctions are wanted;  `threads`: None chooses;  `signals`: those that are held
    over steps by the master, None: by others, or there are none;  `share`: makes the share of a member, None: as runs
    have it.

    Errors: StepFailure where the rows of the junctions cannot be solved whatever the members do.
    """
    makes = [(share or own_share)(m) for m in joined.members]
    held = signals.held if signals else ()
    found = exchange_tables(joined, plain(coupling), held)
    try:
        return Master(joined, coupling, found, makes, works, threads, signals)
    except StructurallySingular as error:
        names = column_names(joined, plain(coupling))
        columns = [*found.column, *found.bare, *found.bare]
        rows = dict.fromkeys(str(names[columns[r]]) for r in error.rows)
        raise Unconverged(
            Status.SINGULAR, joined.network.name, 0.0, 0.0, equation=f"junction row of {', '.join(rows)}", joined=True,
            composable=joined.network.composable, tried="the rows of the junctions before the first step",
        ) from None  # fmt: skip
