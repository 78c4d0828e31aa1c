"""A composed model stepped with derivatives: beside each column `s` of a run stand columns `d(s)/d(name)`."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from phfmu.derivatives.derived import DerivedSteps, LandedSteps
from phfmu.derivatives.event_maps import EventInstant
from phfmu.derivatives.measured import TIME
from phfmu.derivatives.tangents import RunTangents, TakenSteps, in_parts, of_quantities
from phfmu.discretise.model import Model
from phfmu.outcome.steps import StepEvent, Steps
from phfmu.signals import Quantity, SignalKind, derivative_name, quantities

Array = NDArray[np.float64]


class SensitiveSteps(DerivedSteps):
    """Steps of one composed model, each row with its derivatives by parameters, held inputs or start values `by`.

    `signals`: which columns are derived (default: all).  Parameters that an event sets count up to there.
    Errors: KeyError for names that are none; ValueError for models and steps without derivatives, with the remedy.
    """

    def __init__(self, model: Model, instance: Any, by: Sequence[str], signals: Sequence[str] | None = None):
        super().__init__(model, instance, by)
        known = {q.name: q for q in quantities(model)}
        self.derived: list[Quantity] = [known[n] for n in self.names if signals is None or n in signals]
        self._tangents = RunTangents(model, self.by, {q.block for q in self.derived})
        #: the times of rows move at state events
        self._times = [] if model.events is None else [derivative_name(TIME, n) for n in self.by.names]
        own = [derivative_name(q.name, n) for q in self.derived for n in self.by.names]
        self.names = [*self.names, *self._times, *own]
        #: derivatives of the last row
        self._row = np.zeros(0)

    @property
    def derived_names(self) -> list[str]:
        """The signals that are derived."""
        return [q.name for q in self.derived]

    @property
    def columns(self) -> list[str]:
        """Derivatives of the times of rows where they move, and the signals that are derived, each followed by its own."""
        return self._times + [
            c for q in self.derived for c in (q.name, *(derivative_name(q.name, n) for n in self.by.names))
        ]

    def forget(self) -> None:
        self._tangents.reset()

    @property
    def units(self) -> dict[str, str]:
        own = super().units
        d = self.model.declaration
        given = super().units | {n: v.unit for v in (*d.parameters, *d.states) for n in v.names()}
        moved = {m: quotient("s", given.get(n, "1")) for m, n in zip(self._times, self.by.names, strict=False)}
        return own | moved | slope_units(self.derived_names, self.by.names, own, given)

    @property
    def kinds(self) -> dict[str, SignalKind]:
        own = super().kinds
        more: dict[str, SignalKind] = {
            derivative_name(q.name, n): own[q.name] for q in self.derived for n in self.by.names
        }
        more |= dict.fromkeys(self._times, "observable")
        return own | more

    # -- values ------------------------------------------------------------------------------------------------------

    def cut(self, name: str) -> None:
        self._tangents.cut([name])

    def read(self) -> Array:
        """Values of `names` now."""
        own = super().read()
        if self._last is None:
            i = self.instance
            x, u, p = i.x[: self.model.step.nx].copy(), self._inputs.u.copy(), i.parameters.copy()
            blocks = self._tangents.at_start(i.time, self._given, x, u, p, i.signal("a_end").copy())
            self._row = self._derived(blocks)[0]
        return np.concatenate([own, self._row])

    def _derived(self, blocks: dict[str, Array]) -> Array:
        """The derivative columns of rows (n x columns)."""
        found = of_quantities(self.derived, blocks, self.by)
        found = found.reshape(len(found), -1)
        return np.hstack([blocks["t"][:, 0], found]) if self._times else found

    # -- steps -------------------------------------------------------------------------------------------------------

    def wanted(self, instance: Any) -> tuple[str, ...]:
        known = super().wanted(instance)
        return known if "unknowns" in known else (*known, "unknowns")

    def ran(self, instance: Any, t0: float, h: float, n: int, first: int, inputs: Array | None) -> Steps:
        self.require_continued(t0 + first * h)
        u = self._inputs.u.copy()
        r = instance.run(t0, h, n, record=self.wanted(instance), inputs=inputs, first=first)
        starts = np.asarray(t0 + h * (first + np.arange(n)), np.float64)
        return self._with_derivatives(instance, r, starts, h, u, inputs)

    def kept(self) -> Any:
        return self._tangents.kept(), self._last, self._row

    def back(self, kept: Any) -> None:
        tangents, self._last, self._row = kept
        self._tangents.back(tangents)

    def _with_derivatives(
        self, instance: Any, r: dict[str, Array], t: Array, h: float, u: Array, inputs: Array | None
    ) -> Steps:
        """The record of steps from the times t, with the derivatives of their rows; `u`: inputs that are held throughout."""
        assert self._last is not None
        model = self.model_of(instance)
        steps = TakenSteps.recorded(model, instance, r, t, h, self._last, u if inputs is None else np.asarray(inputs))
        if self.model.events is None:
            self._tangents.enter(model, None)
        rows = self._derived(self._tangents.over(steps))
        self._last, self._row = steps.after[-1].copy(), rows[-1]
        found = self.steps_of(instance, r)
        return replace(found, signals=np.hstack([found.signals, rows]))

    def follow_landed(
        self, found: LandedSteps, steps: Steps | None, row: tuple[StepEvent, Array] | None
    ) -> tuple[Steps | None, tuple[StepEvent, Array] | None]:
        part, layout, e = found.part, self.instance.layout, found.part.happened
        model = self.model_in(found.mode)
        x, n, nx = found.x, len(part.t), model.step.nx
        a = e.signals[layout["a_end"]] if e is not None else np.zeros(0)
        self._tangents.enter(self.model_in(found.mode), self.maps_in(found.mode))
        if steps is not None:
            if len(found.rows) != n:
                raise in_parts(model, float(part.t[0]), float(part.h.max()))
            ends, a_end = (part.rows["signals"][:, layout[block]] for block in ("x", "a_end"))
            cuts = np.cumsum([2 + nx, model.step.nw])
            _, w, u = np.split(found.rows, cuts, axis=1)
            before = np.vstack([x[None], ends[:-1]])
            taken = TakenSteps(part.t, part.h, before, ends, w, u, found.p, a_end)
            rows = self._derived(self._tangents.over(taken, () if e is None else e.events, self._grid[0].h))
            self._row, x, a = rows[-1], ends[-1], a_end[-1]
            steps = replace(steps, signals=np.hstack([steps.signals, rows]))
        if e is not None and row is not None:
            x_after, a_after = e.signals[layout["x"]], e.signals[layout["a_end"]]
            old = EventInstant(e.t, x, a, found.u, found.after)
            self._tangents.jump(old, e.events, e.rests)
            if self.entry is not None and found.entered is not None:
                jumped = self.maps_in(found.mode).jumped(old, e.events, e.rests)
                self._tangents.entered(self.entry.slope(replace(old, x=jumped), x_after))
                self._tangents.enter(self.model_in(found.entered), self.maps_in(found.entered))
            self._row = self._derived(self._tangents.at(EventInstant(e.t, x_after, a_after, found.u, found.after)))[0]
            row = row[0], np.concatenate([row[1], self._row])
        return steps, row


def slope_units(
    signals: Sequence[str], names: Sequence[str], over: Mapping[str, str], under: Mapping[str, str]
) -> dict[str, str]:
    """The units of `d(signal)/d(name)`, from those of signals and of names."""
    return {derivative_name(s, n): quotient(over.get(s, "1"), under.get(n, "1")) for s in signals for n in names}


def quotient(over: str, under: str) -> str:
    """The unit of a derivative."""
    return over if under == "1" else f"{'1' if over == '1' else over}/({under})"
