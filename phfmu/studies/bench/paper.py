"""Section 6.3 of Kinon, Morandin, Schulze (Appl. Numer. Math. 2026) reproduced: figures 3 to 6 and table 1.

DG is the semi-explicit scheme (44) with the joint Gonzalez gradient, MP the midpoint rule; both as published.  Besides,
every statement of section 6.3.3 is measured and printed with its number.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from phfmu.discretise.model import Model, build_model
from phfmu.outcome.status import StepFailure
from phfmu.schemes.collocated import Collocated
from phfmu.schemes.midpoint import Midpoint

Array = NDArray[Any]

#: of the library, whose paper it is
MODEL = "four_particle"
DG = Collocated(1, gradient="joint-gonzalez", name="DG")
MP = Midpoint(name="MP")
STEPS = (0.01, 0.005, 0.002, 0.001)
#: columns of the error tables: label, signal block, entries
ERRORS = {"q4": ("x", slice(9, 12)), "v4": ("x", slice(21, 24)), "lambda1": ("a", slice(0, 1))}


@dataclass(frozen=True)
class PaperRun:
    """Rows over a run of equal steps: t (n+1), H (n+1); dissipated, dH (n); g, dgv (n x bars); x, a at the steps."""

    t: Array
    H: Array
    dH: Array
    dissipated: Array
    g: Array
    dgv: Array
    x: Array
    a: Array


@dataclass(frozen=True)
class Statement:
    """A sentence of the paper, the number behind it, and whether the number agrees."""

    text: str
    number: float
    holds: bool
    remark: str = ""


def simulate(model: Model, h: float, stop: float, instance: Any = None) -> PaperRun:
    """`model` from its start to `stop`; StepFailure if a step has no solution."""
    from phfmu.engine.native.native import NativeInstance

    unit = NativeInstance(model, kernels="compiled") if instance is None else instance
    n = round(stop / h)
    start = unit.signals()
    r = unit.run(0.0, h, n, record=("signals", "energy", "stored", "dissipated", "x", "a"))
    checks = r["signals"][:, unit.layout["observables"]][:, -len(model.checks) :]
    bars = len(model.checks) // 2
    return PaperRun(
        h * np.arange(n + 1), np.concatenate([start["H"][:1], r["energy"][:, 0]]), r["stored"][:, 0], r["dissipated"][:, 0],
        checks[:, bars:], checks[:, :bars], r["x"], r["a"],
    )  # fmt: skip


def four_particle_models(declaration: Any) -> dict[str, Model]:
    """DG and MP, with and without damping."""
    conservative = declaration.with_starts({"eta0": 0.0})
    return {
        "DG": build_model(declaration, DG), "MP": build_model(declaration, MP),
        "DG undamped": build_model(conservative, DG), "MP undamped": build_model(conservative, MP),
    }  # fmt: skip


def convergence(models: dict[str, Model], reference: float = 1e-4, stop: float = 0.1) -> dict[str, dict[str, Array]]:
    """Relative errors at `stop` per scheme and quantity, over STEPS, against DG with the step `reference`."""
    ref = simulate(models["DG"], reference, stop)
    rows: dict[str, dict[str, Array]] = {}
    for scheme in ("DG", "MP"):
        runs = [simulate(models[scheme], h, stop) for h in STEPS]
        rows[scheme] = {}
        for label, (block, part) in ERRORS.items():
            exact = getattr(ref, block)[-1, part]
            errors = [np.linalg.norm(getattr(r, block)[-1, part] - exact) / np.linalg.norm(exact) for r in runs]
            rows[scheme][label] = np.array(errors)
    return rows


def large_steps(
    models: dict[str, Model], steps: tuple[float, ...] = (0.1, 0.2, 0.25, 0.4)
) -> dict[tuple[str, float], PaperRun | None]:
    """Runs to 10 s at large steps; None where a step has no solution that Newton's attempts find."""
    out: dict[tuple[str, float], PaperRun | None] = {}
    for scheme in ("DG", "MP"):
        for h in steps:
            try:
                out[(scheme, h)] = simulate(models[scheme], h, 10.0)
            except StepFailure:
                out[(scheme, h)] = None
    return out


