"""Ringing after events: a decay much faster than the step, which Gauss nodes do not damp, and no ledger sees.

A mode x' = -x/T is multiplied by R(-h/T) in a step, with R -> (-1)^k for k nodes: for odd k the ends of the steps alternate
about the solution, for even k they stay beside it, while the values at the nodes are near the solution in both cases.  So the
increments of a state change their sign at every end of a step: from end to end for odd k, from the last node over the end to
the first node for even k.  No solution that the steps resolve does that several times in a row.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from phfmu.discretise.within import polynomial_of
from phfmu.network.couplings.monolithic import Monolithic
from phfmu.network.members.engine_member import EngineMember
from phfmu.outcome.steps import Steps
from phfmu.runs.march.restart import fitting
from phfmu.signals import of_member
from phfmu.words import counted

if TYPE_CHECKING:
    from phfmu.discretise.model import Model
    from phfmu.network.couplings.stepper import Stepper
    from phfmu.runs.march.stretches import Stretch

Array = NDArray[Any]

#: steps after an event that are looked at, and the last of them that are judged
WINDOW, JUDGED = 8, 6
#: what a swing is told from: relative to the values in the middle of steps, and to the nominal value of the state
SWING, SMALL = 0.05, 1e-5
#: windows that are judged together
TOGETHER = 16
#: most windows for one name of events, lines told, states named in a line
WINDOWS, LINES, NAMED = 4, 4, 3


class Ringing:
    """Watches the states of a run in the steps after its events, `damped` of which are damped; nothing where nothing happens.

    Even numbers of nodes need the unknowns of the steps, which are told in the steps after an event, and in all steps that end
    on state events, since these come unannounced, until there were as many as are looked at; after those inside the steps of
    members they are told from the next block on.  Models with ideal switches, whose unknowns change, are looked at with odd
    numbers only.
    """

    CARRIED = ("_told", "_guarded", "_seen", "_event", "left", "_rows", "_windows", "_lines", "_more")

    def __init__(self, stepper: Stepper, h: float, damped: int):
        self._stepper, self._h, self._damped, self._told = stepper, h, damped, False
        self._watched = _watched(stepper)
        self._even = any(w.even for w in self._watched)
        #: windows after state events until which steps tell their unknowns
        self._guarded = WINDOWS * stepper.guards if self._even else 0  # pyright: ignore[reportAttributeAccessIssue]
        self._seen = dict[str, int]()
        self._event: tuple[float, str] | None = None
        #: steps that are still to be looked at
        self.left = 0
        self._rows = list[tuple[Array, Array | None]]()
        self._windows = list[_Window]()
        self._lines: list[str] = []
        self._more = 0

    def block(self, most: int) -> int:
        """Number of steps to take at once, of `most`; those after an event tell their unknowns where these are needed."""
        if not self._even:
            return most
        if self._told != (told := self.left > 0 or self._guarded > 0):
            self._stepper.unknowns_told = self._told = told  # pyright: ignore[reportAttributeAccessIssue]
        return min(most, self.left) if self.left and not self._stepper.lands else most

    def changed(self, stretch: Stretch) -> None:
        """The events at the start of a stretch."""
        if stretch.events:
            self._begin(stretch.start, ", ".join(f"{e.name} = {e.value:.6g}" for e in stretch.events))

    def happened(self, t: float, name: str) -> None:
        """A state event."""
        self._begin(t, name)
        self._guarded -= self.left > 0

    def _begin(self, t: float, name: str) -> None:
        """Steps are looked at from here on."""
        seen = self._seen.get(name, 0)
        if not self._watched or seen >= WINDOWS:
            self.left = 0
            return
        self._seen[name] = seen + 1
        self._event, self.left, self._rows = (t, name), WINDOW, []

    def add(self, steps: Steps, damped: bool = False) -> None:
        """Steps as they were taken; with damped ones a window begins anew."""
        if not steps.events:
            if self.left:
                self._look(steps, 0, len(steps.H), damped)
            return
        begun = 0
        for i, e in steps.events:  # inside the steps of members
            self._look(steps, begun, i + 1, damped)
            self.happened(e.t, e.names)
            begun = i + 1
        if not self._even or self._told:  # else the steps of the next block are looked at
            self._look(steps, begun, len(steps.H), damped)

    def _look(self, steps: Steps, begun: int, end: int, damped: bool) -> None:
        if not self.left or begun == end:
            return
        if damped:
            self.left, self._rows = WINDOW, []
            return
        end = min(end, begun + self.left)
        self._rows.append((steps.signals[begun:end], None if steps.unknowns is None else steps.unknowns[begun:end]))
        self.left -= end - begun
        if not self.left:
            assert self._event is not None
            self._windows.append(_Window(*self._event, *_joined(self._rows)))
            self._rows = []
            if len(self._windows) == TOGETHER:
                self._judge()

    def notes(self) -> list[str]:
        """A line for each event after which states rang."""
        self._judge()
        if not self._lines:
            return []
        return [
            *self._lines,
            *([f"and so after {counted(self._more, 'more event')}"] if self._more else []),
            self._remedy(),
        ]

    def _judge(self) -> None:
        """The windows, together: most often nothing turns in any."""
        windows, self._windows = self._windows, []
        if not windows:
            return
        found = [(w, swings) for w in self._watched if (swings := w.swings(windows)) is not None]
        for i, window in enumerate(windows) if found else ():
            rings = [
                (x / size, n, x, w.even)
                for w, swings in found
                for n, size, x in zip(w.names, w.nominal, swings[i], strict=True)
                if x
            ]
            if rings:
                self._tell(window, sorted(rings, key=lambda ring: -ring[0]))

    def _tell(self, window: _Window, rings: list[tuple[float, str, float, bool]]) -> None:
        """A line about a window; rings: (relative size, state, size, whether for an even number of nodes), the worst first."""
        if len(self._lines) == LINES:
            self._more += 1
            return
        some = ", ".join(f"{n} by {x:.3g} {self._unit(n)}".rstrip() for _, n, x, _ in rings[:NAMED])
        more = f" and {len(rings) - NAMED} more" if len(rings) > NAMED else ""
        what = "stay beside the solution" if rings[0][3] else "swing about the solution from step to step"
        self._lines.append(f"ringing after {window.name} at t = {window.t:.9g} s: ends of steps {what}: {some}{more}")

    def _unit(self, name: str) -> str:
        unit = self._stepper.units.get(name, "1")
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


@dataclass(slots=True)
class _Window:
    """The last steps of those looked at after an event: ends of one more than are judged (n + 1 x columns), and the unknowns
    of those that are (n x all), None where they were not told."""

    t: float
    name: str
    ends: Array
    unknowns: Array | None


def _joined(rows: list[tuple[Array, Array | None]]) -> tuple[Array, Array | None]:
    """Ends and unknowns of the last steps of a window."""
    ends = np.concatenate([signals for signals, _ in rows])[-JUDGED - 1 :]
    told = [unknowns for _, unknowns in rows if unknowns is not None]
    return ends, np.concatenate(told)[-JUDGED:] if len(told) == len(rows) else None


class _WatchedStates:
    """The states of a model among the columns of a stepper, and its unknowns (at `place`) among those that it tells.

    `even`: whether it is looked at from node to node.
    """

    def __init__(self, stepper: Stepper, member: str, model: Model, place: slice, even: bool):
        self._columns_of, self._member, self._model, self._place, self.even = stepper.names, member, model, place, even

    @cached_property
    def _states(self) -> list[tuple[str, float, int, int]]:
        """Name, nominal value, place among the columns, place among all states."""
        there, member = {n: i for i, n in enumerate(self._columns_of)}, self._member
        variables = self._model.declaration.states
        states = [(n, size) for v in variables for n, size in zip(v.names(), v.nominal, strict=True)]
        named = [(of_member(member, n) if member else n, abs(size) or 1.0) for n, size in states]
        return [(n, size, there[n], i) for i, (n, size) in enumerate(named) if n in there]

    @cached_property
    def names(self) -> list[str]:
        return [n for n, _, _, _ in self._states]

    @cached_property
    def nominal(self) -> Array:
        return np.array([size for _, size, _, _ in self._states])

    @cached_property
    def _columns(self) -> list[int]:
        return [column for _, _, column, _ in self._states]

    def swings(self, windows: list[_Window]) -> Array | None:
        """By how much each state swings over each window (windows x states), 0 for those that do not; None where none does."""
        if not self._columns:
            return None
        x = np.array([window.ends for window in windows])[:, :, self._columns]
        if self.even:
            return self._from_nodes(x, windows)
        change = x[:, 1:] - x[:, :-1]
        turns: Array = np.all(change[:, :-1] * change[:, 1:] < 0, axis=1)
        if not turns.any():
            return None
        return _standing(turns, 0.5 * change[:, :-1], 0.5 * change[:, 1:], 0.5 * (x[:, 1:] + x[:, :-1]), self.nominal)

    def _from_nodes(self, x: Array, windows: list[_Window]) -> Array | None:
        untold = np.full((JUDGED, self._place.stop), np.nan)
        told = [untold if window.unknowns is None else window.unknowns[:, : self._place.stop] for window in windows]
        own = [i for _, _, _, i in self._states]
        last, first = (d[:, :, own] for d in self._nodes.increments(np.array(told)[:, :, self._place]))
        turns: Array = np.all(last[:, :-1] * first[:, 1:] < 0, axis=1)
        return _standing(turns, last[:, :-1], first[:, 1:], x[:, 1:] - last, self.nominal) if turns.any() else None

    @cached_property
    def _nodes(self) -> _Nodes:
        return _Nodes(self._model)


def _watched(stepper: Stepper) -> list[_WatchedStates]:
    """Models that are stepped here by schemes without loss."""
    if isinstance(stepper, Monolithic):
        model = stepper.model
        even = model.step.k % 2 == 0 and model.modes is None
        return [] if model.loses_energy else [_WatchedStates(stepper, "", model, slice(0, model.step.nw), even)]
    from phfmu.network.couplings.coupled import Coupled

    found, at = list[_WatchedStates](), 0
    for m in stepper.joined.members if isinstance(stepper, Coupled) else []:
        if isinstance(m, EngineMember):
            even, place = m.model.step.k % 2 == 0 and m.model.modes is None, slice(at, at + len(m.instance.unknowns))
            at = place.stop
            if not m.model.loses_energy:
                found.append(_WatchedStates(stepper, m.name, m.model, place, even))
    return found


class _Nodes:
    """The way of the states from the last node of a step over its end to the first node of the next one."""

    def __init__(self, model: Any):
        polynomial, nodes = polynomial_of(model), model.scheme.nodes
        self._state, self._w, self._states = polynomial.state, polynomial.w, polynomial.nx
        self._last, self._first = (nodes.b - nodes.a[-1])[polynomial.node], nodes.a[0][polynomial.node]

    def increments(self, unknowns: Array) -> tuple[Array, Array]:
        """From the last node to the end, and from the start to the first node (windows x n x states each)."""
        found = np.zeros((2, self._states, *unknowns.shape[:2]))
        for out, weights in zip(found, (self._last, self._first), strict=True):
            np.add.at(out, self._state, np.moveaxis(weights * unknowns[:, :, self._w], 2, 0))
        return np.moveaxis(found[0], 0, 2), np.moveaxis(found[1], 0, 2)


def _standing(turns: Array, before: Array, after: Array, middle: Array, nominal: Array) -> Array | None:
    """The least change before and after the ends of steps, of states that turn at all of them and stand out; else 0.

    All (windows x n x states), turns without n;  middle: values in the middle of the steps;  None where no state stands out
    """
    size = np.minimum(np.abs(before), np.abs(after)).min(axis=1)
    out = turns & (size > np.maximum(SWING * np.abs(middle).max(axis=1), SMALL * nominal))
    return np.where(out, size, 0.0) if out.any() else None
