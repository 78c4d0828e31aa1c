"""Members stepped apart: the run loop drives them like a single model; a coupling finds what they exchange."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from dataclasses import replace
from functools import cached_property
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from phfmu.engine.record import StepGrid
from phfmu.engine.rest_changes import RestChange
from phfmu.interrupt import Interrupted
from phfmu.network.couplings.acceptance import HALVED
from phfmu.network.couplings.coupling import AllSteps, Coupling, Solution, Step, Unconverged, solves_rows
from phfmu.network.couplings.growth import EnergyGrowth, SignalGrowth
from phfmu.network.couplings.junction_works import JunctionWorks
from phfmu.network.couplings.landing.landings import landings
from phfmu.network.couplings.newton import Newton, newton
from phfmu.network.couplings.signals.agreed_signals import AgreedSignals, SignalsApart
from phfmu.network.couplings.signals.sampled_signals import SampledSignals, SignalExchange
from phfmu.network.couplings.unconverged import AcceptingPolicy, HalvingPolicy, in_halves, plain
from phfmu.network.impulses.jumps_apart import JumpsApart
from phfmu.network.interface.coupled_members import CoupledMembers
from phfmu.network.interface.instant import InstantSolver
from phfmu.network.interface.junction_values import JunctionValues
from phfmu.network.interface.prescribed_inputs import PrescribedInputs
from phfmu.network.interface.whole_columns import WholeColumns
from phfmu.network.members.engine_member import EngineMember
from phfmu.network.members.member import Member
from phfmu.network.network import Network
from phfmu.outcome.status import EndRequested, StepFailure
from phfmu.outcome.steps import Steps
from phfmu.schemes.scheme import Scheme
from phfmu.signals import SignalKind, of_member

if TYPE_CHECKING:
    from phfmu.discretise.start import Projection
    from phfmu.network.couplings.compiled.master import Master
    from phfmu.network.couplings.compiled.shares import ShareMaker
    from phfmu.network.couplings.landing.composed_lander import ComposedLander
    from phfmu.network.couplings.stepper import Landing
    from phfmu.network.members.interpolant import Interpolant

Array = NDArray[Any]


class Coupled:
    """Members of a network, one per member, joined by a coupling; `last`: its junction unknowns for the step before.

    threads:  so many step native members between them, None: as many as pay; results do not depend on it
    signals:  over a step those that are not exchanged at nodes are on the line through two samples, the last one ("held"),
              or a mean that is iterated ("agreed", where the coupling repeats steps and all members take them back; with
              "agreed-or-extrapolated" the line where none agrees)
    """

    what = "members stepped apart"
    CARRIED = (
        "joined", "last", "booking", "unknowns_told", "_growth", "_signals", "_agreed", "_apart", "_grown", "_sums", "_at_start",
        "_lander",
    )  # fmt: skip

    def __init__(
        self,
        network: Network,
        members: list[Member],
        coupling: Coupling | Callable[[CoupledMembers], Coupling] = newton,
        threads: int | None = None,
        signals: SignalExchange = "extrapolated",
    ):
        #: the coupling, or what makes it of the joined members
        self.made_by = coupling
        self._threads, self.instead = threads, network.to_compose
        self._signals_are: SignalExchange = signals
        self.joined = CoupledMembers(network, members)
        self.coupling = coupling(self.joined) if callable(coupling) else coupling
        closes = self.coupling.closes and not self.joined.put_off and not self.joined.repeated
        self._growth = None if closes else EnergyGrowth(self.joined)
        face, inner = self.joined.face, plain(self.coupling)
        self.last = Solution(face.start.copy())
        self._land_anew()
        #: the compiled steps, by the rows that relations have in the modes of switches
        self._masters: dict[bytes, Master] = {}
        self._mode = b""
        self.solves_rows = solves_rows(inner)
        self._works = JunctionWorks(self.joined, self._exchange, self.solves_rows)
        self.booking = replace(self.joined.booking, loose=not closes, parts=self._works.keys)
        at_nodes = self._exchange.wires if self._exchange else ()
        self._signals = SampledSignals(self.joined, at_nodes, extrapolated=signals != "held")
        can = self.coupling.repeats and not self.joined.put_off and self._signals.any_held
        self._agreed = AgreedSignals(self.joined, self._signals) if signals.startswith("agreed") and can else None
        self._apart = SignalsApart(self._signals)
        self._grown = SignalGrowth(self._signals.held)
        self._sums = JunctionValues(self.joined)
        self._jumps = JumpsApart(self.joined, self._sums)
        #: steps are to tell the unknowns of the members that engines step
        self.unknowns_told = False
        self._ended_by: BaseException | None = None
        self._at_start: Array | None = None  #: junction unknowns of the instant before the first step
        own = [*self.joined.names, *face.names, *self._sums.names]
        self._columns = WholeColumns(network, [m.name for m in members], own)
        self.names = self._columns.names

    def _land_anew(self) -> None:
        """Make the lander of all members anew, without any event before."""
        steps = AllSteps(self._all_step, lambda: (self.joined.states(), self.last), self._all_back)
        found = landings(self.joined, plain(self.coupling), steps, self._join)
        self._exchange, self._lander, self._switching = found

    def _all_step(self, t: float, h: float) -> bool:
        """Whether it went in one part."""
        self._row, self.last = self._taken(self.last, t, h)
        by = self._row.accepted_by
        return by is None or by[0] != HALVED

    def _all_back(self, saved: tuple[list[Any], Solution]) -> None:
        states, self.last = saved
        self.joined.restore(states)

    def kept(self) -> tuple[Any, ...]:
        """States of members, junction unknowns and signals, for `back`; all members save their states."""
        growth = self._growth and (self._growth.known, self._growth.had)
        return self.joined.states(), self.last, self._signals.state(), growth, self._at_start

    def back(self, kept: tuple[Any, ...]) -> None:
        """All members, junction unknowns and signals as they were kept."""
        states, self.last, samples, growth, self._at_start = kept
        self.joined.restore(states)
        self._signals.restore(samples)
        self._sums.forget()
        if self._growth is not None:
            self._growth.known, self._growth.had = growth

    def notes(self) -> list[str]:
        """Lines about the run so far: signals that grow without bound, steps in which they did not agree."""
        return [*self._grown.told.values(), *self._apart.told()]

    @property
    def lands(self) -> bool:
        """Whether steps end on the zeros of guards, all members together."""
        return self._lander is not None

    @property
    def switching(self) -> ComposedLander | None:
        """The lander of all members as their composed declaration, if they land so."""
        return self._switching

    @property
    def guards(self) -> int:
        """Number of guards on whose zeros all members end their steps together."""
        return 0 if self._lander is None else self._lander.guards

    def _join(self) -> None:
        """The rows of relations have changed."""
        assert self._exchange is not None
        C = self._exchange.C
        self._mode = b"".join(a.tobytes() for a in (C.indptr, C.indices, C.data))

    @property
    def master(self) -> Master:
        """The compiled steps; raises StepFailure where the rows of the junctions cannot be solved."""
        if self._mode not in self._masters:
            self._masters[self._mode] = self.compiled()
        return self._masters[self._mode]

    def compiled(self, share: Callable[[Member], ShareMaker] | None = None) -> Master:
        """A master of its own; `share`: makes the share of a member, None: as runs have it."""
        from phfmu.network.couplings.compiled.master import master

        held = self._signals if self.samples_inside else None
        return master(self.joined, self.coupling, bool(self._works.keys), self._threads, held, share)

    def across(self) -> list[str]:
        """State events inside the steps of members whose jumps would move what others share."""
        return self._jumps.across()

    @cached_property
    def samples_inside(self) -> bool:
        """Whether the compiled loop samples the signals: those that are not iterated, where all are held."""
        return self._signals.all_held and not self._agreed and not isinstance(self.coupling, HalvingPolicy)

    @property
    def _one_by_one(self) -> bool:
        """Whether Python has something to do between two steps."""
        sampled = self._signals.any_held and (not self.samples_inside or self._followed_through_ports)
        return self.master.calls or self.unknowns_told or sampled

    @property
    def _followed_through_ports(self) -> bool:
        return bool(self.joined.followed) and self._signals.into_ports

    @property
    def signals_held(self) -> bool:
        """Whether some signals are held over a step."""
        return self._signals.any_held

    @property
    def units(self) -> dict[str, str]:
        return dict.fromkeys(self._columns.totals, "J") | self.joined.units | self._sums.units

    @property
    def kinds(self) -> dict[str, SignalKind]:
        return {of_member(m.name, n): kind for m in self.joined.members for n, kind in m.kinds.items()}

    @property
    def labels(self) -> dict[str, str]:
        members = self.joined.members
        return {of_member(m.name, n): of_member(m.name, label) for m in members for n, label in m.labels.items()}

    def inputs(self) -> dict[str, float]:
        """Free inputs of the members, which neither junctions nor signals feed, as they are now."""
        return {n: value for n, value in self.joined.free_inputs().items() if not self._signals.feeds(n)}

    @property
    def free_inputs(self) -> dict[str, tuple[int, float]]:
        """Free inputs of ports, which may follow data: places among the inputs of all members, and signs."""
        places = self.joined.input_places()
        return {n: places[n] for n in self.inputs() if n in places}

    @property
    def followed(self) -> Interpolant | None:
        """Free inputs that follow data: at the nodes of steps where members take them there, else in their middle."""
        return self.joined.followed and self.joined.followed.data

    @followed.setter
    def followed(self, data: Interpolant | None) -> None:
        if data and self._switching:
            raise ValueError(self._switching.held_only)
        self.joined.followed = PrescribedInputs(data, self.free_inputs) if data else None

    @property
    def unwritten(self) -> list[str]:
        """Units whose states cannot be written to a file, and why."""
        return [m.unwritten for m in self.joined.members if m.unwritten]

    def hashed(self) -> dict[str, dict[str, float]]:
        """By member its states and its time, by their names in it."""
        return {m.name: m.hashed() for m in self.joined.members}

    @property
    def junctions(self) -> Array:
        """Junction unknowns of the last step, means and those at its end."""
        return np.concatenate([self.last.xi, self.last.end])

    @property
    def modes(self) -> tuple[int, ...]:
        """The modes of the members' switches."""
        if self._switching is not None:
            return self._switching.modes
        members = (m for m in self.joined.members if isinstance(m, EngineMember) and m.model.modes is not None)
        return tuple(mode for m in members for mode in m.instance.mode)

    def settable(self) -> list[str]:
        return self.joined.settable()

    def set_value(self, name: str, value: float) -> str:
        """Set a member's parameter or free input `member.name` and say which it is; KeyError names close ones."""
        if self._signals.feeds(name):
            raise KeyError(f"{name} is fed by a signal; it cannot be set")
        self._sums.forget()
        self._signals.forget()
        self.last = Solution(self.last.xi)  # what comes is not the continuation of the step before
        before = self.energies() if self._growth else None
        kind = self.joined.set_value(name, value, self.last.xi)
        if self.joined.booking.constants != self.booking.constants:
            self.booking = replace(self.booking, constants=self.joined.booking.constants)
        self._sample()
        if self._growth is not None:
            self._growth.given(self.energies() - before)
        return kind

    def read(self) -> Array:
        """Values of `names` now."""
        xi = end = self._at_start
        if xi is None or end is None:
            xi, end = self.last.xi, self._switching.xi if self._switching else self.last.end
        return self._columns.rows(np.concatenate([self.joined.read(), xi, self._sums.values(end)]))

    def energies(self) -> Array:
        return self.joined.energies()

    def rest_changes(self) -> dict[str, list[RestChange]]:
        return {m.name: m.rest_changes() for m in self.joined.members}

    def check_start(self) -> None:
        """InconsistentState if a member is off its constraints or joined flows (efforts) do not sum to zero."""
        for m in self.joined.members:
            m.check_start()
        self.joined.apply(self.last.xi)
        self._sample()
        if self._switching is None:  # else entering the first mode sees to that, and books it
            self._sums.require_zero(self.last.xi)

    def check_changed(self) -> None:
        if self._switching is not None:
            self._switching.check_changed()
        self.check_start()

    def project_start(self, t0: float, kept: Sequence[str] = ()) -> Projection | None:
        """Rows of states at junctions made zero by an impulse; what has moved.  ValueError with the remedy."""
        if self._switching is not None:
            return self._switching.project(t0, kept)
        from phfmu.network.impulses.impulsive_start import project_start

        self.last = Solution(self.last.xi)
        return project_start(self.joined, t0, kept)

    def prepare(self, t0: float, h: float) -> None:
        """Junction values before the first step: those of the instant, and for the iteration those of a trial step;
        where no rows are solved, those that the outputs at the start give.
        """
        if self._growth is not None:
            self._growth.given(self.energies())
        if self._switching is not None:
            self.last = Solution(self._switching.begin(h))
            self._at_start = self.last.xi
            return
        if not self.solves_rows and (self.master.calls or self.joined.put_off):
            self.last = Solution(InstantSolver().solve(self.joined, self.last.xi, t0))
            self.joined.begin(self.last.xi)
            return
        try:
            mean, begin = self._tried(t0, h)
        except EndRequested:  # the first step will tell
            self.joined.begin(self.last.xi)
            return
        self.last, self._at_start = Solution(mean), begin
        if not self.master.calls:
            self.joined.apply(begin)
            self._signals.sample(begin)
        self.joined.begin(begin)

    def _tried(self, t0: float, h: float) -> tuple[Array, Array]:
        """Junction unknowns of a trial step, which is taken back, and those of the instant.

        They are the limit of short steps; units of other tools are not asked for such where outputs follow the unknowns at once.
        """
        self._sums.values(self.last.xi)
        found = self.master.prepare(self.last.xi, t0, h, self.from_short_steps)
        if found is None:
            assert self.master.refusal is not None
            if not isinstance(self.coupling, HalvingPolicy):
                raise self._told(self.master.refusal, h)
            states = self.joined.states()
            try:
                _, solution = self._taken(self.last, t0, h)
            finally:
                self.joined.restore(states)
            found = solution.xi, solution.xi
        if self._sums.hide or not self.master.calls:
            return found
        try:
            return found[0], InstantSolver().solve(self.joined, found[0], t0)
        except (StepFailure, ValueError):  # outputs do not follow all of them
            return found

    @property
    def from_short_steps(self) -> bool:
        """Whether junction unknowns of the start are the limit of ever shorter steps, not those of one."""
        return not self.joined.put_off and bool(self._sums.hide or not self.master.calls)

    def _sample(self) -> None:
        """Signals at the present time, where no step is taken."""
        self._signals.sample(self.last.xi)
        if self._agreed is not None:
            self._agreed.at_instant(self.last.xi)

    def _told(self, failure: BaseException, h: float) -> BaseException:
        """Return the failure; that of an iteration which is given up names the units that do not repeat a step."""
        if isinstance(failure, Unconverged) and not failure.signals:
            failure.unsteady = self.joined.unsteady(h)
        return failure

    def _one(self, last: Solution, t: float, h: float) -> tuple[Steps, Solution]:
        """A step that goes on from `last`; where it is refused all members are at t again."""
        steps, found = self.master.advance(last, self._sums, (t, h, 0), 1)
        if not len(steps.H):
            assert self.master.refusal is not None
            raise self.master.refusal
        return steps, found

    def _taken(self, last: Solution, t: float, h: float) -> tuple[Steps, Solution]:
        """A step that goes on from `last`; in halves where it does not converge and that was asked for."""
        self._sums.find(last.xi)
        if not isinstance(self.coupling, HalvingPolicy):
            return self._one(last, t, h)
        return in_halves(self._one, self.joined.finish, last, t, h)

    def _stepped(self, step: Step) -> tuple[Steps, Solution]:
        """A step with the signals that it takes."""
        if self._agreed is None:
            return self._taken(self.last, step.t, step.h)
        last = self.last
        try:
            return self._agreed.step(step, last.xi, lambda s: self._taken(last, s.t, s.h), lambda found: found[1].end)
        except Unconverged as failure:
            if not failure.signals or self._signals_are != "agreed-or-extrapolated":
                raise
        self.joined.restore(step.states)
        self._agreed.found = None
        self._apart.take(step, last.xi)
        return self._taken(last, step.t, step.h)

    def advance(self, t0: float, h: float, n: int, first: int = 0) -> Steps:
        parts, done, self._at_start, self._ended_by = list[Steps](), 0, None, None
        while done < n:
            try:
                k = 1 if self._one_by_one else n - done
                if k > 1 and (taken := self._many((t0, h, first + done), k)):
                    parts.append(taken)
                    done += len(taken.H)
                    self._require_wanted(t0 + (first + done) * h)
                if self._ended_by is not None:
                    raise self._ended_by
                if k == 1 or done < n:  # what is left begins with the step that is to be halved, or that runs away
                    parts.append(self._single(t0 + (first + done) * h, h))
                    done += 1
                    self._require_wanted(t0 + (first + done) * h)
            except (StepFailure, Interrupted) as failure:
                failure.recorded = {"steps": Steps.joined(parts)} if parts else {}
                raise
        return Steps.joined(parts)

    def _require_wanted(self, t: float) -> None:
        """EndRequested after a step that was taken, at whose end a unit asks to end the simulation."""
        if names := self.joined.ended:
            raise EndRequested(names, t, 0.0, t)

    def _many(self, grid: tuple[float, float, int], n: int) -> Steps | None:
        """Take up to n steps without returning to Python, as far as they are accepted and do not run away; None if none is.

        `_ended_by`: the failure of the step behind them, if it is refused for good.
        """
        self._sums.find(self.last.xi)
        last, states, samples = self.last, self.joined.states() if self._growth else None, self._signals.state()
        steps, self.last = self.master.advance(last, self._sums, grid, n)
        done = len(steps.H)
        if self._growth and states and done and (fine := self._growth.within(steps.H, steps.pairs)) < done:
            self.joined.restore(states)
            self._signals.restore(samples)
            steps, self.last = self.master.advance(last, self._sums, grid, fine)
        if self.master.refusal and not self.master.passing and not isinstance(self.coupling, HalvingPolicy):
            self._ended_by = self._told(self.master.refusal, grid[1])
        self._watch_signals(grid, len(steps.H))
        return self._rows(steps) if len(steps.H) else None

    def _watch_signals(self, grid: tuple[float, float, int], done: int) -> None:
        """After steps in which the master has exchanged the signals."""
        t0, h, first = grid
        if self.samples_inside and self._signals.any_held:
            for i, values in enumerate(self._signals.rows):
                self._grown.watch(t0 + (first + i + 1) * h, values)
            self._signals.rows = []
        elif done:
            self._signals.stepped(h, self.last.end)

    def _rows(self, steps: Steps) -> Steps:
        """The record of steps, with the columns of the network and the parts of its junctions."""
        works = None if steps.works is None else self._works.grouped(steps.works)
        unknowns = self._unknowns()[None] if self.unknowns_told else None
        return replace(steps, signals=self._columns.rows(steps.signals), works=works, unknowns=unknowns)

    def _single(self, t: float, h: float) -> Steps:
        """One step: every member is at t + h with the committed inputs, or, also when reading fails, all are back at t."""
        inside = self.samples_inside and not self._followed_through_ports
        states, last, samples = self.joined.states(self.coupling.repeats), self.last, self._signals.state()
        try:
            if not inside:
                self._signals.hold(h, self.last.xi)
            steps, self.last = self._stepped(Step(t, h, states))
            self.joined.finish()
            if inside:
                self._watch_signals((t, h, 0), 1)
            else:
                self._signals.stepped(h, self.last.end, self._agreed and self._agreed.found)
            if not inside and self._signals.held:
                self._grown.watch(t + h, self._signals.now)
            if self._signals.any_held or any(m.finishes for m in self.joined.members):
                steps = self.master.recorded(self._sums, t, h, steps)
            if self._growth is not None:
                self._growth.watch(t, h, steps.H[0], steps.pairs[0])
            self._jumps.require_own()
            return self._rows(steps)
        except BaseException as failure:
            self.joined.restore(states)
            self._signals.restore(samples)
            self.last = last
            if isinstance(failure, EndRequested):
                failure.time, failure.h, failure.back = t, h, all(s is not None for s in states)
            self._told(failure, h)
            raise

    def land(self, t0: float, h: float, n: int, first: int = 0, changed: bool = True) -> Iterator[Landing]:
        """Steps and events, as `Monolithic.land` yields them, of members whose steps all end on the zeros of guards."""
        return self._landed(StepGrid(t0, h, n, first), changed)

    def _landed(self, grid: StepGrid, changed: bool) -> Iterator[Landing]:
        assert self._lander is not None
        for k in range(grid.n):
            paused = False
            for t, taken, happened in self._lander.over(grid.start(k), grid.start(k + 1), changed, grid.pause):
                self._at_start = None if taken or self._switching else self._at_start
                if taken:
                    try:
                        known = self._landed_row(t, taken)
                    except BaseException:
                        self._lander.back()
                        raise
                    yield np.array([t]), np.array([taken]), known, None
                    self._require_wanted(t + taken)
                    continue
                self._sums.forget()
                # what comes is not the continuation of the step before
                self.last = Solution(self._switching.xi if self._switching else self.last.xi)
                self.joined.apply(self.last.xi)
                assert happened is not None
                yield np.zeros(0), np.zeros(0), None, (happened, self.read())
                paused = grid.pause
            if paused:
                return
            changed = False

    def _landed_row(self, t: float, h: float) -> Steps:
        """The record of a step that ends where members land, with what is told there."""
        self.joined.finish()
        if any(m.finishes for m in self.joined.members):
            self._row = self.master.recorded(self._sums, t, h, self._row)
        if self._growth is not None:
            self._growth.watch(t, h, self._row.H[0], self._row.pairs[0])
        return replace(self._rows(self._row), signals=self.read()[None])

    # -- under another scheme ---------------------------------------------------------------------------------------

    @property
    def instance(self) -> Coupled:
        """The one whose steps are the run's: itself."""
        return self

    def undamped(self) -> dict[str, str]:
        """Member, "" for all -> why it takes no single steps under another scheme."""
        inner = plain(self.coupling)
        if not isinstance(inner, Newton):
            return {"": "take damping steps with --coupling newton only"}
        found = dict[str, str]()
        for m in self.joined.members:
            if not isinstance(m, EngineMember):
                found[m.name] = "is a unit, which has its scheme compiled in"
            elif m.model.modes is not None or self._switching:
                found[m.name] = "has ideal switches, or is joined with members that have"
            elif m.model.declaration.constraints:
                found[m.name] = "has holonomic constraints, which damping steps let drift"
        return found

    @property
    def events_inside(self) -> bool:
        """Whether a member has state events that happen inside its steps."""
        return any(isinstance(m, EngineMember) and m.model.events and not m.together for m in self.joined.members)

    def companion(self, scheme: Scheme) -> Coupled:
        """The same members under another scheme, with as many values per junction variable as that takes."""
        members: list[Member] = [m.companion(scheme) for m in self.joined.members if isinstance(m, EngineMember)]
        around = type(self.coupling) if isinstance(self.coupling, HalvingPolicy | AcceptingPolicy) else None

        def coupling(joined: CoupledMembers) -> Coupling:
            return newton(joined) if around is None else around(newton(joined))

        found = Coupled(self.joined.network, members, coupling, self._threads, self._signals_are)
        self._works.share(found._works)
        self.booking = replace(self.booking, parts=self._works.keys)
        return found

    def follow(self, instance: Coupled, other: Coupled) -> None:
        """`instance` goes on from `other`, both with the members of this one under schemes of their own."""
        for mine, its in zip(instance.joined.members, other.joined.members, strict=True):
            assert isinstance(mine, EngineMember) and isinstance(its, EngineMember)
            mine.follow(its)
        instance.joined.free[:] = other.joined.free
        instance.joined.followed = other.joined.followed
        instance._signals.follow(other._signals)
        instance._sums.forget()
        instance._at_start = None
        instance.last = Solution(other.last.end)

    def taken(self, instance: Coupled, t0: float, h: float, n: int) -> Steps:
        """n steps of this one or of a companion."""
        return instance.advance(t0, h, n)

    def landed(self, instance: Coupled, grid: StepGrid, changed: bool) -> Iterator[Landing]:
        """`land` of this one or of a companion; a grid that pauses ends with the first event."""
        return instance._landed(grid, changed)

    def _unknowns(self) -> Array:
        """Unknowns of the last steps of the members that engines step."""
        engines = (m for m in self.joined.members if isinstance(m, EngineMember))
        return np.concatenate([m.instance.unknowns for m in engines])
