"""Tables of docs/results/four_particle.md: convergence, balance, large steps."""

from __future__ import annotations

import numpy as np
from pages import Array, PageBlock, reference, slopes, table

from phfmu import NativeInstance, Options, StepFailure, build_model, run
from phfmu.components.mechanical.four_particle import four_particle
from phfmu.network.couplings.monolithic import Monolithic
from phfmu.schemes.named import named_scheme

SCHEMES = {
    "semi-explicit, joint Gonzalez": ("semi-explicit", 2, "joint-gonzalez"),
    "semi-explicit, per term": ("semi-explicit", 2, "per-term"),
    "two-level, per term (default)": ("two-level", 2, "per-term"),
    "two-level, per term, order 6": ("two-level", 6, "per-term"),
    "midpoint": ("midpoint", 2, "per-term"),
}


def four(scheme: tuple[str, int, str], h: float, stop: float, **starts: float) -> dict[str, Array]:
    """The four particles: `x` and all signals by name after every step (the first row: the start)."""
    declaration = four_particle().with_starts(starts)
    model = build_model(declaration, named_scheme(declaration, *scheme))
    stepper = Monolithic(model, NativeInstance(model))
    r = run(stepper, Options(stop=stop, step=h))
    rows = {n: r.values[:, i] for i, n in enumerate(r.names)}
    rows["x"] = np.column_stack([r.column(f"{s}[{i}]") for s in "qv" for i in range(1, 13)])
    return rows


def four_particle_convergence() -> PageBlock:
    """Relative errors at t = 0.1 s of q4, v4 and lambda_1 (step mean and end value) over h."""
    exact = {n: v[1] for n, v in reference("four_particle").items()}
    steps, rows = (0.01, 0.005, 0.002, 0.001), []
    for label, scheme in SCHEMES.items():
        errors: dict[str, list[float]] = {n: [] for n in ("q4", "v4", "mean", "end")}
        for h in steps:
            end = {n: v[-1] for n, v in four(scheme, h, 0.1).items()}
            for name, s in (("q4", "q"), ("v4", "v")):
                true = np.array([exact[f"{s}[{i}]"] for i in (10, 11, 12)])
                found = np.array([end[f"{s}[{i}]"] for i in (10, 11, 12)])
                errors[name].append(float(np.linalg.norm(found - true) / np.linalg.norm(true)))
            for name, column in (("mean", "lambda[1]"), ("end", "lambda_end[1]")):
                errors[name].append(float(abs(end[column] / exact["lambda[1]"] - 1)))
        order = {n: slopes(e, steps) for n, e in errors.items()}
        for j, h in enumerate(steps):
            cells = [c for n in errors for c in (errors[n][j], order[n][j])]
            rows.append([label if j == 0 else "", f"{h:g}", *cells])
    return table(["scheme", "h in s", "q4", "slope", "v4", "slope", "λ1 mean", "slope", "λ1 end", "slope"], rows)


def four_particle_balance() -> PageBlock:
    """Ten seconds at h = 0.01 s: ledger, constraints, momenta."""
    mass, rows = np.repeat([1.0, 3.0, 2.3, 1.7], 3), []
    for label, scheme in SCHEMES.items():
        damped, free = four(scheme, 0.01, 10.0), four(scheme, 0.01, 10.0, eta0=0.0)
        H = damped["energy.stored"]
        defect = np.abs(np.diff(H) + np.diff(damped["energy.dissipated"])).max()
        rises = np.diff(H)
        g = max(np.abs(damped[f"constraint.position.lambda[{i}]"]).max() for i in (1, 2))
        w = max(np.abs(damped[f"constraint.velocity.lambda[{i}]"]).max() for i in (1, 2))
        q, p = free["x"][:, :12].reshape(-1, 4, 3), (free["x"][:, 12:] * mass).reshape(-1, 4, 3)
        momentum = np.abs(p.sum(axis=1) - p[0].sum(axis=0)).max()
        spin = np.cross(q, p).sum(axis=1)
        conserved = np.abs(free["energy.stored"] - free["energy.stored"][0]).max()
        turned = np.abs(spin - spin[0]).max()
        numbers = (g, w, conserved, momentum, turned)
        rows.append([label, float(defect), int((rises > 1e-13).sum()), *map(float, numbers)])
    head = ["scheme", "max ΔH + D", "steps with rising H", "max g", "max Dg v", "undamped: max H − H0"]
    head += ["linear momentum", "angular momentum"]
    return table(head, rows)


def four_particle_large_steps() -> PageBlock:
    """H(10 s) of the damped system at large steps; what the solver needed."""
    rows = []
    for label, scheme in SCHEMES.items():
        cells = []
        for h in (0.1, 0.2, 0.25, 0.4, 1.0):
            declaration = four_particle()
            instance = NativeInstance(build_model(declaration, named_scheme(declaration, *scheme)))
            try:
                H = instance.run(0.0, h, round(10.0 / h), ("energy",))["energy"][:, 0]
            except StepFailure as failure:
                cells.append(f"refused at {failure.time:.3g} s")
                continue
            rises = int((np.diff(np.append(20 / 17, H)) > 1e-13).sum())
            extra = [
                f"{instance.counts[n]}× {text}"
                for n, text in (("line_searches", "line search"), ("substeps", "halved"))
                if instance.counts[n]
            ]
            cells.append(", ".join([f"{H[-1]:.4f}", *([f"{rises}× rising"] if rises else []), *extra]))
        rows.append([label, *cells])
    return table(["scheme", *(f"h = {h} s" for h in (0.1, 0.2, 0.25, 0.4, 1.0))], rows)
