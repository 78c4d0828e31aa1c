"""Members stepped apart whose steps are kept to be derived: what both directions need, and refuse."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from functools import cached_property
from typing import Any

import numpy as np
from numpy.typing import NDArray

from phfmu.derivatives.apart.apart_start import ApartStart
from phfmu.derivatives.apart.in_turn_maps import InTurnMaps
from phfmu.derivatives.apart.joint_events import JointEvents
from phfmu.derivatives.apart.joint_maps import AnyMaps, JointMaps, JointSteps
from phfmu.derivatives.apart.member_maps import MemberMaps
from phfmu.derivatives.apart.unit_maps import UnitMaps, scalars_of, why_not
from phfmu.derivatives.by import IndependentVariables, ScalarData, declared_scalars
from phfmu.derivatives.derived import close_events, identity_of
from phfmu.derivatives.tangents import RunTangents, of_quantities, require_derived
from phfmu.discretise.model import Model, build_model
from phfmu.discretise.start import Projection
from phfmu.gradients.quadrature import nodes
from phfmu.interrupt import Interrupted
from phfmu.network.couplings.anderson import Anderson
from phfmu.network.couplings.compiled.master_pattern import ShareTables
from phfmu.network.couplings.coupled import Coupled
from phfmu.network.couplings.coupling import InTurn, Solution
from phfmu.network.couplings.newton import Newton
from phfmu.network.couplings.unconverged import AcceptingPolicy, HalvingPolicy
from phfmu.network.interface.coupled_members import CoupledMembers
from phfmu.network.members.engine_member import EngineMember
from phfmu.network.members.fmu_member import FMUMember
from phfmu.network.members.member import Member
from phfmu.network.members.predicted_member import PredictedMember
from phfmu.network.network import Network
from phfmu.outcome.status import StepFailure
from phfmu.outcome.steps import Steps
from phfmu.schemes.scheme import Scheme
from phfmu.signals import of_member, quantities
from phfmu.words import meant

Array = NDArray[np.float64]

_NO_DERIVATIVES = "no derivatives are told"
_REMEDY = (
    "take the declarations as members, units that this version exports, or differences of whole runs (phfmu sweep)"
)


class DerivedMembers(Coupled):
    """Members stepped apart, whose rows are derived by parameters, held inputs or start values `by`, as `member.name`.

    Where the coupling iterates, the derivative is that of the solution of the interface, to the accuracy of its acceptance;
    where members step in turn, that of the values they take from each other.
    Errors: KeyError for names that are none; ValueError for members, couplings and steps without derivatives, with the remedy.
    """

    #: whether state events of members are followed
    through_events = False
    #: length of steps that do not land
    grid = 0.0

    def __init__(self, apart: Coupled, by: Sequence[str]):
        network, members = apart.joined.network, apart.joined.members
        _require_derivable(network, members)
        super().__init__(network, members, apart.made_by, apart._threads, apart._signals_are)
        self.joined.free[:] = apart.joined.free
        self.engines: list[EngineMember] = [m for m in members if isinstance(m, EngineMember)]
        #: whether some members are units, so that there is no model of the whole
        self.with_units = len(self.engines) < len(members)
        self._require_smooth()
        self.by = by_of(apart.joined, by)
        own = [_own(m, self.by.names) for m in members]
        #: by member, places of its names among all
        self.at = [
            [self.by.names.index(of_member(m.name, n)) for n in b.names] for m, b in zip(members, own, strict=True)
        ]
        found = self.master.found
        wired: list[list[int]] = [[] for _ in members]
        for _, _, target, i in found.wires.tolist():
            wired[target].append(i)
        if isinstance(self.coupling, InTurn):
            parts = zip(members, found.parts, own, strict=True)
            self.maps = InTurnMaps(found, list(parts), self.coupling.groups(self.joined), self._map)
        else:
            parts = zip(members, found.parts, own, wired, strict=True)
            self.maps = JointMaps(found, [self._map(*p) for p in parts])
        #: of state events on which all members end their steps together
        self.events = JointEvents(self.model, self.joined, self.engines, self._lander, self.by) if self.lands else None
        #: columns that are no derivatives
        self.own_names = list(self.names)
        #: entries of all members, junctions and sums at ends, which columns are made of
        self.width = len(self.joined.names) + len(self.joined.face.names) + len(self._sums.names)
        #: of each member's columns; names of those that have derivatives
        self._quantities = [m.quantities for m in self.maps.members]
        named = zip(members, self._quantities, strict=True)
        can = {*(of_member(m.name, q.name) for m, qs in named for q in qs if q.block), *self.joined.face.names}
        can |= set() if self.with_units else {*self._columns.totals}
        self.derivable = [n for n in self.own_names if n in can]
        self._given = self.states_now()
        self.forget()

    def _map(self, m: Member, part: ShareTables, own: IndependentVariables, wired: Sequence[int] = ()) -> AnyMaps:
        """The derivatives of a member's steps."""
        if isinstance(m, FMUMember):
            return UnitMaps(m, part, own)
        assert isinstance(m, EngineMember)
        return MemberMaps(m, part, own, wired, moves=self.lands)

    @property
    def known(self) -> ScalarData:
        """Start values, sizes, limits and units of what members can be derived by."""
        return ScalarData.joined({m.member.name: m.known for m in self.maps.members})

    @property
    def identity(self) -> tuple[Any, ...]:
        """The network, its units and start values, which tell runs that are kept from those of others."""
        if not self.with_units:
            return identity_of(self.model)
        tokens = [m.unit.interface.token for m in self.joined.members if isinstance(m, FMUMember)]
        return self.joined.network.name, tokens, sorted(self.known.start.items())

    @property
    def moves(self) -> bool:
        """Whether times of rows move with the values."""
        return self.events is not None

    @cached_property
    def model(self) -> Model:
        """The same members as one model, which the start is derived by; not with units."""
        return build_model(self.joined.network.compose(), self.engines[0].model.scheme)

    def notes(self) -> list[str]:
        """State events whose sequence other values, however close, may change, too."""
        own = super().notes()
        return own if self.events is None else [*own, *close_events(self.events.met, self.events.names, self.grid)]

    def forget(self) -> None:
        """Drops what was kept of steps, which belong to another run."""
        if self.events is not None:
            self.events.met.clear()
        self._acts, self._begun = np.ones(len(self.by.names)), False

    @property
    def sequence(self) -> tuple[tuple[int, ...], ...]:
        """Numbers of the state events of the run, one instant after the other."""
        return () if self.events is None else tuple(e.events for e in self.events.met)

    def begin(self, values: Mapping[str, float]) -> None:
        """Back to the start, with other parameters, start values or held inputs, by scalar name."""
        self._given = []
        for m, place in zip(self.maps.members, self.joined.places, strict=True):
            own = scalars_in(m.member.name, [*values])
            x, self.joined.free[place] = m.start({n: values[of_member(m.member.name, n)] for n in own})
            self._given.append(x)
        self.joined.free[self.joined.face.fed] = 0.0
        self._sums.forget()
        self._signals.forget()
        self.last, self._at_start = Solution(self.joined.face.start.copy()), None
        if self.events is not None:
            self._land_anew()
            self.events.lander = self._lander
        self.forget()

    def require_derivable(self, name: str) -> None:
        """ValueError for a column that has no derivatives."""
        if name in self.own_names and name not in self.derivable:
            network = self.joined.network
            member = next((m for m in self.joined.members if name.startswith(f"{m.name}.")), None)
            if isinstance(member, FMUMember):
                raise ValueError(
                    f"{network.name}: the unit '{member.name}' tells no derivative of {name} (energies of the unit have none, "
                    "those through its ports have); leave it out"
                )
            raise ValueError(
                f"{network.name}: {name} is told at an instant that members stepped apart do not solve, and has no "
                f"derivative; leave it out, or {network.to_compose}"
            )

    def _require_smooth(self) -> None:
        """ValueError for what has no derivatives here."""
        instead, name = self.joined.network.to_compose, self.joined.network.name
        if isinstance(self.coupling, HalvingPolicy | AcceptingPolicy):
            raise ValueError(
                f"{name}: steps that may be halved, or accepted as they are, where the interface does not converge have no "
                "derivatives; leave out --unconverged and take shorter steps"
            )
        swept = isinstance(self.coupling, InTurn) and self.coupling.repeats
        if swept or not isinstance(self.coupling, Newton | Anderson | InTurn):
            why = "which takes each step more than once" if swept else "whose rule is a function in Python"
            raise ValueError(
                f"{name}: steps of {type(self.coupling).__name__}, {why}, have no derivatives; take --coupling newton, "
                f"or {instead}"
            )
        if self._signals.any_held:
            held = ", ".join(of_member(w.source, w.output) for w in self._signals.held[:3])
            raise ValueError(
                f"{name}: signals that are held over a step ({held}) have no derivatives; {instead}, where they are exact"
            )
        if self.with_units and self.lands:
            raise ValueError(
                f"{name} has state events on which its members land together, through which there are no derivatives beside "
                "units; take declarations as members"
            )
        for m in self.engines:
            self._require_landing(m)
            if m.parts != 1:
                raise ValueError(
                    f"{name}: member '{m.name}' takes {m.parts} steps in one, of which derivatives know the last one only; leave "
                    f"out --parts, or {instead}"
                )
            require_derived(m.model)

    def _require_landing(self, m: EngineMember) -> None:
        """ValueError where derivatives do not go through the state events of a member."""
        instead, name = self.joined.network.to_compose, self.joined.network.name
        if m.model.modes is not None:
            raise ValueError(
                f"{name}: member '{m.name}' has ideal switches, through which members stepped apart have no derivatives; "
                f"{instead}"
            )
        if m.model.events is None:
            return
        why = ""
        if not self.lands:
            why = (
                "that happen inside its own steps, of which derivatives know the whole only; take --coupling newton and "
                "--order 4 or 6, with which all members land together, where they can"
            )
        elif not self.through_events:
            why = "through which derivatives of members stepped apart go forward only; take mode forward"
        elif len(self.master.found.bare):
            why = "beside impulses at bare nodes, which derivatives do not go through together"
        if why:
            raise ValueError(f"{name}: member '{m.name}' has state events {why}, or {instead}")

    # -- values ----------------------------------------------------------------------------------------------------------

    def set_value(self, name: str, value: float) -> str:
        kind = super().set_value(name, value)
        if self._begun and kind == "input":
            self.by.require_constant(self.joined.network.name, [name])
        if self._begun:
            self.cut(name)
        return kind

    def cut(self, name: str) -> None:
        """A value that is set within the run does not follow that of the start."""
        for own in self.by.among(name):
            i = self.by.names.index(own)
            if i in self.by.columns:
                self._acts[i] = 0.0

    def project_start(self, t0: float, kept: Sequence[str] = ()) -> Projection | None:
        if self._begun:
            raise ValueError(
                f"{self.joined.network.name}: states were moved at t = {t0:.9g} s (a projection after an event), which "
                "derivatives do not follow; let the event keep the constraints"
            )
        return super().project_start(t0, kept)

    def kept(self) -> Any:
        """ValueError: steps that are tried with several sizes have no derivatives."""
        raise ValueError(f"{self.joined.network.name}: derivatives are told of equal steps; leave out --rtol")

    def companion(self, scheme: Scheme) -> DerivedMembers:
        """The companion of `Coupled`, derived too."""
        if self.lands:
            raise ValueError(
                f"{self.joined.network.name}: derivatives through state events are told of steps that are not damped; leave out "
                "--restart, or the derivatives"
            )
        made = self.like(super().companion(scheme))
        self._works.share(made._works)
        return made

    def like(self, apart: Coupled) -> DerivedMembers:
        """Other members derived by the same."""
        raise NotImplementedError

    def go_on(self, other: Any) -> None:
        """Derivatives go on from those of `other`, whose members are the same under another scheme."""
        self._acts, self._begun = other._acts, other._begun

    def taken(self, instance: Any, t0: float, h: float, n: int) -> Steps:
        """Steps taken, as in `Coupled`; derivatives of those of a companion count once this one goes on from it (`follow`)."""
        if instance is not self:
            instance.go_on(self)
        return instance.advance(t0, h, n)

    def follow(self, instance: Any, other: Any) -> None:
        super().follow(instance, other)
        if instance is self:
            self.go_on(other)

    # -- steps -----------------------------------------------------------------------------------------------------------

    def kept_step(self, t0: float, h: float, k: int) -> tuple[Steps, JointSteps]:
        """Step k of a grid, and what it is derived by."""
        if self.joined.followed is not None:
            self.by.require_constant(self.joined.network.name, self.joined.followed.data.names)
        before, states = self.states_now(), self.joined.states() if self.maps.in_turn else []
        given = [self._outside(i, t0, h, k) for i in range(len(self.maps.members))]
        for m in self.maps.members:
            m.ready()
        steps = super().advance(t0, h, 1, k)
        return steps, self.joint_step(before, given, t0 + k * h, h, states)

    def states_now(self) -> list[Array]:
        """States of the members."""
        return [m.state() for m in self.maps.members]

    def landed_step(self, before: list[Array], t: float, h: float) -> JointSteps:
        """The step from t by h that all have landed, with what its derivatives need."""
        return self.joint_step(before, [self._outside(i, t, h, 0) for i in range(len(self.maps.members))], t, h, [])

    def joint_step(self, before: list[Array], given: list[Array], t: float, h: float, states: list[Any]) -> JointSteps:
        """The step that was taken last, from t and the states `before`, with what its derivatives need.

        given: inputs from outside at its nodes;  states: all that members are at t, where they step in turn
        """
        parts = list[Any]()
        z, instants = self.maps.unknowns(self.master.unknowns, self.joined, states, given, t)
        for m, x, u in zip(self.maps.members, before, given, strict=True):
            parts.append(m.stepped(z[m.part.col], u, x, t, h))
        return JointSteps(parts, z[None], instants)

    def kept_steps(
        self, t0: float, h: float, n: int, first: int
    ) -> tuple[list[Steps], list[JointSteps], StepFailure | Interrupted | None]:
        """Steps of a grid from number `first` on, what they are derived by, and what ended them before n of them."""
        parts, kept = list[Steps](), list[JointSteps]()
        self._begun = True
        try:
            for k in range(first, first + n):
                steps, own = self.kept_step(t0, h, k)
                parts.append(steps)
                kept.append(own)
        except (StepFailure, Interrupted) as failure:
            return parts, kept, failure
        return parts, kept, None

    def _outside(self, i: int, t0: float, h: float, k: int) -> Array:
        """Inputs of a member that no junction feeds, at the nodes of step k (k nu)."""
        place, rule, followed = self.joined.places[i], nodes(self.maps.members[i].part.k), self.joined.followed
        free = self.joined.free[place]
        if followed is not None and len(followed.own(place)):
            return np.ravel(followed.at_nodes(free, place, rule.c, (t0, h, k), 1))
        return np.tile(free, len(rule.c))

    # -- rows ------------------------------------------------------------------------------------------------------------

    def _row_of(self, blocks: Sequence[dict[str, Array]], junctions: Array) -> Array:
        """Derivatives of all columns (rows x columns x names) from those of the members' blocks and of the junctions."""
        n, width = len(junctions), len(self.by.names)
        own = [of_quantities(qs, b, self.by) for qs, b in zip(self._quantities, blocks, strict=True)]
        rest = np.zeros((n, len(self._sums.names), width))
        all_ = np.concatenate([*own, junctions, rest], axis=1)
        return np.moveaxis(self._columns.rows(np.moveaxis(all_, 1, 2)), 2, 1)

    def at_start(self, row: Array) -> tuple[list[Array], Array]:
        """Tangents (nx x names) of the states of members at the start, and of a row of it (columns x names).

        The start and what follows at its instant are those of the composed model; columns that it does not have are NaN.  With
        units there is none, and they are those of the members and their junctions (`apart_start.py`).
        """
        if self.with_units:
            start = ApartStart(self.joined, self._sums, self.maps.members, self.at, self.by)
            return start.slopes(self._given, self.last.xi, self._row_of)
        model, d = self.model, self.model.declaration
        now = dict(zip(self.own_names, row.tolist(), strict=True))
        states = {of_member(m.name, n): v for m in self.engines for n, v in m.states.items()}
        given = {
            of_member(m.name, n): v
            for m, x in zip(self.engines, self._given, strict=True)
            for n, v in zip(m.states, x.tolist(), strict=True)
        }
        parameters = {
            of_member(m.name, n): v
            for m in self.engines
            for n, v in zip(
                (n for p in m.model.declaration.parameters for n in p.names()), m.instance.parameters, strict=False
            )
        }
        inputs = self.inputs()
        order = [n for v in d.states for n in v.names()]
        x, x0 = (np.array([values[n] for n in order]) for values in (states, given))
        p = _filled(model.p0, [n for v in d.parameters for n in v.names()], parameters)
        u = _filled(model.u0, [n for q in d.ports if q.external for n in q.input_names()], inputs)
        known = {q.name: q for q in quantities(model)}
        a = model.a0.copy()
        for q in known.values():
            if q.block == "a_end" and q.name in now:
                a[q.first] = now[q.name]
        tangents = RunTangents(model, self.by)
        blocks = tangents.at_start(self.engines[0].instance.time, x0, x, u, p, a)
        place = {n: i for i, n in enumerate(order)}
        S = [tangents.S[[place[of_member(m.name, n)] for n in m.states]] for m in self.engines]
        told = [known.get(n) for n in self.own_names]
        slopes = np.full((len(self.own_names), len(self.by.names)), np.nan)
        own = [i for i, q in enumerate(told) if q is not None]
        slopes[own] = of_quantities([q for q in told if q is not None], blocks, self.by)[0]
        return S, slopes


