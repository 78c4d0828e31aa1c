"""Ringing after events: a decay much faster than the step, which Gauss nodes do not damp, and no ledger sees.

A mode x' = -x/T is multiplied by R(-h/T) in a step, with R -> (-1)^k for k nodes: for odd k the ends of the steps alternate
about the solution, for even k they stay beside it, while the values at the nodes are near the solution in both cases.  So the
increments of a state change their sign at every end of a step: from end to end for odd k, from the last node over the end to
the first node for even k.  No solution that the steps resolve does that several times in a row.
"""

from __future__ import annotations

from collections import Counter
from functools import cached_property
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from phfmu.discretise.within import polynomial_of
from phfmu.network.couplings.monolithic import Monolithic
from phfmu.network.members.engine_member import EngineMember
from phfmu.outcome.steps import Steps
from phfmu.runs.restart import fitting
from phfmu.signals import of_member
from phfmu.words import counted

if TYPE_CHECKING:
    from phfmu.discretise.model import Model
    from phfmu.network.couplings.stepper import Stepper
    from phfmu.runs.stretches import Stretch

Array = NDArray[Any]

#: steps after an event that are looked at, and the last of them that are judged
WINDOW, JUDGED = 8, 6
#: what a swing is told from: relative to the values in the middle of steps, and to the nominal value of the state
SWING, SMALL = 0.05, 1e-5
#: most windows for one name of events, lines told, states named in a line
WINDOWS, LINES, NAMED = 4, 4, 3


class Ringing:
    """Watches the states of a run in the steps after its events, `damped` of which are damped; nothing where nothing happens.

    Even numbers of nodes need the unknowns of the steps: then the steps after state events, which come unannounced within a
    block, are not watched, nor models with ideal switches, whose unknowns change.
    """

    def __init__(self, stepper: Stepper, h: float, damped: int):
        found = _states(stepper)
        names = [n for n in stepper.names if n in found]
        self._stepper, self._h, self._damped, self._names = stepper, h, damped, names
        self._columns = [stepper.names.index(n) for n in names]
        self._nominal = np.array([found[n] for n in names])
        self._even = _even(stepper)
        self._seen = Counter[str]()
        self._event: tuple[float, str] | None = None
        self._rows, self._unknowns = list[Array](), list[Array]()
        self._lines: list[str] = []
        self._more = 0

    @property
    def left(self) -> int:
        """Steps that are still to be looked at."""
        return 0 if self._event is None else WINDOW - sum(map(len, self._rows))

    def block(self, most: int) -> int:
        """How many of `most` steps to take at once; those after an event tell their unknowns where these are needed."""
        if not self._even:
            return most
        self._stepper.unknowns_told = self.left > 0  # pyright: ignore[reportAttributeAccessIssue]
        return min(most, self.left) if self.left else most

    def changed(self, stretch: Stretch) -> None:
        """The events at the start of a stretch."""
        if stretch.events:
            self._begin(stretch.start, ", ".join(f"{e.name} = {e.value:.6g}" for e in stretch.events))

    def happened(self, t: float, name: str) -> None:
        """A state event."""
        if not self._even:
            self._begin(t, name)
        else:
            self._event = None

    def _begin(self, t: float, name: str) -> None:
        if not self._names or self._seen[name] >= WINDOWS:
            self._event = None
            return
        self._seen[name] += 1
        self._event, self._rows, self._unknowns = (t, name), [], []

    def add(self, steps: Steps, damped: bool = False) -> None:
        """Steps as they were taken; with damped ones a window begins anew."""
        left = self.left
        if not left:
            return
        if damped:
            self._rows, self._unknowns = [], []
            return
        self._rows.append(steps.signals[:left, self._columns])
        if steps.unknowns is not None:
            self._unknowns.append(steps.unknowns[:left])
        if self.left == 0:
            self._judge()

    def notes(self) -> list[str]:
        """A line for each event after which states rang."""
        if not self._lines:
            return []
        return [
            *self._lines,
            *([f"and so after {counted(self._more, 'more event')}"] if self._more else []),
            self._remedy(),
        ]

    def _judge(self) -> None:
        assert self._event is not None
        (t, name), self._event = self._event, None
        ends = np.concatenate(self._rows)
        if not self._even:
            swing = _alternating(ends, self._nominal)
        else:
            swing = self._nodes.swing(ends, np.concatenate(self._unknowns), self._nominal)
        rings = np.flatnonzero(swing)
        if not rings.size:
            return
        if len(self._lines) == LINES:
            self._more += 1
            return
        worst = rings[np.argsort(-swing[rings] / self._nominal[rings], kind="stable")]
        some = ", ".join(f"{self._names[i]} by {swing[i]:.3g} {self._unit(i)}".rstrip() for i in worst[:NAMED])
        more = f" and {len(worst) - NAMED} more" if len(worst) > NAMED else ""
        what = "stay beside the solution" if self._even else "swing about the solution from step to step"
        self._lines.append(f"ringing after {name} at t = {t:.9g} s: ends of steps {what}: {some}{more}")

    @cached_property
    def _nodes(self) -> _Nodes:
        return _Nodes(self._stepper.model)  # pyright: ignore[reportAttributeAccessIssue]

    def _unit(self, i: int) -> str:
        unit = self._stepper.units.get(self._names[i], "1")
        return "" if unit == "1" else unit

    @property
    def _damps(self) -> bool:
        """Whether the stepper takes damping steps."""
        try:
            fitting(self._stepper)
        except ValueError:
            return False
        return True

    def _remedy(self) -> str:
        whole = isinstance(self._stepper, Monolithic)
        drifts = whole and bool(self._stepper.model.declaration.constraints)  # pyright: ignore[reportAttributeAccessIssue]
        ways = ["smaller steps"]
        if whole:
            ways += ["steps within a tolerance (--rtol)"]
        if not drifts:
            ways += ["damping in all steps (--scheme radau)"]
        if self._damps:
            more = f"more damping steps after events (--restart {2 * self._damped})"
            ways += [more if self._damped else "damping steps after events (--restart 2)"]
        ways.reverse()
        return (
            f"what rings decays faster than a step of {self._h:g} s, and the ledger does not see it; take "
            f"{', '.join(ways[:-1])}{' or ' if ways[:-1] else ''}{ways[-1]}"
        )


