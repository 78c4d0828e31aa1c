"""Impulses at the ports of a member, at the start and at the end of a step: x0* = x + L(x) s0, the step, x1 = x1* + L(x1*) s1.

They are two maps of the state outside the step, whose plan does not know them. Through a port goes, by the member's own books,

    h sum_i b_i u_i . y_i + s0 . (y0 + S0 s0 / 2) + s1 . (y1* + S1 s1 / 2),      y1* = y1 - S1 s1,

exactly, as H is quadratic along L; where it is not, the work is the integral of y along L s by a Gauss rule.  Source of the
conditions: `terms/port_impulses.py`.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property, lru_cache

import casadi as ca
import numpy as np
from numpy.typing import ArrayLike, NDArray

from phfmu.declare.entries.alike import first_alike
from phfmu.declare.phdae import PHDAE
from phfmu.engine.reference.state import State
from phfmu.gradients.quadrature import gauss
from phfmu.outcome.status import Status, StepFailure
from phfmu.terms.port_impulses import Impulse, PortForms, PortImpulse, port_impulses

Array = NDArray[np.float64]

#: Gauss points of the work of an impulse along which H is not quadratic.
WORK_POINTS = 5


@dataclass(frozen=True, eq=False)
class PortKernels:
    """Functions of all states x, all parameters p and impulses s (n):

    shift:    (x, p, s) -> L s on the states of `forms`, mean of y along it
    jump:     (x, p) -> S (n x n)
    tangent:  (x, p, s, dx, ds) -> change of L s
    slopes:   (x, p, s, dx, dp) -> change of L s by p alone, of S by both (n x n)
    """

    forms: PortForms
    shift: ca.Function
    jump: ca.Function
    tangent: ca.Function
    slopes: ca.Function

    @property
    def n(self) -> int:
        return len(self.forms.pairs)


def port_kernels(model: PHDAE) -> PortKernels:
    """The impulses of a model's ports as functions, the same for all that are alike."""
    return _port_kernels(first_alike(model))


@lru_cache(maxsize=64)
def _port_kernels(model: PHDAE) -> PortKernels:
    f = port_impulses(model)
    s, ds = ca.SX.sym("s", len(f.pairs)), ca.SX.sym("ds", len(f.pairs))
    dx, dp = ca.SX.sym("dx", f.x.numel()), ca.SX.sym("dp", f.p.numel())
    shift = ca.mtimes(f.L, s)
    along = ca.jtimes(shift, ca.vertcat(f.x, s), ca.vertcat(dx, ds))
    turned = ca.jtimes(ca.vec(f.S), ca.vertcat(f.x, f.p), ca.vertcat(dx, dp))
    mean = f.y + ca.mtimes(f.S, s) / 2
    if any(p.kind is Impulse.END for p in f.ports):
        mean = ca.SX.zeros(len(f.pairs))
        for t, w in zip(*gauss(WORK_POINTS), strict=True):
            there = ca.SX(f.x)
            there[list(f.states)] += float(t) * shift
            mean += float(w) * ca.substitute(f.y, f.x, there)
    return PortKernels(
        f,
        _function("shift", [f.x, f.p, s], [shift, mean]),
        _function("jump", [f.x, f.p], [f.S]),
        _function("tangent", [f.x, f.p, s, dx, ds], [along]),
        _function("slopes", [f.x, f.p, s, dx, dp], [ca.jtimes(shift, f.p, dp), turned]),
    )


def _function(name: str, arguments: list[ca.SX], results: list[ca.SX]) -> ca.Function:
    return ca.Function(name, arguments, ca.cse([ca.densify(r) for r in results]), {"allow_free": False})


