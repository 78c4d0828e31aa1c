"""Members that land together as one composed declaration: at an instant they are one, in steps they are apart.

So do those with ideal switches, and those whose jumps act on others while their guards read what others give.  Which mode
follows, what jumps, and what guards read depends on all members at once.  All of that is asked of the composed declaration, whose
state is that of the members.  Steps are the members' own, with the interface iteration of the coupling.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from dataclasses import replace
from itertools import pairwise
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from phfmu.discretise.model import build_model
from phfmu.discretise.within import polynomial_of
from phfmu.engine.native.native import NativeInstance
from phfmu.engine.native.native_landing import StepCallbacks
from phfmu.engine.switched import SwitchedInstance, stepped
from phfmu.events.modes import Mode
from phfmu.network.couplings.coupling import AllSteps
from phfmu.network.couplings.monolithic import Monolithic
from phfmu.network.interface.coupled_members import CoupledMembers
from phfmu.network.interface.unknowns import InterfaceUnknowns
from phfmu.network.members.engine_member import EngineMember
from phfmu.network.members.event_texts import EventTexts
from phfmu.network.members.relation import RelationInstance
from phfmu.outcome.steps import EventRecord, StepEvent
from phfmu.schemes.collocated import Collocated

if TYPE_CHECKING:
    from phfmu.discretise.start import Projection


Array = NDArray[Any]


class ComposedState:
    """The members' states, parameters and free inputs as those of the composed declaration, which has them in the same order."""

    def __init__(self, joined: CoupledMembers):
        self.joined = joined
        self.members: list[EngineMember] = [m for m in joined.members if isinstance(m, EngineMember)]
        self._x, self._p = (
            np.cumsum([0, *(getattr(m.model.step, size) for m in self.members)]).tolist() for size in ("nx", "np")
        )

    def gathered(self, what: str) -> Array:
        """Values of all instances, one after the other; `what`: x, parameters or unknowns."""
        return np.concatenate([getattr(m.instance, what) for m in self.members])

    @property
    def unfed(self) -> NDArray[np.intp]:
        """Places of the inputs that nothing feeds."""
        return np.flatnonzero(self.joined.face.column < 0)

    @property
    def free(self) -> Array:
        """Inputs that nothing feeds."""
        return self.joined.free[self.unfed]

    def parameters(self, p: Array) -> Iterator[Array]:
        """Those of each member."""
        return (p[a:b] for a, b in pairwise(self._p))

    @property
    def substeps(self) -> int:
        return sum(m.instance.counts["substeps"] for m in self.members)

    def polynomial(self, x: Array, unknowns: Array, tau: float) -> Array:
        """All states at the fraction tau of the step that the members have just taken."""
        at, found = 0, []
        for m, (a, b) in zip(self.members, pairwise(self._x), strict=True):
            model = _present(m).model
            if a < b:
                found.append(polynomial_of(model)(x[a:b], unknowns[at : at + model.step.nw], tau))
            at += len(m.instance.unknowns)
        return np.concatenate([np.zeros(0), *found])

    def take(self, t: float, x: Array, p: Array) -> None:
        """Gives the members their states and parameters after an event at t, if these are others than they have.

        They are asked for nothing before they have the inputs of that instant, too.
        """
        for m, (a, b), (c, d) in zip(self.members, pairwise(self._x), pairwise(self._p), strict=True):
            moved, changed = bool((m.instance.x != x[a:b]).any()), bool((m.instance.parameters != p[c:d]).any())
            unsettled = isinstance(m.instance, SwitchedInstance) and m.instance.unsettled
            if changed or unsettled:
                m.instance.set_parameters(p[c:d])
            if isinstance(m.instance, SwitchedInstance) and m.instance.unsettled:
                m.instance.settle()
            if moved:
                _present(m).set_x(t, x[a:b])


def _present(member: EngineMember) -> Any:
    """The instance that steps a member now."""
    return member.instance.present if isinstance(member.instance, SwitchedInstance) else member.instance


