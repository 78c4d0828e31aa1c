"""Prints the tables of docs/results: `python docs/make_tables.py [--write] [NAME ...]` (needs a C compiler).

NAME is a table of `TABLES`; without a name all are printed.  `--write` also puts them into the pages, below
the line with their command.  Errors are measured against tests/reference/*.csv, independent solutions of high
accuracy, or against closed forms.
"""

from __future__ import annotations

import re
import sys
from collections.abc import Callable, Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
from multibody_tables import chain, top
from numpy.typing import NDArray
from step_tables import between, restart, tolerance
from transform_tables import mass_spring_orders

from phfmu import Collocated, NativeInstance, Scene, build_model, run
from phfmu.components.mechanical.four_particle import four_particle
from phfmu.components.scenes.oscillator import oscillator
from phfmu.components.scenes.smib import smib, smib_folded
from phfmu.components.scenes.two_machine import two_machine
from phfmu.discretise.schemes import named_scheme
from phfmu.engine.status import StepFailure
from phfmu.network.coupled import Coupled
from phfmu.network.members import EngineMember
from phfmu.network.run import Result
from phfmu.network.stepper import Monolithic

Array = NDArray[np.float64]
REFERENCE = Path(__file__).parent.parent / "tests" / "reference"
SCHEMES = {
    "semi-explicit, joint Gonzalez": ("semi-explicit", 2, "joint-gonzalez"),
    "semi-explicit, per term": ("semi-explicit", 2, "per-term"),
    "two-level, per term (default)": ("two-level", 2, "per-term"),
    "two-level, per term, order 6": ("two-level", 6, "per-term"),
    "midpoint": ("midpoint", 2, "per-term"),
}


# -- tools --------------------------------------------------------------------------------


def reference(name: str) -> dict[str, Array]:
    """Columns of tests/reference/<name>.csv."""
    lines = [t for t in (REFERENCE / f"{name}.csv").read_text().splitlines() if not t.startswith("#")]
    rows = np.array([[float(x) for x in t.split(",")] for t in lines[1:]])
    return {n: rows[:, i] for i, n in enumerate(lines[0].split(","))}


def monolithic(scene: Scene, h: float, stop: float, k: int, impulses: bool = True) -> Result:
    """The composed scene, k Gauss nodes."""
    model = build_model(scene.declaration(), Collocated(k, impulses=impulses))
    return run(Monolithic(model, NativeInstance(model)), stop=stop, step=h, events=scene.events)


def newton(scene: Scene, h: float, stop: float, k: int) -> Result:
    """Members stepped apart."""
    members = []
    for name, declaration in scene.system.members.items():  # type: ignore[union-attr]
        model = build_model(replace(declaration, name=name), Collocated(k))
        members.append(EngineMember(name, model, NativeInstance(model)))
    return run(Coupled(scene.system, members), stop=stop, step=h, events=scene.events)  # type: ignore[arg-type]


def at(result: Result, times: Array, name: str) -> Array:
    """A signal at given times of the grid."""
    rows = [int(np.argmin(np.abs(result.time - t))) for t in times]
    assert np.allclose(result.time[rows], times, rtol=0, atol=1e-12)
    return result.column(name)[rows]


def worst(result: Result) -> float:
    """Largest step residual of a component relative to the energy in play."""
    return max(c.worst_relative for c in result.ledger.summary().components)


def kirchhoff(result: Result) -> float:
    """Largest sum of joined currents at the end of a step."""
    return max(v for n, v in result.worst.items() if "bus" in n)


def slopes(errors: Sequence[float], steps: Sequence[float]) -> list[str]:
    """Observed order between neighbours; a dash where there is none."""
    e, h = np.array(errors), np.array(steps)
    return ["-", *(f"{s:.2f}" for s in np.log(e[:-1] / e[1:]) / np.log(h[:-1] / h[1:]))]


def table(head: Sequence[str], rows: Sequence[Sequence[Any]]) -> str:
    """A Markdown table; floats with three digits."""
    text = [[f"{x:.2e}" if isinstance(x, float) else str(x) for x in row] for row in rows]
    return "\n".join("| " + " | ".join(r) + " |" for r in [head, ["---"] * len(head), *text])


