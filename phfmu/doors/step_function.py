"""Equal steps of a model as one function of states, held inputs, parameters and time, with derivatives of any order.

    F(x, w, u, p, t, h) = 0,   x1 = x + U w,   y = T(x, w, u, p, t, h),

of which an instance finds w.  CasADi knows F and T, and of w the implicit function theorem,

    dw = -A^-1 (F_x dx + F_u du + F_p dp + F_t dt),   (x, u, p, t)_bar = -F_(x,u,p,t)^T A^-T w_bar,   A = dF/dw,

with A sparse; both are expressions again, which CasADi differentiates once more.
"""

from __future__ import annotations

from collections.abc import Sequence
from functools import cached_property
from math import isfinite
from threading import RLock
from typing import Any

import casadi as ca
import numpy as np
from numpy.typing import ArrayLike, NDArray

from phfmu.derivatives.plan_function import PlanRows
from phfmu.derivatives.tangents import require_smooth
from phfmu.discretise.model import Model
from phfmu.doors.function import ArgumentBlock
from phfmu.engine.native.native import NativeInstance
from phfmu.engine.reference.python import PythonInstance
from phfmu.outcome.status import NoDerivative, StepFailure

Array = NDArray[np.float64]

#: objects that CasADi calls back: its expressions do not keep them, and live as long as anybody's function does
CALLED: list[ca.Callback] = []


class StepFunction:
    """n equal steps of length h (s): (x, u, p, t) -> (x1, y, dissipated).

    x (nx): states;  u: free inputs of ports, held;  p (np): parameters;  t (1): the start, s;  x1 (nx): states at the end;  y:
    outputs of ports, means over the n steps, so that n h u^T y is the supplied energy;  dissipated (1): energy, J.
    `instance` takes the steps, each from the given values alone.
    Errors: those of `SensitiveSteps` for models without derivatives; ValueError for h, n, an instance of another model; of calls:
    StepFailure, NoDerivative with its time, ValueError for a step in parts and for derivatives that are not finite.
    """

    def __init__(self, model: Model, instance: Any, h: float, n: int = 1):
        require_smooth(model)
        if not (isfinite(h) and h > 0):
            raise ValueError(f"{model.name}: steps of {h} s; their length must be positive and finite")
        if n < 1 or n != int(n):
            raise ValueError(f"{model.name}: {n} steps; expected a whole number from 1")
        if not isinstance(instance, NativeInstance | PythonInstance) or instance.model is not model:
            raise ValueError(
                f"{model.name}: a step function takes a NativeInstance or PythonInstance of this very model, got "
                f"{type(instance).__name__}; units do not tell the unknowns of their steps"
            )
        d = model.declaration
        self.name, self.model, self.h, self.n = model.name, model, h, n
        taken = [(i, not p.sends) for p in d.ports if p.external for i in p.input_names()]
        inputs = [i for i, free in taken if free]
        #: places of the free inputs among all, those of signals that are sent stay 0
        self.places = [j for j, (_, free) in enumerate(taken) if free]
        outputs = [o for p in d.ports if p.external for o in p.output_names()]
        x, p = ([s for v in some for s in v.names()] for some in (d.states, d.parameters))
        self.inputs = tuple(ArgumentBlock(k, tuple(v)) for k, v in {"x": x, "u": inputs, "p": p, "t": ["time"]}.items())
        told = {"x1": x, "y": outputs, "dissipated": ["energy.dissipated"]}
        self.outputs = tuple(ArgumentBlock(k, tuple(v)) for k, v in told.items())
        self.start = model.x0.copy(), model.u0[self.places], model.p0.copy(), np.array([model.t0])
        #: what CasADi takes
        self._unknowns = _Unknowns(self, instance)
        self.function = _several(self, self._unknowns)

    def __call__(self, *arguments: ArrayLike) -> tuple[Array, ...]:
        """(x1, y, dissipated); arguments that are left out are those of the model."""
        return self.values(*arguments, *self.start[len(arguments) :])

    def values(self, *arguments: ArrayLike) -> tuple[Array, ...]:
        return self._called(self.function, self._given(arguments))

    def forward(self, arguments: Sequence[ArrayLike], along: Sequence[ArrayLike]) -> tuple[Array, ...]:
        """J along, per result."""
        given = self._given(arguments)
        seeds = [b.of(v) for b, v in zip(self.inputs, along, strict=True)]
        return self._derived(self._along, self.outputs, [*given, *self._called(self.function, given), *seeds])

    def reverse(self, arguments: Sequence[ArrayLike], bars: Sequence[ArrayLike]) -> tuple[Array, ...]:
        """J^T bars, per argument."""
        given = self._given(arguments)
        seeds = [b.of(v) for b, v in zip(self.outputs, bars, strict=True)]
        return self._derived(self._back, self.inputs, [*given, *self._called(self.function, given), *seeds])

    @cached_property
    def _along(self) -> ca.Function:
        return self.function.forward(1)

    @cached_property
    def _back(self) -> ca.Function:
        return self.function.reverse(1)

    def _given(self, arguments: Sequence[ArrayLike]) -> list[Array]:
        return [b.of(v) for b, v in zip(self.inputs, arguments, strict=True)]

    def _derived(self, function: ca.Function, of: Sequence[ArgumentBlock], given: Sequence[Array]) -> tuple[Array, ...]:
        """The same of derivatives; ValueError where some are not finite."""
        found = self._called(function, given)
        for block, values in zip(of, found, strict=True):
            if lost := [n for n, v in zip(block.names, values.tolist(), strict=True) if not isfinite(v)]:
                raise ValueError(
                    f"{self.name}: the step from t = {given[3][0]:.9g} s has no finite derivative at {lost[0]} ({block.name}), "
                    "as where a power of zero is derived by its exponent; leave that point or that argument"
                )
        return found

    def _called(self, function: ca.Function, given: Sequence[Array]) -> tuple[Array, ...]:
        """Results of a function of CasADi, which hides what was raised within it."""
        self._unknowns.failure = None
        try:
            found = function.call([ca.DM(v) for v in given])
        except RuntimeError as error:
            raise self._unknowns.failure or NoDerivative(float(given[3][0])) from error
        return tuple(np.array(v, float).reshape(-1) for v in found)