class Ports:
    """The ports of a model with their impulses, found out when first asked for."""

    def __init__(self, model: PHDAE):
        self._model = model

    @cached_property
    def kernels(self) -> PortKernels:
        return port_kernels(self._model)

    @property
    def name(self) -> str:
        return self._model.name

    @property
    def offered(self) -> tuple[PortImpulse, ...]:
        return self.kernels.forms.ports

    def checked(self, s0: ArrayLike, s1: ArrayLike) -> Array:
        """Impulses at start and end (2 x n); ValueError where the model does not take them."""
        n = self.kernels.n
        if not n:
            why = "; ".join(f"{p.port}: {p.reason}" for p in self.offered) or "it has no ports"
            raise ValueError(f"{self._model.name}: no port takes impulses ({why})")
        start, end = (np.asarray(v, float) for v in (s0, s1))
        if start.shape != (n,) or end.shape != (n,) or not np.isfinite([start, end]).all():
            names = [self._names[j] for j in self.kernels.forms.pairs]
            raise ValueError(
                f"{self._model.name}: expected {n} finite impulses at start and end, for {', '.join(names)}"
            )
        return np.array([start, end])

    def require_none(self, s: Array) -> None:
        """Raise ValueError if there are impulses, for many steps at once."""
        if s.any():
            raise ValueError(f"{self.name}: impulses belong to single steps (do_step); set them to 0 before run")

    @cached_property
    def _names(self) -> list[str]:
        return [name for p in self._model.ports if p.external for name in p.input_names()]


class PythonImpulses:
    """Impulses on the state of a Python instance; the twin of runtime/impulses.c."""

    def __init__(self, ports: Ports):
        self.ports = ports

    def kick(self, s: State, impulse: Array) -> None:
        """One impulse: moves the state through its compensated sum and books its work in the ledger of the step."""
        if not impulse.any():
            return
        kernels, forms = self.ports.kernels, self.ports.kernels.forms
        shift, mean = (np.array(v).ravel() for v in kernels.shift(s.x[:-1], s.p, impulse))
        where, count = list(forms.states), len(s.supplied)
        with np.errstate(over="ignore", invalid="ignore"):
            work = impulse * mean
        if not (np.isfinite(shift).all() and np.isfinite(work).all()):
            raise StepFailure(Status.NOT_FINITE, self.ports.name, s.x[-1], 0.0)
        change = shift + s.carry[where]
        total = s.x[where] + change
        s.carry[where] = change - (total - s.x[where])
        s.x[where] = total
        by_owner = np.bincount(forms.owner, work, count)
        s.last["stored"] += by_owner
        s.last["supplied"] += by_owner
        s.last["moved"] += np.bincount(forms.owner, np.abs(work), count)
        s.last["pairs"][list(forms.pairs)] += work

    def more(self, s: State, impulse: Array) -> None:
        """One more impulse at the end of the last step, in its ledger and in the cumulative sums."""
        booked, s.last = s.last, {name: np.zeros_like(rows) for name, rows in s.last.items()}
        try:
            self.kick(s, impulse)
            s.energy += s.last["pairs"]
            s.supplied += s.last["supplied"]
        finally:
            s.last = {name: rows + s.last[name] for name, rows in booked.items()}
        s.impulses_old[1] += impulse
        s.end = None

    def start_along(self, s: State, dx: Array, ds: Array) -> Array:
        """Directions of the states after the impulse at the start of the last step, from `ds` (m x n)."""
        return self._along(s.x_old, s.p, np.zeros(self.ports.kernels.n), dx, ds)

    def end_along(self, s: State, dx: Array, ds: Array) -> Array:
        """Directions of the states after the impulse at the end of the last step; the state there is the present one."""
        return self._along(s.x, s.p, s.impulses_old[1], dx, ds)

    def _along(self, x: Array, p: Array, s: Array, dx: Array, ds: Array) -> Array:
        """L does not change along its own shifts: it is the same before and after the impulse."""
        kernels, dx = self.ports.kernels, dx.copy()
        where, nx = list(kernels.forms.states), kernels.forms.x.numel()
        for j in range(len(dx)):
            dx[j, where] += np.array(kernels.tangent(x[:nx], p, s, dx[j, :nx], ds[j])).ravel()
        return dx