def four(scheme: tuple[str, int, str], h: float, stop: float, **starts: float) -> dict[str, Array]:
    """The four particles: `x` and all signals by name after every step (the first row: the start)."""
    declaration = four_particle().with_starts(starts)
    model = build_model(declaration, named_scheme(declaration, *scheme))
    stepper = Monolithic(model, NativeInstance(model))
    r = run(stepper, stop=stop, step=h)
    rows = {n: r.values[:, i] for i, n in enumerate(r.names)}
    rows["x"] = np.column_stack([r.column(f"{s}[{i}]") for s in "qv" for i in range(1, 13)])
    return rows


# -- tables --------------------------------------------------------------------------------


def four_particle_convergence() -> str:
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


def four_particle_balance() -> str:
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


def four_particle_large_steps() -> str:
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


def oscillator_coupling() -> str:
    """Error of q1 (m) over 1 s, energy drift, iterations: one model against coupled members."""
    rows, steps = [], (0.04, 0.02, 0.01, 0.005)
    for how in (monolithic, newton):
        for k in (1, 2):
            errors, drift, iterations = [], [], []
            for h in steps:
                r = how(oscillator(), h, 1.0, k)
                exact = (np.cos(2 * np.pi * r.time) + np.cos(6 * np.pi * r.time)) / 2
                errors.append(float(np.abs(r.column("mass1.q") - exact).max()))
                H = sum(r.column(f"{m}.energy.stored") for m in ("mass1", "mass2", "spring12"))
                drift.append(float(np.abs(H - H[0]).max() / H[0]))
                iterations.append(f"{r.iterations / r.steps:.2f}")
            for j, (h, order) in enumerate(zip(steps, slopes(errors, steps), strict=True)):
                label = f"{how.__name__}, order {2 * k} members" if j == 0 else ""
                rows.append([label, f"{h:g}", errors[j], order, drift[j], iterations[j]])
    return table(["coupling", "h in s", "error of q1", "slope", "drift of H / H0", "iterations per step"], rows)


def stator_error(r: Result, ref: dict[str, Array], machines: dict[str, str], until: float = np.inf) -> float:
    """Largest error of stator currents relative to the machine's largest one; machines: member -> suffix."""
    rows, worst_error = ref["time"] <= until, 0.0
    for member, suffix in machines.items():
        largest = max(np.abs(ref[f"I{suffix}[{j}]"]).max() for j in (1, 2, 3))
        for j in (1, 2, 3):
            error = at(r, ref["time"][rows], f"{member}.I[{j}]") - ref[f"I{suffix}[{j}]"][rows]
            worst_error = max(worst_error, float(np.abs(error).max() / largest))
    return worst_error


def angle_error(r: Result, ref: dict[str, Array], machines: dict[str, str], until: float = np.inf) -> float:
    """Largest error of the rotor angles in rad."""
    rows = ref["time"] <= until
    errors = [at(r, ref["time"][rows], f"{m}.theta") - ref[f"theta{suffix}"][rows] for m, suffix in machines.items()]
    return float(np.abs(errors).max())


def machine_table(
    scene: Callable[[], Scene], name: str, machines: dict[str, str], stop: float, steps: Sequence[float]
) -> str:
    """Orders over h, with impulse pairs at bare nodes and without: currents, angles, Kirchhoff residual, ledger."""
    ref, rows = reference(name), []
    for k, impulses in ((1, True), (2, True), (3, True), (1, False), (2, False)):
        found = [monolithic(scene(), h, stop, k, impulses) for h in steps]
        current = [stator_error(r, ref, machines) for r in found]
        angle = [angle_error(r, ref, machines) for r in found]
        kcl = [kirchhoff(r) for r in found]
        order = [slopes(e, steps) for e in (current, angle, kcl)]
        for j, h in enumerate(steps):
            cells = [c for e, o in zip((current, angle, kcl), order, strict=True) for c in (e[j], o[j])]
            rows.append(
                [
                    f"order {2 * k}{'' if impulses else ', no impulses'}" if j == 0 else "",
                    f"{1e3 * h:g}",
                    *cells,
                    worst(found[j]),
                ]
            )
    head = ["scheme", "h in ms", "stator current / max", "slope", "rotor angle in rad", "slope"]
    return table([*head, "KCL residual in A", "slope", "worst ledger"], rows)


def smib_convergence() -> str:
    """Errors over all rows of the reference up to 5 s; Kirchhoff residual at the step ends; ledger."""
    return machine_table(smib, "smib", {"gen": ""}, 5.0, (5e-4, 2.5e-4, 1.25e-4))