class ComposedLander:
    """Steps of all members that end on the zeros of guards of the composed declaration, in place of `CoupledLander`.

    joined_anew: is called after C of the exchange has changed
    """

    def __init__(self, exchange: InterfaceUnknowns, steps: AllSteps, joined_anew: Callable[[], None]):
        joined = exchange.joined
        self._exchange, self._joined_anew = exchange, joined_anew
        self.members_state = ComposedState(joined)
        self._steps, self._in_parts, self._saved = steps, 0, steps.save()
        k = self.members_state.members[0].model.step.k
        model = build_model(joined.network.compose(), Collocated(k))
        self.model: Any = model
        #: the composed declaration, in compiled code: it is asked for guards, modes and jumps, and takes no step
        self._whole: Any = stepped(model, NativeInstance)
        self._composed = Monolithic(model, self._whole)
        self._words = EventTexts(model)
        #: numbers of the events that happened last and of those that came to rest
        self.last: tuple[list[int], list[int]] = [], []
        #: names of the members that begin anew with them, whose means are those of the instant: all
        self.anew = {m.name for m in joined.members}
        #: how many guards there are
        self.guards = 0 if model.events is None else model.events.n
        if model.modes is None:
            self._whole.landing[0].lend(StepCallbacks(self, self._whole))
        else:
            self._whole.native.lend(self)
        names = [n for v in model.declaration.algebraics for n in v.names()]
        at = {n: i for i, n in enumerate(names)}
        self._junction = np.array([at[n] for n in joined.face.names], int)
        #: among the algebraic variables of the composed declaration: those of junctions, then those of relations
        self.columns = np.array([at[n] for n in exchange.names], int)
        observed = {n: i for i, n in enumerate(model.observable_names)}
        #: relations, with their algebraic variables and observables among those of the composed declaration
        self.told = [
            (m.instance, np.array([at[f"{m.name}.{n}"] for n in m.instance.names], int),
             np.array([observed[f"{m.name}.{n}"] for n in m.model.observable_names], int))
            for m in self.members_state.members if isinstance(m.instance, RelationInstance)
        ]  # fmt: skip

    @property
    def modes(self) -> tuple[int, ...]:
        """Modes of the switches of all members."""
        return () if self._whole.model.modes is None else self._whole.mode

    @property
    def algebraics(self) -> Array:
        """Algebraic variables of the composed declaration at the present time."""
        return self._whole.signal("a_end")

    @property
    def unsettled(self) -> bool:
        """Modes were set that are not taken yet."""
        return self._whole.model.modes is not None and self._whole.unsettled

    def _follow(self) -> None:
        """The members take the states, parameters and modes that the composed declaration has after an event."""
        self.members_state.take(self._whole.time, self._whole.x, self._whole.parameters)
        self._enter()
        self.tell()
        self.members_state.joined.begin(self.xi)

    @property
    def held_only(self) -> str:
        """Why no input follows data, and what to do."""
        return (
            f"{self.members_state.joined.network.name}: inputs of members that land as one composed declaration do not follow "
            "data, which is not known at the instant of an event; leave out --coupling, so that the network is composed"
        )

    def check_changed(self) -> None:
        """InconsistentState if what was set at a member leaves the composed state off the constraints of the present mode."""
        self._gather()
        self._composed.check_changed()

    def project(self, t: float, kept: Sequence[str]) -> Projection | None:
        """Moves the members' states onto these, if the switches have landed before; the first landing does so else."""
        if self.unsettled:
            return None
        found = self._composed.project_start(t, kept)
        self.members_state.take(t, self._whole.x, self._whole.parameters)
        return found

    # -- steps of the members, lent to the composed declaration -------------------------------------------------------------

    @property
    def halved(self) -> int:
        return self._in_parts + self.members_state.substeps

    @property
    def x(self) -> Array:
        return self.members_state.gathered("x")

    def step(self, t: float, h: float) -> None:
        self._in_parts += not self._steps.solve(t, h)

    def inside(self, x: Array, tau: float) -> Array:
        return self.members_state.polynomial(x, self.members_state.gathered("unknowns"), tau)

    def save(self) -> None:
        self._saved = self._steps.save()

    def back(self) -> None:
        """To where the last step began."""
        self._steps.restore(self._saved)

    def get_state(self) -> tuple[Any, Array, Array]:
        """State of the composed declaration, rates of its guards, and the junction unknowns of the present instant."""
        return self._whole.get_state(), self._rates.copy(), self.xi

    def set_state(self, state: tuple[Any, Array, Array]) -> None:
        """Goes on from what `get_state` gave, once the members are where they were then."""
        whole, rates, self.xi = state
        self._whole.set_state(whole)
        self._rates[:] = rates
        self._enter()

    @property
    def _rates(self) -> Array:
        """|d guard / dt| where the present instant was reached, by which a guard that was landed on is zero."""
        whole = self._whole if self._whole.model.modes is None else self._whole.present
        return whole.landing[0].rates

    def begin(self, h: float) -> Array:
        """Junction unknowns at the start of a run with steps of about h, in the modes that it starts with."""
        if self._whole.model.modes is not None:
            self._whole.prepare(h)
        self._gather()
        self._enter()
        self.tell()
        self.members_state.joined.begin(self.xi)
        return self.xi

    def over(
        self, t: float, end: float, changed: bool, pause: bool = False
    ) -> Iterator[tuple[float, float, StepEvent | None]]:
        """(start, length, None) of each step taken in [t, end], (time, 0, what happened) of each event.

        `pause`: ends after the first event, and those that follow it at the same time.
        """
        if changed:
            self._gather()
        for start, taken, happened in self._landed(t, end, changed, pause):
            if happened is None:
                self.tell()
                yield start, taken, None
            else:
                self.last = [*happened.events], [*happened.rests]
                self._follow()
                yield start, 0.0, self._words.told(happened)

    def _landed(
        self, t: float, end: float, changed: bool, pause: bool
    ) -> Iterator[tuple[float, float, EventRecord | None]]:
        if self._whole.model.modes is not None:
            return self._whole.native.to(t, end, changed, pause)
        landing, check = self._whole.landing
        return landing.to(t, end, changed, pause, check)

    def _gather(self) -> None:
        """Takes what was set at the members."""
        switched, p, x = self._whole, self.members_state.gathered("parameters"), self.members_state.gathered("x")
        switched.set_input(self.members_state.free)
        if (p != switched.parameters).any():
            switched.set_parameters(p)
        if (x != switched.x).any():
            switched.set_x(switched.time, x)

    def _enter(self) -> None:
        """The rows of relations in the present modes."""
        if self._whole.model.modes is not None:
            self._join(self._whole.mode)

    def _join(self, mode: Mode) -> None:
        places = {int(c): i for i, c in enumerate(self.columns)}
        self._exchange.relations.undetermined = [
            replace(u, at=places[u.at], row=u.row[self.columns])
            for u in self.model.modes.modes.system.undetermined(mode) if u.at in places
        ]  # fmt: skip
        self._exchange.join()
        self._joined_anew()

    def in_mode(self, mode: Mode) -> None:
        """The rows of relations are those of a mode of all switches, which the states need not be in."""
        p = self.model.modes.modes.system.in_mode(self._whole.parameters, mode)
        for m, own in zip(self.members_state.members, self.members_state.parameters(p), strict=True):
            if isinstance(m.instance, RelationInstance):
                m.instance.set_parameters(own)
        self._join(mode)

    def tell(self) -> None:
        """Tells all members their inputs, and relations their values, at the present time."""
        t, now = self._whole.time, self._whole.signals()
        #: junction unknowns at that instant
        self.xi = now["a_end"][self._junction]
        self.members_state.joined.apply(self.xi)
        for instance, a, observed in self.told:
            instance.tell(t, now["a_end"][a], now["observables"][observed])