class _Unknowns(ca.Callback):
    """(x, u, p, t) -> w, the unknowns of one step, found by an instance; derivatives by the implicit function theorem."""

    def __init__(self, step: StepFunction, instance: Any):
        ca.Callback.__init__(self)
        self._step, self._instance, self._lock = step, instance, RLock()
        #: what the last call raised
        self.failure: Exception | None = None
        instance.reset()
        self._begin = instance.get_state()
        rows, plan = PlanRows(step.model.step), step.model.step
        self._sizes = [b.n for b in step.inputs]
        at = [ca.SX.sym(b.name, b.n) for b in step.inputs]
        u = ca.SX(plan.nu, 1)
        u[step.places] = at[1]
        told = ca.vertcat(rows.outputs[: plan.nu], step.h * ca.sum1(rows.energies(1)))
        of_plan = ca.Function("plan", [rows.x, rows.w, rows.u, rows.p, rows.h], [rows.residual, told])
        F, T = of_plan(ca.vertcat(at[0], at[3]), rows.w, ca.repmat(ca.densify(u), plan.k, 1), at[2], step.h)
        U = ca.DM(plan.nx, plan.nw)
        for i, j, c in zip(plan.update_x, plan.update_w, plan.update_c, strict=True):
            U[int(i), int(j)] += float(c)
        self._F = ca.Function("F", [*at, rows.w], [ca.densify(F)])
        A = ca.Function("A", [*at, rows.w], [ca.jacobian(F, rows.w)])
        self._rows, self._columns = _scales(A, step, plan.nominal)
        scaled = ca.diag(self._rows) @ ca.jacobian(F, rows.w) @ ca.diag(self._columns)
        self._A = ca.Function("A", [*at, rows.w], [scaled])
        self.told = ca.Function("told", [*at, rows.w], [at[0] + U @ rows.w, T[: plan.nu], T[plan.nu]])
        self.construct(f"{plain(step.name)}_unknowns", {})
        CALLED.append(self)

    # -- what CasADi asks --------------------------------------------------------------------------------------------

    def get_n_in(self) -> int:
        return 4

    def get_n_out(self) -> int:
        return 1

    def get_sparsity_in(self, i: int) -> ca.Sparsity:
        return ca.Sparsity.dense(self._sizes[i], 1)

    def get_sparsity_out(self, i: int) -> ca.Sparsity:
        return ca.Sparsity.dense(self._step.model.step.nw, 1)

    def eval(self, arg: Sequence[ca.DM]) -> list[ca.DM]:
        x, u, p, t = (np.array(a, float).reshape(-1) for a in arg)
        try:
            return [ca.DM(self._solved(x, u, p, float(t[0])))]
        except (StepFailure, ValueError) as failure:
            self.failure = failure
            raise

    def has_forward(self, nfwd: int) -> bool:
        return True

    def get_forward(self, nfwd: int, name: str, inames: Any, onames: Any, opts: Any) -> ca.Function:
        at, w = self._symbols()
        seeds = [ca.MX.sym(f"f{i}", n, nfwd) for i, n in enumerate(self._sizes)]
        none = ca.MX(self._step.model.step.nw, nfwd)
        moved = self._F.forward(nfwd)(*at, w, self._F(*at, w), *seeds, none)
        dw = -self._columns * _refined(self._A(*at, w), self._rows * moved)
        return ca.Function(name, [*at, w, *seeds], [dw], inames, onames, opts)

    def has_reverse(self, nadj: int) -> bool:
        return True

    def get_reverse(self, nadj: int, name: str, inames: Any, onames: Any, opts: Any) -> ca.Function:
        at, w = self._symbols()
        bar = ca.MX.sym("a", self._step.model.step.nw, nadj)
        lam = -self._rows * _refined(self._A(*at, w).T, self._columns * bar)
        found = self._F.reverse(nadj)(*at, w, self._F(*at, w), lam)[: len(at)]
        return ca.Function(name, [*at, w, bar], list(found), inames, onames, opts)

    def _symbols(self) -> tuple[list[ca.MX], ca.MX]:
        return [ca.MX.sym(f"a{i}", n) for i, n in enumerate(self._sizes)], ca.MX.sym("w", self._step.model.step.nw)

    def _all(self, u: Array) -> Array:
        found = np.zeros(self._step.model.step.nu)
        found[self._step.places] = u
        return found

    # -- the step ----------------------------------------------------------------------------------------------------

    def _solved(self, x: Array, u: Array, p: Array, t: float) -> Array:
        instance, step = self._instance, self._step
        with self._lock:
            instance.set_state(self._begin)
            instance.set_parameters(p)
            instance.set_x(t, x)
            instance.set_input(self._all(u))
            instance.initialise()
            found = instance.run(t, step.h, 1, record=("unknowns", "counts"))
        if found["counts"][0, 1] > 1:
            raise ValueError(
                f"{step.name}: the step of {step.h:g} s from t = {t:.9g} s was taken in parts; derivatives are of whole steps: "
                "take shorter ones"
            )
        return found["unknowns"][0]