def orders(errors: Array) -> Array:
    """Observed orders between neighbouring steps of STEPS."""
    return np.log(errors[:-1] / errors[1:]) / np.log(np.array(STEPS[:-1]) / np.array(STEPS[1:]))


def statements(models: dict[str, Model]) -> list[Statement]:
    """The sentences of section 6.3.3 with their numbers."""
    dg, mp, free = (simulate(models[k], 0.01, 10.0) for k in ("DG", "MP", "DG undamped"))
    table, large = convergence(models), large_steps(models)
    balance = float(np.max(np.abs(dg.dH + dg.dissipated)))
    mp_balance = float(np.max(np.abs(mp.dH + mp.dissipated)))
    found = [
        Statement("DG: Hamiltonian increments are never positive", float(dg.dH.max()), bool((dg.dH <= 0).all())),
        Statement("DG: increment plus dissipated work is numerically zero", balance, balance <= 1e-14),
        Statement("MP is not energy-consistent", mp_balance, mp_balance > 1e-8),
        Statement("DG keeps the position constraints", float(np.abs(dg.g).max()), bool(np.abs(dg.g).max() <= 1e-13)),
        Statement("DG: velocity constraints are of magnitude 1e-4", float(np.abs(dg.dgv).max()),
                  bool(1e-5 < np.abs(dg.dgv).max() < 1e-3)),
        Statement("DG without damping conserves the Hamiltonian", float(np.abs(free.H - free.H[0]).max()),
                  bool(np.abs(free.H - free.H[0]).max() <= 1e-13)),
    ]  # fmt: skip
    for label in ("q4", "v4"):
        rate = float(orders(table["DG"][label])[-1])
        found.append(Statement(f"DG: second order in {label}", rate, abs(rate - 2) < 0.1))
    rate = float(orders(table["DG"]["lambda1"])[-1])
    found.append(Statement("DG: approximately first order in the multiplier", rate, abs(rate - 1) < 0.2,
                           "an artefact of the time it is compared at; second order at the interval midpoint"))  # fmt: skip
    found.append(_midpoint_multiplier(models["DG"]))
    rises = {h: int((r.dH > 1e-12).sum()) for (s, h), r in large.items() if s == "MP" and r is not None}
    found.append(Statement("MP raises the energy at large steps", float(max(rises.values())), max(rises.values()) > 0))
    ok = large[("DG", 0.25)]
    found.append(Statement("DG is dissipative at h = 0.25", float("nan") if ok is None else float(ok.dH.max()),
                           ok is not None and bool((ok.dH <= 1e-13).all())))  # fmt: skip
    solved = float(large[("DG", 0.4)] is not None)
    found.append(Statement("both methods fail at h = 0.4", solved, solved == 0.0 and large[("MP", 0.4)] is None,
                           "the steps have solutions: a second start, line search and substeps find those of DG"))  # fmt: skip
    return found


def _midpoint_multiplier(model: Model) -> Statement:
    """Order of the multiplier against its value at the interval's midpoint."""
    steps = (0.01, 0.005, 0.0025)
    fine = simulate(model, 1e-4 / 2, 0.1)
    errors = []
    for h in steps:
        r = simulate(model, h, 0.1)
        k = round((0.1 - h / 2) / (1e-4 / 2))
        exact = (fine.a[k - 1] + fine.a[k]) / 2
        errors.append(float(abs(r.a[-1, 0] - exact[0]) / abs(exact[0])))
    rate = float(np.log2(errors[-2] / errors[-1]))
    return Statement("(not in the paper) multiplier at the interval midpoint: second order", rate, abs(rate - 2) < 0.25)