def two_machine_order() -> str:
    """Two machines through a fault on [0.02 s, 0.06 s), errors over all reference rows to 0.1 s."""
    scene = lambda: two_machine(t_fault=0.02, t_clear=0.06, stop=0.1)  # noqa: E731
    return machine_table(scene, "two_machine_early", {"m1": "1", "m2": "2"}, 0.1, (2e-4, 1e-4, 5e-5))


def smib_folded_convergence() -> str:
    """The line folded into the machine: stator currents and angle over the rows of the reference up to 1 s."""
    ref, rows = reference("smib"), []
    sizes = {("dq-flux", 1): (1e-3, 5e-4, 2.5e-4), ("dq-flux", 2): (1e-2, 2.5e-3, 1.25e-3, 6.25e-4),
             ("dq-flux", 3): (1e-2, 5e-3, 2.5e-3), ("abc-flux", 1): (1e-4, 5e-5, 2.5e-5),
             ("abc-flux", 2): (1e-3, 5e-4, 2.5e-4), ("abc-flux", 3): (2.5e-3, 1.25e-3, 6.25e-4)}  # fmt: skip
    for (coordinates, k), steps in sizes.items():
        current, angle, ledger = [], [], []
        for h in steps:
            r = monolithic(smib_folded(coordinates=coordinates), h, 1.0, k)  # type: ignore[arg-type]
            # the rows that h meets: 0.505 and 0.51 s are no multiples of large steps
            met = {n: v[np.abs(ref["time"] / h - np.round(ref["time"] / h)) < 1e-6] for n, v in ref.items()}
            current.append(stator_error(r, met, {"gen": ""}, 1.0 + 1e-9))
            angle.append(angle_error(r, met, {"gen": ""}, 1.0 + 1e-9))
            ledger.append(worst(r))
        order = [slopes(e, steps) for e in (current, angle)]
        for j, h in enumerate(steps):
            label = f"{coordinates}, order {2 * k}" if j == 0 else ""
            rows.append([label, f"{1e3 * h:g}", current[j], order[0][j], angle[j], order[1][j], ledger[j]])
    head = ["scheme", "h in ms", "stator current / max", "slope", "rotor angle in rad", "slope", "worst ledger"]
    return table(head, rows)


def smib_coordinates() -> str:
    """The three coordinate systems of the machine, to 0.6 s at 0.1 ms."""
    ref, rows = reference("smib"), []
    for coordinates in ("dq-flux", "abc-flux", "current"):
        r = monolithic(smib(coordinates=coordinates), 1e-4, 0.6, 1)  # type: ignore[arg-type]
        errors = [f(r, ref, {"gen": ""}, 0.6 + 1e-9) for f in (stator_error, angle_error)]
        rows.append([coordinates, *errors, kirchhoff(r), worst(r)])
    head = ["coordinates", "stator current / max", "rotor angle in rad", "KCL residual in A", "worst ledger"]
    return table(head, rows)


def orders() -> str:
    """Slopes and worst ledger closure of every scheme on everything in the library."""
    from phfmu.bench.orders import measure
    from phfmu.bench.orders import table as orders_table

    return orders_table(measure())


TABLES: dict[str, Callable[[], str]] = {
    f.__name__: f
    for f in (
        four_particle_convergence,
        four_particle_balance,
        four_particle_large_steps,
        oscillator_coupling,
        smib_convergence,
        smib_folded_convergence,
        smib_coordinates,
        two_machine_order,
        chain,
        top,
        restart,
        tolerance,
        between,
        orders,
        mass_spring_orders,
    )
}


def write(name: str, text: str) -> None:
    """Replace the table below the command `python docs/make_tables.py <name>` in docs/results."""
    below = re.compile(rf"(^    python docs/make_tables\.py {name}\n\n)(?:\|.*\n)*", re.MULTILINE)
    for page in (Path(__file__).parent / "results").glob("*.md"):
        old = page.read_text(encoding="utf-8")
        page.write_text(below.sub(lambda m: f"{m[1]}{text}\n", old), encoding="utf-8")


if __name__ == "__main__":
    names = [a for a in sys.argv[1:] if a != "--write"] or list(TABLES)
    for name in names:
        if name not in TABLES:
            sys.exit(f"no table '{name}'; there are: {', '.join(TABLES)}")
        text = TABLES[name]()
        print(f"### {name}\n\n{TABLES[name].__doc__}\n\n{text}\n")
        if "--write" in sys.argv:
            write(name, text)