def by_of(joined: CoupledMembers, names: Sequence[str]) -> IndependentVariables:
    """Independent variables of members stepped apart.

    Raises KeyError for unknown names, and ValueError for units without derivatives.
    """
    if not any(isinstance(m, FMUMember) for m in joined.members):
        return IndependentVariables.of(joined.network.compose(), names)
    _require_derivable(joined.network, joined.members)
    lists: list[list[str]] = [[], [], []]
    for m in joined.members:
        for to, own in zip(lists, _scalars(m), strict=True):
            to += [of_member(m.name, n) for n in own]
    free = joined.free_inputs()
    p, u, x = lists
    known = [*p, *(n for n in u if n in free), *x]

    def unknown(name: str) -> str:
        return f"{joined.network.name} has no parameter, free input or state '{name}'; {meant(name, known)}"

    return IndependentVariables.chosen(p, [n for n in u if n in free], x, names, unknown)


def _scalars(m: Member) -> tuple[list[str], list[str], list[str]]:
    """Parameters, inputs of ports and states of a member by its own names."""
    if isinstance(m, FMUMember):
        return scalars_of(m)
    assert isinstance(m, EngineMember)
    return declared_scalars(m.model.declaration)


def _own(m: Member, names: Sequence[str]) -> IndependentVariables:
    """The names of a member."""
    known = _scalars(m)
    scalars = {n for own in known for n in own}
    return IndependentVariables.chosen(*known, [n for n in scalars_in(m.name, names) if n in scalars])