def _states(stepper: Stepper) -> dict[str, float]:
    """States of models that are stepped here by schemes without loss, with their nominal values."""
    models: list[tuple[str, Model]] = []
    if isinstance(stepper, Monolithic):
        models = [("", stepper.model)]
    else:
        from phfmu.network.couplings.coupled import Coupled

        members = stepper.joined.members if isinstance(stepper, Coupled) else []
        models = [(m.name, m.model) for m in members if isinstance(m, EngineMember)]
    return {
        of_member(member, name) if member else name: abs(nominal) or 1.0
        for member, model in models
        if not model.loses_energy
        for v in model.declaration.states
        for name, nominal in zip(v.names(), v.nominal, strict=True)
    }


def _even(stepper: Stepper) -> bool:
    return isinstance(stepper, Monolithic) and stepper.model.step.k % 2 == 0 and stepper.model.modes is None


def _alternating(ends: Array, nominal: Array) -> Array:
    """By how much each state alternates over the ends of the last steps (n x states), 0 for those that do not."""
    change = np.diff(ends[-JUDGED - 1 :], axis=0)
    return _swing(0.5 * change[:-1], 0.5 * change[1:], 0.5 * (ends[-JUDGED:] + ends[-JUDGED - 1 : -1]), nominal)


class _Nodes:
    """The way of the states from the last node of a step over its end to the first node of the next one."""

    def __init__(self, model: Any):
        polynomial, nodes = polynomial_of(model), model.scheme.nodes
        self._state, self._w = polynomial.state, polynomial.w
        self._last, self._first = ((nodes.b - nodes.a[-1])[polynomial.node], nodes.a[0][polynomial.node])

    def swing(self, ends: Array, unknowns: Array, nominal: Array) -> Array:
        """By how much each state turns at the ends of the last steps (n x states), 0 for those that do not."""
        before, after = (self._sums(weights, unknowns[-JUDGED:]) for weights in (self._last, self._first))
        return _swing(before[:-1], after[1:], ends[-JUDGED:] - before, nominal)

    def _sums(self, weights: Array, unknowns: Array) -> Array:
        """Weighted sums of the increments of each state (n x states)."""
        out = np.zeros((len(unknowns), int(self._state.max(initial=-1)) + 1))
        np.add.at(out.T, self._state, (weights * unknowns[:, self._w]).T)
        return out


def _swing(before: Array, after: Array, middle: Array, nominal: Array) -> Array:
    """The least change before and after the ends of steps, if it always has the other sign and stands out; else 0."""
    turns = (before * after < 0).all(axis=0)
    size = np.minimum(np.abs(before), np.abs(after)).min(axis=0)
    return np.where(turns & (size > np.maximum(SWING * np.abs(middle).max(axis=0), SMALL * nominal)), size, 0.0)
