"""The state of a Python instance: everything a step depends on and changes."""

from __future__ import annotations

from dataclasses import dataclass, field, replace
from itertools import zip_longest
from typing import Any

import numpy as np
from numpy.typing import NDArray

from phfmu.discretise.model import Model
from phfmu.outcome.limits import LIMITS

Array = NDArray[Any]

COUNTERS = ("steps", "solves", "iterations", "restarts", "line_searches", "substeps", "exchanged", "woken")


@dataclass
class State:
    """A copy of it is a saved state.

    x [states | t], carry (owed by compensated summation), w and h_last (last solve), a (algebraic means), u (k x nu
    inputs), p, t;  theta: where in its step a node input is read for end values;  x_old, u_old: state and
    inputs at the start of the last step, w_old, h_old: what w and h_last were;  y_step, energy: pair
    outputs and energies;
    y_node: pair outputs at the nodes of the last step (k x nq);
    dissipated, supplied, residual: cumulative per component;  last: the last step's ledger;  end: cached end values;
    rests: constraints that are left out;  placed: which ones has to be chosen, as state or parameters are new;
    path: (start, part, time, length) of each of its solves, [start, start + part] of the step, none before the first one;
    halved: how many of its internal steps were halved;
    impulses, impulses_old: at start and end of the coming and of the last step (2 x n), empty until set;
    changes: (number, time, rests, needed), the last of them.
    """

    x: Array
    carry: Array
    w: Array
    h_last: float
    a: Array
    u: Array
    p: Array
    t: float
    theta: float
    x_old: Array
    u_old: Array
    w_old: Array
    h_old: float
    y_step: Array
    y_node: Array
    energy: Array
    dissipated: Array
    supplied: Array
    residual: Array
    last: dict[str, Array] = field(default_factory=dict)
    end: dict[str, Array] | None = None
    counts: dict[str, int] = field(default_factory=dict)
    rests: Array = field(default_factory=lambda: np.zeros(0, bool))
    placed: bool = True
    path: list[tuple[float, float, float, float]] = field(default_factory=list)
    halved: int = 0
    impulses: Array = field(default_factory=lambda: np.zeros((2, 0)))
    impulses_old: Array = field(default_factory=lambda: np.zeros((2, 0)))
    changes: list[tuple[int, float, int, int]] = field(default_factory=list)

    def copy(self) -> State:
        """All arrays anew: nothing that is done to one is seen in the other."""
        return replace(self, **{name: _copied(value) for name, value in vars(self).items()})

    def change_rest(self, rests: Array, time: float) -> None:
        """Other constraints are left out from `time` on: each new one instead of one that is needed, as far as they go."""
        more, less = np.flatnonzero(rests & ~self.rests).tolist(), np.flatnonzero(self.rests & ~rests).tolist()
        n = self.changes[-1][0] if self.changes else 0
        new = [(n + 1 + k, time, i, j) for k, (i, j) in enumerate(zip_longest(more, less, fillvalue=-1))]
        self.changes = [*self.changes, *new][-int(LIMITS["KEPT_CHANGES"]) :]
        self.rests = rests.copy()

    @classmethod
    def at_start(cls, m: Model) -> State:
        """The start values of a model, nothing solved yet."""
        plan, x, u = m.step, np.append(m.x0, m.t0), np.tile(m.u0, m.step.k)
        return cls(
            x=x,
            carry=np.zeros(plan.nx),
            w=np.zeros(plan.nw),
            h_last=0.0,
            a=m.a0.copy(),
            u=u,
            p=m.p0.copy(),
            t=m.t0,
            theta=0.0,
            x_old=x.copy(),
            u_old=u.copy(),
            w_old=np.zeros(plan.nw),
            h_old=0.0,
            y_step=np.zeros(plan.nq),
            y_node=np.zeros((plan.k, plan.nq)),
            energy=np.zeros(plan.nq),
            dissipated=np.zeros(plan.ncomp),
            supplied=np.zeros(plan.ncomp),
            residual=np.zeros(plan.ncomp),
            counts=dict.fromkeys(COUNTERS, 0),
            rests=plan.hold.rests.copy(),
        )


def _copied(value: Any) -> Any:
    """The value with the arrays in it anew; numbers and tuples of numbers do not change."""
    if isinstance(value, np.ndarray):
        return value.copy()
    if isinstance(value, dict):
        return {name: _copied(v) for name, v in value.items()}
    return list(value) if isinstance(value, list) else value