def scalars_in(member: str, names: Sequence[str]) -> list[str]:
    """The names of a member's own among those of the whole."""
    return [n.removeprefix(f"{member}.") for n in names if not member or n.startswith(f"{member}.")]


def _filled(values: Array, names: Sequence[str], known: Mapping[str, float]) -> Array:
    found = values.copy()
    for i, n in enumerate(names):
        if n in known:
            found[i] = known[n]
    return found


def _require_derivable(network: Network, members: Sequence[Member]) -> None:
    """ValueError names units without derivatives, and what each lacks."""
    units = [m.inner if isinstance(m, PredictedMember) else m for m in members if not isinstance(m, EngineMember)]
    why = dict[str, list[str]]()
    for m in units:
        if words := why_not(m) if isinstance(m, FMUMember) else _NO_DERIVATIVES:
            why.setdefault(words, []).append(m.name)
    if why:
        told = "; ".join(f"{', '.join(names)}: {words}" for words, names in why.items())
        raise ValueError(f"{network.name}: there are no derivatives of runs through units: {told}; {_REMEDY}")
    if late := [m.name for m in members if isinstance(m, PredictedMember)]:
        raise ValueError(
            f"{network.name}: there are no derivatives of runs through units that are stepped last ({', '.join(late)}); "
            f"{_REMEDY}"
        )