def _scales(A: ca.Function, step: StepFunction, nominal: Array) -> tuple[ca.DM, ca.DM]:
    """Scales of rows (nw) and columns (nw) of A: unknowns in nominal values, the largest entry of each row at the start 1."""
    columns = np.where(nominal > 0, nominal, 1.0)
    entries = np.abs(np.array(ca.DM(A(*step.start, columns)), float)) * columns
    rows = np.max(np.where(np.isfinite(entries), entries, 0.0), axis=1, initial=0.0)
    return ca.DM(1.0 / np.where(rows > 0, rows, 1.0)), ca.DM(columns)


def _refined(A: ca.MX, b: ca.MX) -> ca.MX:
    """A^-1 b, with one step of refinement."""
    found = ca.solve(A, b)
    return found + ca.solve(A, b - A @ found)


def _several(step: StepFunction, unknowns: _Unknowns) -> ca.Function:
    """(x, u, p, t) -> (x1, y, dissipated) of n steps."""
    at = [ca.MX.sym(b.name, b.n) for b in step.inputs]
    x, (_, u, p, t) = at[0], at
    y, lost = ca.MX(0), ca.MX(0)
    for i in range(step.n):
        now = [x, u, p, t + i * step.h]
        x, mean, own = unknowns.told(*now, unknowns(*now))
        y, lost = y + mean / step.n, lost + own
    names = [b.name for b in step.inputs], [b.name for b in step.outputs]
    return ca.Function(plain(step.name), at, [x, y, lost], *names)


def plain(name: str) -> str:
    """A name that CasADi takes."""
    found = "".join(c if c.isalnum() else "_" for c in name)
    return found if found[:1].isalpha() else f"model_{found}"
