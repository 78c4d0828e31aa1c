"""Tables of docs/results/smib.md: machines at a grid, and the oscillator cut in three."""

from __future__ import annotations

from collections.abc import Callable, Sequence

import numpy as np
from networks import at, kirchhoff, monolithic, newton, worst
from pages import Array, PageBlock, reference, slopes, table

from phfmu import Scene
from phfmu.components.scenes.electrical.smib import smib, smib_folded
from phfmu.components.scenes.electrical.two_machine import two_machine
from phfmu.components.scenes.mechanical.oscillator import oscillator
from phfmu.runs.result import Result


def oscillator_coupling() -> PageBlock:
    """Error of q1 (m) over 1 s, energy drift, iterations: one model against coupled members."""
    rows, steps = [], (0.04, 0.02, 0.01, 0.005)
    for how in (monolithic, newton):
        for k in (1, 2):
            errors, drift, iterations = [], [], []
            for h in steps:
                r = how(oscillator(), h, 1.0, k)
                exact = (np.cos(2 * np.pi * r.time) + np.cos(6 * np.pi * r.time)) / 2
                errors.append(float(np.abs(r.column("mass1.q") - exact).max()))
                H = np.sum([r.column(f"{m}.energy.stored") for m in ("mass1", "mass2", "spring12")], axis=0)
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
) -> PageBlock:
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


def smib_convergence() -> PageBlock:
    """Errors over all rows of the reference up to 5 s; Kirchhoff residual at the step ends; ledger."""
    return machine_table(smib, "smib", {"gen": ""}, 5.0, (5e-4, 2.5e-4, 1.25e-4))


def two_machine_order() -> PageBlock:
    """Two machines through a fault on [0.02 s, 0.06 s), errors over all reference rows to 0.1 s."""
    scene = lambda: two_machine(t_fault=0.02, t_clear=0.06, stop=0.1)  # noqa: E731
    return machine_table(scene, "two_machine_early", {"m1": "1", "m2": "2"}, 0.1, (2e-4, 1e-4, 5e-5))


def smib_folded_convergence() -> PageBlock:
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


def smib_coordinates() -> PageBlock:
    """The three coordinate systems of the machine, to 0.6 s at 0.1 ms."""
    ref, rows = reference("smib"), []
    for coordinates in ("dq-flux", "abc-flux", "current"):
        r = monolithic(smib(coordinates=coordinates), 1e-4, 0.6, 1)  # type: ignore[arg-type]
        errors = [f(r, ref, {"gen": ""}, 0.6 + 1e-9) for f in (stator_error, angle_error)]
        rows.append([coordinates, *errors, kirchhoff(r), worst(r)])
    head = ["coordinates", "stator current / max", "rotor angle in rad", "KCL residual in A", "worst ledger"]
    return table(head, rows)
