"""Fits of parameters, start values and inputs to measurements, by least squares with the exact Jacobian of the runs.

    min over theta of  sum over experiments, signals s and times t of  rho(((y_s(t; theta) - data_s(t)) / weight_s)^2),

by SciPy's trust region (`scipy.optimize.least_squares`), bounded by the limits of the parameters.  The Jacobian is that of the
run's own columns (`sensitive.py`).  With C = s^2 (J^T J)^-1 and s^2 the weighted sum of squares over the degrees of freedom, the
standard errors are the roots of diag C; directions that the data cannot tell are those of small singular values of J.

Source: Seber, Wild, Nonlinear Regression (1989), ch. 2 and 3.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from phfmu.derivatives.by import require_known
from phfmu.derivatives.fits.fit_journal import Journal, JournalEntry, digest
from phfmu.derivatives.gradient import forward_of
from phfmu.derivatives.interpolation import LinearInterpolation
from phfmu.derivatives.measured import TIME
from phfmu.discretise.model import Model
from phfmu.fmu.export.variables import FMUError
from phfmu.network.network import Network
from phfmu.outcome.status import StepFailure
from phfmu.results.table import Table
from phfmu.runs.loop import run
from phfmu.runs.options import Options
from phfmu.signals import derivative_name

Array = NDArray[np.float64]
#: of each measured signal: times, name, data, the run's values there, and their derivatives
Curves = list[tuple[Array, str, Array, Array, Array]]

#: singular values below this part of the largest: the data do not tell these directions
UNTOLD = 1e-7
#: tries beside the first begin within this factor of its values
SPREAD = 1.5


@dataclass(frozen=True)
class Experiment:
    """Measurements, and the run that they are of: `options` with its events, `inputs` over time, `values` set at its start."""

    name: str
    data: Table
    options: Options
    values: Mapping[str, float] = field(default_factory=dict)
    inputs: Any = None
    interpolate: str = "held"


@dataclass(frozen=True)
class Fit:
    """The result of a fit: values and standard errors by name, root mean square of the residuals by signal, in its unit.

    residual: weighted root mean square, which is 1 where weights are standard deviations of noise
    correlation (n x n): of the estimates;  undetermined: directions that the data do not tell, as name -> share
    iterations, runs: of the least squares;  message: why they ended
    sequences: how many sequences of state events the runs had; where one follows another, residuals have a kink
    misfit: signal -> lag-one correlation of residuals, where it is more than noise has
    curves: per experiment and signal times, data and model;  units: of the signals
    """

    values: dict[str, float]
    errors: dict[str, float]
    residual: float
    residuals: dict[str, float]
    correlation: Array
    undetermined: tuple[dict[str, float], ...]
    singular: Array
    iterations: int
    runs: int
    message: str
    misfit: dict[str, float]
    curves: tuple[tuple[str, str, Array, Array, Array], ...]
    between: int
    free: tuple[str, ...]
    units: dict[str, str]
    sequences: int = 1


def fit(
    model: Model | Network,
    instance: Any,
    experiments: Sequence[Experiment],
    free: Sequence[str],
    measure: Sequence[str],
    *,
    weights: Mapping[str, float] | None = None,
    bounds: Mapping[str, tuple[float, float]] | None = None,
    tries: int = 1,
    loss: str = "linear",
    progress: Callable[[int, float], None] | None = None,
    resume: str | Path | None = None,
) -> Fit:
    """Values of `free` (parameters, start values, held inputs) with which runs come closest to measurements of `measure`.

    instance: of the model, or a `Coupled` of the network for members stepped apart
    weights: signal -> standard deviation (default: the largest size of its data);  bounds: name -> least and largest value
    tries: so many starts, drawn around the first, of which the best fit is kept
    loss: of SciPy (linear, soft_l1, huber, cauchy, arctan);  progress: called with the number of runs and the residual
    resume: file that keeps the runs; those that a fit of the same left there before it was killed are not taken again
    Errors: KeyError for names that are none; ValueError for data that do not fit, a run that cannot be made at the start, or
    `resume` of another fit.
    """
    problem = _Problem(model, instance, experiments, free, measure, weights or {})
    if resume is not None:
        problem.keep(resume)
    low, high = problem.bounds(bounds or {})
    best, rng = None, np.random.default_rng(0)
    for k in range(max(tries, 1)):
        begin = problem.start if k == 0 else problem.start * SPREAD ** rng.uniform(-1.0, 1.0, len(problem.start))
        begin = np.clip(begin, low, high)
        try:
            found = problem.solved(begin, (low, high), loss, progress)
        except ValueError:
            if k == 0:
                raise
            continue
        if best is None or found.cost < best.cost:
            best = found
    assert best is not None
    return problem.fit(best)


class _Problem:
    """The least squares of some experiments."""

    def __init__(
        self,
        model: Model | Network,
        instance: Any,
        experiments: Sequence[Experiment],
        free: Sequence[str],
        measure: Sequence[str],
        weights: Mapping[str, float],
    ):
        if not experiments:
            raise ValueError("a fit needs measurements of one experiment at least")
        self.stepper = forward_of(model, instance, free, list(measure))
        self.name, self.free, self.experiments = model.name, self.stepper.by.names, experiments
        self.measure = self.stepper.derived_names
        if lost := [m for m in measure if m not in self.measure]:
            from phfmu.words import meant

            plain = self.stepper.names[: len(self.stepper.names) - len(self.measure) * len(self.free)]
            raise KeyError(f"{model.name} has no signal '{lost[0]}' to measure; {meant(lost[0], plain)}")
        known = self.stepper.known
        self.start = np.array([known.start[n] for n in self.free])
        self.scale = np.array(
            [abs(x) or known.nominal.get(n, 0.0) or 1.0 for n, x in zip(self.free, self.start, strict=True)]
        )
        self._weights = self._sizes(weights)
        self._known: tuple[bytes, list[Curves]] | None = None
        self._journal: Journal | None = None
        self.runs, self._between, self._why = 0, 0, ""
        self._sequences: list[set[Any]] = [set() for _ in experiments]
        self._last_sequences: list[Any] = [None] * len(experiments)
        self._options = [replace(e.options, signals=self.stepper.columns, audited=False) for e in experiments]

    def _sizes(self, given: Mapping[str, float]) -> dict[str, float]:
        found = {}
        if odd := [n for n in given if n not in self.measure]:
            raise ValueError(f"--weight {odd[0]}: it is not measured; measured are {', '.join(self.measure)}")
        for m in self.measure:
            values = [e.data.column(m) for e in self.experiments if m in e.data.names]
            if not values:
                raise ValueError(
                    f"no experiment has data of {m}; columns: {', '.join(self.experiments[0].data.names[:12])}"
                )
            size = max(float(np.nanmax(np.abs(v), initial=0.0)) for v in values)
            found[m] = given.get(m, size or 1.0)
            if not found[m] > 0:
                raise ValueError(f"--weight {m}={found[m]:g} must be positive")
        return found

    def bounds(self, given: Mapping[str, tuple[float, float]]) -> tuple[Array, Array]:
        """Least and largest values: those given, else the limits of parameters."""
        if odd := [n for n in given if n not in self.free]:
            raise ValueError(f"--bounds {odd[0]}: it is not free; free are {', '.join(self.free)}")
        known = self.stepper.known.limits
        low, high = np.full(len(self.free), -np.inf), np.full(len(self.free), np.inf)
        for i, name in enumerate(self.free):
            if name in given:
                low[i], high[i] = given[name]
            elif name in known:
                low[i], high[i] = known[name].min, known[name].max
                if known[name].above:
                    low[i] += 1e-12 * self.scale[i]
            if not low[i] <= self.start[i] <= high[i]:
                raise ValueError(f"{name} begins at {self.start[i]:g}, outside its bounds {low[i]:g} to {high[i]:g}")
        return low, high

    def solved(
        self, begin: Array, bounds: tuple[Array, Array], loss: str, progress: Callable[[int, float], None] | None
    ) -> Any:
        from scipy.optimize import least_squares

        def residual(theta: Array) -> Array:
            r, _ = self._at(theta)
            if progress is not None:
                progress(self.runs, _rms(r))
            return r

        if not np.isfinite(residual(begin)).all():
            raise ValueError(
                f"{self.name}: no run can be made with "
                + ", ".join(f"{n} = {v:g}" for n, v in zip(self.free, begin, strict=True))
                + f": {self._why}"
            )
        solve: Any = least_squares  # whose stub takes no function as Jacobian
        return solve(
            residual, begin, lambda theta: self._at(theta)[1], bounds, "trf", x_scale=self.scale, loss=loss,
            ftol=1e-12, xtol=1e-12, gtol=1e-14, max_nfev=200,
        )  # fmt: skip

    def _at(self, theta: Array) -> tuple[Array, Array]:
        """Weighted residuals (m) and their Jacobian (m x free); not finite where an experiment cannot be run."""
        curves = [c for own in self._all(theta) for c in own]
        rows = [(model - data) / self._weights[m] for _, m, data, model, _ in curves]
        return np.concatenate(rows), np.vstack([slope / self._weights[m] for _, m, _, _, slope in curves])

    def _all(self, theta: Array) -> list[Curves]:
        """The curves of every experiment; those asked for last are not run again."""
        key = theta.tobytes()
        if self._known is None or self._known[0] != key:
            kept = None if self._journal is None else self._journal.at(theta)
            if kept is not None:
                self._known = key, self._taken_before(kept)
                return self._known[1]
            self._last_sequences = [None] * len(self.experiments)
            self._known = key, [self._curves(i, theta) for i in range(len(self.experiments))]
            if self._journal is not None:
                self._journal.add(theta, self._kept(self._known[1]))
        return self._known[1]

    def keep(self, path: str | Path) -> None:
        """Runs are kept in a file, and those of the same fit that are there are not taken again."""
        about = {
            "model": self.stepper.identity,
            "free values": self.free,
            "measured signals": self.measure,
            "data or weights": [
                sorted(self._weights.items()),
                *((e.data.names, e.data.time, e.data.values) for e in self.experiments),
            ],
            "runs": [
                (sorted(e.values.items()), e.interpolate, o.t0, o.stop, o.step, o.project)
                + tuple((v.t, v.name, v.value) for v in o.events)
                + (() if e.inputs is None else (list(e.inputs.names), e.inputs.time, e.inputs.values))
                for e, o in zip(self.experiments, self._options, strict=True)
            ],
        }
        self._journal = Journal(path, {name: digest(value) for name, value in about.items()})

    def _kept(self, curves: Sequence[Curves]) -> JournalEntry:
        rows = [np.column_stack([model, slope]) for own in curves for _, _, _, model, slope in own]
        told = {"sequences": self._last_sequences, "between": self._between, "why": self._why}
        return JournalEntry(np.vstack(rows), told)

    def _taken_before(self, kept: JournalEntry) -> list[Curves]:
        """The curves of runs that were taken before the fit was killed."""
        found, first = list[Curves](), 0
        self._between, self._why = max(self._between, kept.told["between"]), kept.told["why"]
        for i, e in enumerate(self.experiments):
            own: Curves = []
            for m in (m for m in self.measure if m in e.data.names):
                there = np.isfinite(e.data.column(m))
                rows = kept.columns[first : first + int(there.sum())]
                first += len(rows)
                own.append((e.data.time[there], m, e.data.column(m)[there], rows[:, 0], rows[:, 1:]))
            if (sequence := kept.told["sequences"][i]) is not None:
                self._sequences[i].add(tuple(map(tuple, sequence)))
            found.append(own)
        return found

    def _curves(self, i: int, theta: Array) -> Curves:
        """Times and data of each measured signal, the run's values there, and their derivatives."""
        e, s = self.experiments[i], self.stepper
        values = dict(e.values) | dict(zip(self.free, theta.tolist(), strict=True))
        measured = [m for m in self.measure if m in e.data.names]
        there = {m: np.isfinite(e.data.column(m)) for m in measured}
        self.runs += 1
        try:
            s.begin(values)
            result = run(s, self._options[i], inputs=e.inputs, interpolate=e.interpolate)
        except (StepFailure, FloatingPointError, FMUError) as failure:
            self._why = str(failure)
            nothing = {m: np.full(int(there[m].sum()), np.nan) for m in measured}
            return [
                (nothing[m], m, nothing[m], nothing[m], np.full((len(nothing[m]), len(self.free)), np.nan))
                for m in measured
            ]
        found = []
        self._sequences[i].add(s.sequence)
        self._last_sequences[i] = s.sequence
        moved = [result.column(derivative_name(TIME, n)) for n in self.free] if s.moves else None
        for m in measured:
            t = e.data.time[there[m]]
            at = LinearInterpolation(result.time, t, "measurements", "; give --stop")
            self._between = max(self._between, at.between)
            slope = np.column_stack([at.of(result.column(derivative_name(m, n))) for n in self.free])
            if moved is not None:
                slope -= at.slopes(result.column(m))[:, None] * np.column_stack([at.of(T) for T in moved])
            require_known(slope, m)
            found.append((t, m, e.data.column(m)[there[m]], at.of(result.column(m)), slope))
        return found

    def fit(self, best: Any) -> Fit:
        """The fit that SciPy's result describes."""
        theta, names = best.x, self.free
        curves, by_signal = [], dict[str, list[Array]]()
        for e, own in zip(self.experiments, self._all(theta), strict=True):
            for t, m, data, values, _ in own:
                curves.append((e.name, m, t, data, values))
                by_signal.setdefault(m, []).append(values - data)
        J = np.asarray(best.jac) * self.scale
        m, n = J.shape
        _, sizes, V = np.linalg.svd(J, full_matrices=False)
        told = sizes > UNTOLD * max(sizes[0], 1e-300)
        variance = 2.0 * best.cost / max(m - n, 1)
        inverse = (V[told].T / sizes[told] ** 2) @ V[told] * variance
        deviation = np.sqrt(np.diag(inverse))
        with np.errstate(invalid="ignore", divide="ignore"):
            correlation = inverse / np.outer(deviation, deviation)
        lost = np.abs(V[~told]).max(axis=0, initial=0.0) > 0.1 if (~told).any() else np.zeros(n, bool)
        errors = np.where(lost, np.inf, deviation * self.scale)
        residuals = {s: _rms(np.concatenate(r)) for s, r in by_signal.items()}
        return Fit(
            dict(zip(names, theta.tolist(), strict=True)), dict(zip(names, errors.tolist(), strict=True)),
            _rms(best.fun), residuals, correlation, tuple(_shares(v, names) for v in V[~told]), sizes, int(best.nfev),
            self.runs, str(best.message), _correlated(by_signal), tuple(curves), self._between, names,
            {m: u for m, u in self.stepper.units.items() if m in residuals}, max(map(len, self._sequences)),
        )  # fmt: skip


def _rms(r: Array) -> float:
    return float(np.sqrt(np.mean(r**2))) if len(r) else 0.0


def _shares(v: Array, names: Sequence[str]) -> dict[str, float]:
    """The names that a direction is made of, largest first."""
    order = np.argsort(-np.abs(v))
    return {str(names[i]): float(v[i]) for i in order.tolist() if abs(v[i]) > 0.1}


def _correlated(by_signal: Mapping[str, Sequence[Array]]) -> dict[str, float]:
    """Signals whose residuals follow each other more than noise does (three standard deviations of white noise)."""
    found = {}
    for name, parts in by_signal.items():
        above = sum(float(np.sum(r[1:] * r[:-1])) for r in parts)
        below, n = sum(float(np.sum(r**2)) for r in parts), sum(len(r) for r in parts)
        if below > 0 and abs(above / below) > 3.0 / np.sqrt(n):
            found[name] = above / below
    return found
