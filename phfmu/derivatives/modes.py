"""Modes of a model at a time of a run: eigenvalues of its linearised steps, which states take part, and those of the model.

One step of length h moves deviations by M = dx1/dx0, whose eigenvalues mu are modes exp(s t) with s = ln(mu) / h.  A Gauss scheme
of order 2k steps a linear mode lambda of the model by the Pade approximant (k, k) of exp,

    mu = R_k(lambda h),   |R_k(i y)| = 1:

undamped modes stay undamped.  lambda follows by inverting R_k, and its difference to s is what the scheme does to the mode.
Around a motion of period P (machines and lines in phase quantities) modes are those of one period, the product of its steps
(Floquet); then s = ln(mu) / P, whose imaginary part is told up to multiples of 2 pi / P.

Participation of state i in mode k: |v_ik w_ik|, with right and left eigenvectors v, w, each mode's summing to one.
Source: Kundur, Power System Stability and Control (1994), ch. 12.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from phfmu.derivatives.by import IndependentVariables
from phfmu.derivatives.tangents import RunTangents, TakenSteps, require_smooth
from phfmu.discretise.model import Model

Array = NDArray[np.float64]

#: modes that a step, or a period, takes to less than this are constraints, or gone
GONE = 1e-12


@dataclass(frozen=True)
class Eigenmode:
    """s of the steps and of the model [1/s] (None around a period); states and their shares, largest first."""

    s: complex
    model: complex | None
    shares: tuple[tuple[str, float], ...]

    @property
    def frequency(self) -> float:
        """[Hz]"""
        return abs(self.s.imag) / (2 * np.pi)

    @property
    def damping(self) -> float:
        """Damping ratio: -Re s / |s|; 0 of a mode that stays."""
        return -self.s.real / abs(self.s) if abs(self.s) else 0.0


@dataclass(frozen=True)
class Eigenmodes:
    """Modes at time t, slowest decay first, one of each conjugate pair; `gone`: directions that constraints leave none of."""

    t: float
    step: float
    period: float | None
    modes: tuple[Eigenmode, ...]
    gone: int


def modes_at(model: Model, instance: Any, t: float, h: float, period: float | None = None) -> Eigenmodes:
    """Modes of steps of length h from the state of `instance`, which is at time t; it goes on by a step, or a period.

    Errors: ValueError for models without derivatives, and a period that is no number of steps.
    """
    n = 1 if period is None else round(period / h)
    if period is not None and (n < 1 or abs(n * h - period) > 1e-6 * period):
        raise ValueError(
            f"{model.name}: the period {period:g} s is not a number of steps of {h:g} s; take --step {period / max(n, 1):.12g}"
        )
    M = step_matrix(model, instance, t, h, n)
    mu, right = np.linalg.eig(M)
    left = np.linalg.pinv(right)
    names = [name for v in model.declaration.states for name in v.names()]
    there = np.abs(mu) > GONE
    found = []
    for k in np.flatnonzero(there):
        if mu[k].imag < 0:
            continue
        s = complex(np.log(complex(mu[k]))) / (n * h)
        shares = np.abs(right[:, k] * left[k])
        shares = shares / max(float(shares.sum()), 1e-300)
        order = np.argsort(-shares)[:6]
        told = tuple((names[i], float(shares[i])) for i in order if shares[i] > 0.01)
        own = _of_model(complex(mu[k]), model.step.k, h) if n == 1 and period is None else None
        found.append(Eigenmode(s, own, told))
    found.sort(key=lambda m: (-round(m.s.real, 9), abs(m.s.imag)))
    return Eigenmodes(t, h, period, tuple(found), int(np.sum(~there)))


def step_matrix(model: Model, instance: Any, t: float, h: float, n: int = 1) -> Array:
    """dx/dx0 over the next n steps of `instance` (nx x nx)."""
    require_smooth(model)
    names = [name for v in model.declaration.states for name in v.names()]
    tangents = RunTangents(model, IndependentVariables.of(model.declaration, names))
    tangents.S = np.eye(len(names))
    before, u = instance.x[: len(names)].copy(), np.asarray(instance.held_input, np.float64)
    r = instance.run(t, h, n, record=("signals", "unknowns", "counts"))
    starts = np.asarray(t + h * np.arange(n), np.float64)
    tangents.over(TakenSteps.recorded(model, instance, r, starts, h, before, u))
    return tangents.S


def _of_model(mu: complex, k: int, h: float) -> complex | None:
    """lambda with R_k(lambda h) = mu, the root next to ln(mu); None where there is none (mu = -1 of a stiff mode)."""
    top, below = _pade(k)
    roots = np.roots(np.trim_zeros((top - mu * below)[::-1], "f"))
    if not len(roots):
        return None
    near = roots[np.argmin(np.abs(roots - np.log(mu)))]
    return complex(near) / h


def _pade(k: int) -> tuple[Array, Array]:
    """Coefficients, lowest power first, of numerator and denominator of the approximant (k, k) of exp."""
    from math import comb, factorial

    top = np.array([comb(k, j) * factorial(2 * k - j) / factorial(2 * k) for j in range(k + 1)], np.float64)
    return top, np.array([c * (-1) ** j for j, c in enumerate(top.tolist())], np.float64)


def names_of(shares: Sequence[tuple[str, float]], most: int = 3) -> str:
    """gen.theta 48 %, gen.p 47 %"""
    return ", ".join(f"{name} {100 * part:.0f} %" for name, part in shares[:most])
