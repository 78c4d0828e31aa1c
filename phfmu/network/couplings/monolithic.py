"""Monolithic coupling: one model, composed where it has members, in one instance."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from dataclasses import replace
from typing import TYPE_CHECKING, Any
from weakref import WeakKeyDictionary

import numpy as np
from numpy.typing import NDArray

from phfmu.discretise.accounts import Accounts
from phfmu.discretise.constant_energy import Constants
from phfmu.discretise.model import Model, build_model
from phfmu.engine.record import Grid
from phfmu.engine.rest_changes import RestChange
from phfmu.engine.switched import stepped
from phfmu.network.couplings.stepper import Landing
from phfmu.network.impulses.projections import Projections
from phfmu.network.members.columns import SignalColumns, booking
from phfmu.network.members.consistent import require_consistent
from phfmu.network.members.event_texts import EventTexts
from phfmu.network.members.inputs import Inputs
from phfmu.outcome.status import StepFailure
from phfmu.outcome.steps import LEDGER, EventRecord, Landed, StepEvent, Steps
from phfmu.schemes.scheme import Scheme
from phfmu.signals import SignalKind, labels

if TYPE_CHECKING:
    from phfmu.discretise.start import Projection
    from phfmu.network.members.interpolant import Interpolant
    from phfmu.network.scene import Event

Array = NDArray[np.float64]
Between = Callable[[Any, Array, dict[str, Array], Array, Array], Array]


#: models of the same declarations under other schemes, each as long as the first one is in use
_COMPANIONS: WeakKeyDictionary[Model, dict[Scheme, Model]] = WeakKeyDictionary()


def _companion(model: Model, scheme: Scheme) -> Model:
    """The model of the same declaration under another scheme, planned once."""
    if scheme == model.scheme:
        return model
    known = _COMPANIONS.setdefault(model, {})
    if scheme not in known:
        declaration = model.declaration if model.modes is None else model.modes.modes.declaration
        known[scheme] = build_model(declaration, scheme)
    return known[scheme]


class Monolithic:
    """One instance (Python or native) that is the whole system."""

    what, instead = "one composed model", ""
    CARRIED = ("instance", "_inputs", "booking", "unknowns_told")
    unwritten = ()

    def __init__(self, model: Model, instance: Any):
        self.model, self.instance = model, instance
        self._accounts = Accounts.of(model.members)
        self._projections = Projections(model)
        self._constants = Constants(model)
        held = self._constants.booked(instance.parameters)
        self.booking = replace(booking(model, held), parts=self._projections.keys)
        self._inputs = Inputs(instance, model)
        self._columns = SignalColumns(model, instance.layout)
        self.names = self._columns.names
        #: makes rows within the steps, if asked for: (instance, row before, record, starts, sizes) -> (n x rows x width)
        self.between: Between | None = None
        #: steps are to tell their unknowns
        self.unknowns_told = False
        #: free inputs that follow data
        self.followed: Interpolant | None = None

    @property
    def units(self) -> dict[str, str]:
        return self._columns.units | self._inputs.units

    @property
    def kinds(self) -> dict[str, SignalKind]:
        return self._columns.kinds

    @property
    def labels(self) -> Mapping[str, str]:
        return labels(self.model.declaration)

    def inputs(self) -> dict[str, float]:
        """Free inputs of ports and signals, as they are now."""
        return dict(zip(self._inputs.inputs, self._inputs.u.tolist(), strict=True)) | self._inputs.signals()

    def notes(self) -> list[str]:
        """No lines about the run: a composed model has none."""
        return []

    def hashed(self) -> dict[str, dict[str, float]]:
        """By component its states and the time, by their names in it."""
        d, found = self.model.declaration, dict[str, dict[str, float]]()
        names = [n for v in d.states for n in v.names()]
        for c in self.booking.components:
            found[c] = {"time": float(self.instance.time)}
        for name, value in zip(names, self.instance.x.tolist(), strict=True):
            owner = max((c for c in found if name.startswith(f"{c}.")), key=len, default=self.booking.components[0])
            found[owner][name.removeprefix(f"{owner}.")] = value
        return found

    @property
    def junctions(self) -> Array:
        """Unknowns of the last step, which are those of its junctions among others."""
        return self.instance.unknowns

    @property
    def modes(self) -> tuple[int, ...]:
        """The modes of its switches."""
        return self.instance.mode if self.model.modes is not None else ()

    def settable(self) -> list[str]:
        return [*self._inputs.parameters, *self._inputs.inputs]

    def set_value(self, name: str, value: float) -> str:
        """Set a parameter or free input and say which it is; KeyError names close ones."""
        kind = self._inputs.set(name, value)
        if kind:
            self._rebook()
            return kind
        d = self.model.declaration
        if name in {n for v in (*d.states, *d.algebraics) for n in (v.name, *v.names())}:
            raise KeyError(f"{d.name}: '{name}' follows from the equations; set a parameter or a free input")
        raise KeyError(d.unknown_name(name))

    def _rebook(self) -> None:
        """Book anew the constants in H, which may follow a parameter that was set."""
        if (held := self._constants.booked(self.instance.parameters)) != self.booking.constants:
            self.booking = replace(self.booking, constants=held)

    def read(self) -> Array:
        """Values of `names` now."""
        return self._columns.now(self.instance)

    def energies(self) -> Array:
        return self._by_component(self.instance.signal("H"))

    def _by_component(self, values: Array) -> Array:
        """Values by member of the model, of which terms may have their own."""
        return values if self._accounts is None else self._accounts.folded(values)

    def rest_changes(self) -> dict[str, list[RestChange]]:
        return {"": self.instance.rest_changes}

    def _settled(self) -> Any:
        """The instance whose constraints the state keeps: that of the mode, unless the next landing has yet to find it."""
        switched = self.model.modes is not None and not self.instance.unsettled
        return self.instance.present if switched else self.instance

    def check_start(self) -> None:
        require_consistent(self.model, self.instance)

    def check_changed(self) -> None:
        where = self._settled()
        require_consistent(where.model, where)

    def project_start(self, t0: float, kept: Sequence[str] = ()) -> Projection | None:
        """Move the state onto its hidden constraints, but not the states `kept`; None if it has none."""
        where = self._settled()
        if not where.model.checks:
            return None
        from phfmu.discretise.start import project_start

        found = project_start(where.model, self.instance.x, p=self.instance.parameters, t=t0, keep=kept)
        self.instance.set_x(t0, found.x)
        self.instance.initialise()
        if self._accounts is None or not found.changes:
            return found
        return replace(found, changes=tuple(self._by_component(np.array(found.changes)).tolist()))

    def prepare(self, t0: float, h: float) -> None:
        """One instance has its values from its own start; with switches it is told how long steps are."""
        if self.model.modes is not None:
            self.instance.prepare(h)

    def advance(self, t0: float, h: float, n: int, first: int = 0) -> Steps:
        try:
            return self.taken(self.instance, t0, h, n, first)
        except StepFailure as failure:
            if len(failure.recorded.get("counts", ())):
                failure.recorded = {"steps": self.steps_of(self.instance, failure.recorded)}
            raise

    def land(self, t0: float, h: float, n: int, first: int = 0, changed: bool = True) -> Iterator[Landing]:
        """Starts and sizes of steps, the steps, and the state events at their end, over grid steps first..first+n-1.

        None for no steps, and for the steps before the end or a failure.  `changed`: something was set since the last step.
        """
        return self.landed(self.instance, Grid(t0, h, n, first), changed)

    def landed(self, instance: Any, grid: Grid, changed: bool) -> Iterator[Landing]:
        """`land` of the instance or of a companion; a grid that pauses ends with the first event."""
        if self.followed is not None and grid.n > 1:
            for k in range(grid.first, grid.first + grid.n):
                paused = False
                for part in self.landed(instance, replace(grid, n=1, first=k), changed):
                    yield part
                    paused = grid.pause and part[3] is not None
                if paused:
                    return
            return
        given = self._at_nodes(instance, grid.t0, grid.h, grid.n, grid.first)
        if given is not None:  # inputs are held between events, with their mean over each grid step
            instance.set_input(instance.model.scheme.nodes.b @ given[0])
        wanted, changed = self.landed_records(instance), changed or given is not None
        row = self.row_before(instance)
        parts = instance.land(grid.t0, grid.h, grid.n, wanted, grid.first, changed, pause=grid.pause)
        yield from self.landings(instance, row, parts)

    def landed_records(self, instance: Any) -> tuple[str, ...]:
        """The records that `landings` needs of what the instance lands."""
        wanted = self.wanted(instance)
        return wanted if self.between is None else (*wanted, "unknowns")

    def row_before(self, instance: Any) -> Array:
        """All signals of the instance now, if rows within steps are asked for."""
        return np.zeros(0) if self.between is None else instance.row()

    def landings(self, instance: Any, before: Array, parts: Iterable[Landed]) -> Iterator[Landing]:
        """Steps and events of a landing of the instance, in the columns of a run; `before`: its row at the start."""
        words = EventTexts(self.model)
        for part in parts:
            steps, happened = None, part.happened
            if part.rows:
                steps, before = self._filled(instance, before, part.rows, part.t, part.h), part.rows["signals"][-1]
            row = happened and (self._told(words, happened), self._columns.pick(happened.signals[None])[0])
            before = before if happened is None else happened.signals
            yield part.t, part.h, steps, row

    def _told(self, words: EventTexts, happened: EventRecord) -> StepEvent:
        told = words.told(happened)
        return replace(told, energy=self._by_component(told.energy), lost=self._by_component(told.lost))

    @property
    def lands(self) -> bool:
        """Whether the model has state events."""
        return self.model.events is not None

    @property
    def guards(self) -> int:
        """Number of guards on whose zeros steps end."""
        return 0 if self.model.events is None else self.model.events.n

    @property
    def free_inputs(self) -> Mapping[str, Any]:
        """Names of the free inputs, also bare ones of vectors."""
        return self._inputs.free

    def advance_with(self, inputs: Sequence[tuple[int, Event]], t0: float, h: float, n: int, first: int = 0) -> Steps:
        """`advance`, with free inputs that change: (step from `first` at whose start it changes, event), in order."""
        u = self._inputs.rows(n, inputs)
        given = u if self.followed is None else self._inputs.at_nodes(self.followed, u, self.model, t0, h, first)
        try:
            steps = self.ran(self.instance, t0, h, n, first, given)
        except StepFailure as failure:
            done = len(failure.recorded.get("counts", ()))
            if done:
                failure.recorded = {"steps": self.steps_of(self.instance, failure.recorded)}
            self._inputs.u[:] = u[done]
            raise
        self._inputs.u[:] = u[-1]
        return steps

    def companion(self, scheme: Scheme) -> Any:
        """An instance of the same declaration and engine under another scheme."""
        present, model = self.instance, _companion(self.model, scheme)
        return stepped(model, type(present if self.model.modes is None else present.present))

    def measuring(self, scheme: Scheme) -> Any:
        """A companion that errors of steps of any length are told by."""
        return self.companion(scheme)

    def taken(self, instance: Any, t0: float, h: float, n: int, first: int = 0) -> Steps:
        """n steps of the instance or of a companion."""
        if self.between is None:
            return self.ran(instance, t0, h, n, first, self._at_nodes(instance, t0, h, n, first))
        before = instance.row()
        r = instance.run(t0, h, n, record=(*self.wanted(instance), "unknowns"), first=first)
        return self._filled(instance, before, r, np.asarray(t0 + h * (first + np.arange(n)), np.float64), np.full(n, h))

    def ran(self, instance: Any, t0: float, h: float, n: int, first: int, inputs: Array | None) -> Steps:
        """n steps of the instance, under inputs (n x nu, or n x k x nu) or those that it has."""
        return self.steps_of(instance, instance.run(t0, h, n, record=self.wanted(instance), inputs=inputs, first=first))

    def _filled(self, instance: Any, before: Array, r: dict[str, Array], t: Array, h: Array) -> Steps:
        """Recorded steps, with rows within them if these are asked for."""
        steps = self.steps_of(instance, r)
        if self.between is None:
            return steps
        rows = self.between(instance, before, r, t, h)
        return replace(steps, between=self._columns.pick(rows.reshape(-1, rows.shape[-1])).reshape(*rows.shape[:2], -1))

    def _at_nodes(self, instance: Any, t0: float, h: float, n: int, first: int) -> Array | None:
        """Inputs of n steps at the nodes of the instance's scheme (n x k x nu) where they follow data."""
        if self.followed is None:
            return None
        return self._inputs.at_nodes(self.followed, self._inputs.rows(n, ()), instance.model, t0, h, first)

    def follow(self, instance: Any, other: Any) -> None:
        """`instance` goes on from `other`, under another scheme; what inputs are at nodes is said again for each step."""
        if self.followed is not None:
            other.set_input(self._inputs.u)
        instance.continue_from(other)

    def step_unrecorded(self, instance: Any, t: float, h: float) -> None:
        """One step of the instance or of a companion."""
        given = self._at_nodes(instance, t, h, 1, 0)
        if given is not None:
            instance.set_node_inputs(given[0])
        instance.do_step(t, h)

    def wanted(self, instance: Any) -> tuple[str, ...]:
        """The records that `steps_of` needs of a run of the instance."""
        wanted = (*LEDGER, "numerical") if instance.model.loses_energy else LEDGER
        return (*wanted, "unknowns") if self.booking.parts or self.unknowns_told else wanted

    def steps_of(self, instance: Any, r: dict[str, Array]) -> Steps:
        """The steps that the instance has recorded."""
        steps = Steps.recorded(r, self._columns.pick(r["signals"]))
        if self._accounts is not None:
            names = ("H", "stored", "dissipated", "supplied", "moved", "numerical")
            terms = self._accounts.by_term(steps.stored, steps.dissipated)
            own = {n: self._by_component(x) for n in names if (x := getattr(steps, n)) is not None}
            steps = replace(steps, terms=terms, **own)
        steps = replace(steps, unknowns=r["unknowns"]) if self.unknowns_told else steps
        return replace(steps, works=self._lost(instance, r)) if self.booking.parts else steps

    def _lost(self, instance: Any, r: dict[str, Array]) -> Array:
        """Energy that projections lost in each step (steps x parts); no other scheme has any."""
        parts = self.booking.parts
        if instance.model is not self.model:
            return np.zeros((len(r["signals"]), len(parts)))
        lost = self._projections.losses(r["signals"][:, instance.layout["x"]], r["unknowns"], instance.parameters)
        divided = r["counts"][:, 1] > 1  # its last part is known only: what the ports say, if it is a loss
        for j, key in enumerate(parts):
            own = self.booking.junctions[key.junction]
            lost[divided, j] = np.minimum(r["pairs"][divided][:, own].sum(axis=1), 0.0)
        return lost
