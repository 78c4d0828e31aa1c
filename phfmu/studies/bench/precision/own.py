"""The schemes of this package as candidates."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from typing import Any

import numpy as np
from numpy.typing import NDArray

from phfmu.discretise.model import Model, build_model
from phfmu.network.members.inputs import Inputs
from phfmu.outcome.steps import balance
from phfmu.schemes.named import named_scheme
from phfmu.studies.bench.precision.candidate import Candidate, CandidateRun
from phfmu.studies.bench.precision.compositions import COMPOSITIONS, ComposedSteps, Composition
from phfmu.studies.bench.precision.problem import InitialValueProblem

Array = NDArray[np.float64]

ENGINES = ("native", "python")


def default_schemes(problem: InitialValueProblem) -> list[str]:
    """Two-level of order 2 and 6 with holonomic constraints, collocated of order 2, 4 and 6 else."""
    if problem.declaration.constraints:
        return ["two-level:2", "two-level:6"]
    return (
        ["collocated:2", "collocated"]
        if problem.declaration.closed
        else ["collocated:2", "collocated:4", "collocated:6"]
    )


def candidates(
    problem: InitialValueProblem, schemes: Sequence[str], engines: Sequence[str], steps: Sequence[float]
) -> Iterator[Candidate]:
    """One candidate per scheme (`NAME:ORDER[:GRADIENT]`, `suzuki`, `kahan-li`), engine and step [s]."""
    for text in schemes:
        name, order, gradient = _parts(text)
        composition = COMPOSITIONS.get(name)
        scheme = named_scheme(
            problem.declaration, "auto" if composition else name, 2 if composition else order, gradient
        )
        model = build_model(problem.declaration, scheme)
        for engine in engines:
            if engine not in ENGINES:
                raise ValueError(f"--engines {engine}: choose from {', '.join(ENGINES)}")
            label = f"{text}" if engine == "native" else f"{text} ({engine})"
            for h in steps:
                yield Candidate(
                    label,
                    f"h={h:g}",
                    h,
                    lambda e=engine, h=h, m=model, c=composition: _Solver(problem, m, e, h, c),
                    own=True,
                )


def _parts(text: str) -> tuple[str, int | None, str]:
    name, _, rest = text.partition(":")
    order, _, gradient = rest.partition(":")
    try:
        return name, int(order) if order else None, gradient or "per-term"
    except ValueError:
        raise ValueError(f"--schemes {text}: expected NAME:ORDER or NAME:ORDER:GRADIENT, e.g. two-level:6") from None


class _Solver:
    """An instance stepped with a fixed step; intervals are divided into equal steps that land on their end."""

    def __init__(
        self, problem: InitialValueProblem, model: Model, engine: str, h: float, composition: Composition | None = None
    ):
        self._problem, self._h, self._model = problem, h, model
        self._instance: Any
        if engine == "native":
            from phfmu.engine.native.native import NativeInstance

            self._instance = NativeInstance(model, kernels="compiled")
        else:
            from phfmu.engine.reference.python import PythonInstance

            self._instance = PythonInstance(model)
        self._p0 = self._instance.parameters.copy()
        self._composed = None if composition is None else ComposedSteps(self._instance, composition)

    def __call__(self, times: Sequence[float], watch: bool = False) -> CandidateRun:
        instance = self._instance
        if self._problem.events:
            instance.set_parameters(self._p0)
            instance.set_input(self._model.u0)
        instance.reset()
        inputs = Inputs(instance, self._model) if self._problem.events else None
        x, steps, worst, before = [], 0, 0.0, solver_iterations(instance)
        record = ("stored", "dissipated", "numerical", "supplied") if watch else ()
        for piece in self._problem.pieces(times):
            if inputs is not None:
                for name, value in piece.changes.items():
                    inputs.set(name, value)
            start = piece.start
            for end in piece.stops:
                n = max(1, round((end - start) / self._h))
                rows = self._run(start, (end - start) / n, n, record)
                steps += n
                if watch:
                    worst = max(worst, _ledger(rows))
                if end in piece.times:
                    x.append(instance.x)
                start = end
        done = solver_iterations(instance) - before
        return CandidateRun(np.array(x), steps, done if watch else None, worst if watch else None)

    def _run(self, t: float, h: float, n: int, record: Sequence[str]) -> dict[str, Array]:
        """n steps; the ledger of each step, of each substep where steps are composed."""
        if self._composed is None:
            return self._instance.run(t, h, n, record=record)
        rows: dict[str, list[Array]] = {name: [] for name in record}
        for k in range(n):
            for _ in self._composed.substeps(t + k * h, h):
                for name in record:
                    rows[name].append(self._instance.ledger()[name])
        return {name: np.array(kept) for name, kept in rows.items()}


def solver_iterations(instance: Any) -> int:
    """Newton iterations and sweeps that an instance counted so far."""
    counts = instance.counts
    return counts["iterations"] + counts.get("sweeps", 0)


def _ledger(rows: dict[str, Array]) -> float:
    """Largest |stored + dissipated + numerical - supplied| of a step [J]; H itself may pass through zero and is no scale."""
    return float(np.abs(balance(**rows)).max(initial=0.0))
