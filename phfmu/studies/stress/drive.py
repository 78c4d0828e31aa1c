"""Driving an instance through a case and the numbers a criterion is about."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from phfmu.audit.judge import DEFAULT_RTOL, EPS, REACH_ULPS
from phfmu.outcome.steps import balance
from phfmu.terms.hidden import Level
from phfmu.words import counted

if TYPE_CHECKING:
    from phfmu.declare.phdae import PHDAE

Array = NDArray[np.float64]

#: the ledger's part of a row
BOOKED = ("stored", "dissipated", "supplied", "pairs")
#: what a step may need beyond its first start
BEYOND = {"restarts": "restart", "line_searches": "line search", "substeps": "substep"}


@dataclass(frozen=True)
class StepRecord:
    """n steps: x (n x nx), a, H (n x members), position and velocity constraints, worst balance, work a step.

    `balance`: largest |stored + dissipated - supplied| of a member and step over the energy in play (H of all members,
    what was supplied and dissipated), which counts as no less than rounding of the most so far allows, see `audit.judge`;
    `iterations`, `sweeps`: of Newton's method and of the Schur stepper, a step;
    `solved`: what the solver needed beyond the first start.
    """

    x: Array
    a: Array
    H: Array
    position: float
    velocity: float
    balance: float
    iterations: float
    sweeps: float
    solved: str

    @property
    def drift(self) -> float:
        """Largest change of the total energy, relative to the first value."""
        total = self.H.sum(axis=1)
        return float(np.abs(total - total[0]).max() / abs(total[0]))

    @property
    def rise(self) -> float:
        """Largest growth of the total energy in a step, relative to the first value."""
        total = self.H.sum(axis=1)
        return float(np.diff(total).max(initial=0.0) / abs(total[0]))

    @property
    def finite(self) -> bool:
        return bool(np.isfinite(self.x).all() and np.isfinite(self.H).all())


def instance(declaration: PHDAE, order: int = 2, scheme: Any = "auto", gradient: str = "per-term") -> Any:
    """A native instance, a Python one without a C compiler."""
    from phfmu.discretise.model import build_model
    from phfmu.engine.build.compile import CompilerMissing, require_compiler
    from phfmu.schemes.named import named_scheme

    model = build_model(declaration, named_scheme(declaration, scheme, order, gradient))
    try:
        require_compiler()
    except CompilerMissing:
        from phfmu.engine.reference.python import PythonInstance

        return PythonInstance(model)
    from phfmu.engine.native.native import NativeInstance
    from phfmu.engine.switched import stepped

    return stepped(model, NativeInstance)


def record(unit: Any, h: float, n: int, t0: float = 0.0, inputs: Array | None = None) -> StepRecord:
    """n steps of length h; StepFailure as it comes."""
    model = unit.model
    before = unit.counts
    start = unit.signals()
    r = _by_steps(unit, t0, h, n) if model.modes is not None else _in_a_run(unit, t0, h, n, inputs)
    checks = np.abs(r["observables"][:, r["observables"].shape[1] - len(model.checks) :])
    levels = np.array([c.level for c in model.checks])
    play = np.abs(r["energy"]).sum(axis=1) + np.abs(r["dissipated"]).sum(axis=1) + np.abs(r["pairs"]).sum(axis=1)
    play = np.maximum(
        play, REACH_ULPS * EPS / DEFAULT_RTOL * np.maximum.accumulate(np.maximum(play, np.abs(start["H"]).sum()))
    )
    gap = np.abs(balance(r["stored"], r["dissipated"], r["supplied"])).max(axis=1, initial=0.0)
    after = unit.counts
    extra = [counted(after[k] - before[k], word) for k, word in BEYOND.items() if after[k] != before[k]]
    sweeps = after.get("sweeps", 0) - before.get("sweeps", 0)  # none in the Python engine
    return StepRecord(
        r["x"], r["a"], np.vstack([start["H"], r["energy"]]),
        float(checks[:, levels == Level.POSITION].max(initial=0.0)),
        float(checks[:, levels == Level.VELOCITY].max(initial=0.0)),
        float((gap / np.maximum(play, 1e-300)).max(initial=0.0)),
        float(r["iterations"].sum()) / n,
        sweeps / n,
        ", ".join(extra),
    )  # fmt: skip


def _in_a_run(unit: Any, t0: float, h: float, n: int, inputs: Array | None) -> dict[str, Array]:
    """Rows of n steps."""
    r = unit.run(t0, h, n, ("signals", "x", "a", "energy", "counts", *BOOKED), inputs=inputs)
    return r | {"observables": r["signals"][:, unit.layout["observables"]], "iterations": r["counts"][:, 0]}


def _by_steps(unit: Any, t0: float, h: float, n: int) -> dict[str, Array]:
    """The same, one step after the other: what changes its modes tells no rows of a run."""
    rows, before = [], unit.counts["iterations"]
    for k in range(n):
        unit.do_step(t0 + k * h, h)
        shown, booked = unit.signals(), unit.ledger()
        rows.append({"x": unit.x, "a": shown["a"], "energy": shown["H"], "observables": shown["observables"]}
                    | {name: booked[name] for name in BOOKED})  # fmt: skip
    columns = {name: np.array([row[name] for row in rows]) for name in rows[0]}
    return columns | {"iterations": np.array([unit.counts["iterations"] - before])}


def effort(r: StepRecord) -> str:
    """Sweeps of the Schur stepper and iterations of Newton's method a step, those that occur, and what was needed beyond."""
    work = [f"{v:.1f} {name}" for v, name in ((r.sweeps, "sweeps"), (r.iterations, "iterations")) if v] or [
        "0 iterations"
    ]
    return f"{' and '.join(work)} a step" + (f", {r.solved}" if r.solved else "")
