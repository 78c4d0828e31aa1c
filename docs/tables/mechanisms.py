"""Tables of docs/results/mechanisms.md: mechanisms beside closed forms, published values and other integrations."""

from __future__ import annotations

import re
from collections.abc import Sequence
from typing import Any

import numpy as np
from pages import Array, PageBlock, independent, slopes, table
from scipy.special import ellipk

from phfmu import PHDAE, Monolithic, NativeInstance, Options, StepFailure, build_model, default_scheme, run
from phfmu.components.library import build
from phfmu.engine.native.native import Kind
from phfmu.runs.result import Result
from phfmu.studies.stress.mechanisms import bricard_reference

G = 9.81
#: windows of four bars: time, rows that are compared, step sizes by number of windows and kernels
TIME, ROWS = 20.0, 400
WINDOWS: dict[tuple[int, Kind], tuple[float, ...]] = {
    (40, "compiled"): (0.01, 0.005, 0.002, 0.001), (40, "interpreted"): (0.01,),
    (2, "compiled"): (0.01, 0.005, 0.002, 0.001), (2, "interpreted"): (0.01, 0.005),
}  # fmt: skip
#: mechanism -> time, steps of order 2, steps of order 6
SLOPES: dict[str, tuple[float, tuple[float, ...], tuple[float, ...]]] = {
    "pendulum": (1.0, (4e-3, 2e-3, 1e-3), (1e-1, 5e-2, 2.5e-2)),
    "four_bar": (1.0, (4e-3, 2e-3, 1e-3), (5e-2, 2.5e-2, 1.25e-2)),
    "slider_crank": (0.2, (2e-3, 1e-3, 5e-4), (2e-2, 1e-2, 5e-3)),
    "andrews": (0.03, (1e-4, 5e-5, 2.5e-5), (3e-4, 1.5e-4, 7.5e-5)),
    "bricard": (1.0, (1e-2, 5e-3, 2.5e-3), (1e-1, 5e-2, 2.5e-2)),
    "car_axis": (0.5, (2e-3, 1e-3, 5e-4), (2e-2, 1e-2, 5e-3)),
    "heavy_top": (0.1, (1e-3, 5e-4, 2.5e-4), (5e-3, 2.5e-3, 1.25e-3)),
    "ur5": (0.5, (2e-3, 1e-3, 5e-4), (2e-2, 1e-2, 5e-3)),
    "rope_bridge": (0.5, (2e-3, 1e-3, 5e-4), (1e-2, 5e-3, 2.5e-3)),
    "gear_train": (0.1, (1e-3, 5e-4, 2.5e-4), (5e-3, 2.5e-3, 1.25e-3)),
    "four_particle": (0.5, (4e-3, 2e-3, 1e-3), (5e-2, 2.5e-2, 1.25e-2)),
}
#: columns of positions, velocities and of the forces of joints at the end of a step
GROUPS = {"q": r"q\[", "v": r"v\[", "joint forces": r".*_end\["}


def ran(declaration: PHDAE, order: int, step: float, stop: float, kernels: Kind = "interpreted") -> Result:
    model = build_model(declaration, default_scheme(declaration, order))
    instance = NativeInstance(model, kernels=kernels)
    return run(Monolithic(model, instance), Options(stop=stop, step=stop / round(stop / step)))


def last(result: Result, *names: str) -> Array:
    return np.array([result.column(n)[-1] for n in names])


def _ledger(result: Result) -> float:
    return abs(result.ledger.summary().network.unexplained)


def mechanism_values() -> PageBlock:
    """Each mechanism over its whole run beside what is known of it, and what its ledger leaves unexplained."""
    known, rows = independent("mechanism_reference"), list[list[Any]]()

    def add(name: str, what: str, beside: str, order: int, step: float, error: float, found: Result) -> None:
        rows.append([name, what, beside, order, f"{step:g}", error, _ledger(found)])

    quarter = float(ellipk(0.5)) * (1.0 / G) ** 0.5
    found = ran(build("pendulum"), 6, quarter / 100, 9 * quarter)
    late = abs(last(found, "P[1]")[0]) / (2 * G) ** 0.5 / 9 * 4
    add("A01 pendulum", "period, s", "elliptic integral", 6, quarter / 100, late, found)

    angles = known.ANDREWS
    for order, step in ((2, 2e-5), (6, 5e-5)):
        found = ran(build("andrews"), order, step, 0.03)
        error = float(np.abs(last(found, *angles) - list(angles.values())).max())
        add("A03 Andrews", "seven angles at .03 s, rad", "published", order, step, error, found)
    work = 0.033 * (angles["beta"] + 0.0617138900142764496)
    error = abs(found.ledger.summary().ports[0].supplied - work)
    add("A03 Andrews", "work of its motor, J", "torque times published angle", 6, 5e-5, error, found)

    for order, step in ((2, 0.01), (6, 0.01)):
        found = ran(build("bricard"), order, step, 10.0)
        error = float(np.abs(last(found, *(f"P3[{i}]" for i in (1, 2, 3))) - bricard_reference(10.0)[6:9]).max())
        add("A04 Bricard", "P3 at 10 s, m", "index reduction, DOP853", order, step, error, found)
        add(
            "A04 Bricard",
            "energy over 10 s, J",
            "constant",
            order,
            step,
            float(np.ptp(found.column("energy.stored"))),
            found,
        )

    for order, stop, step in ((2, 0.5, 0.01), (2, 10.0, 0.01), (2, 10.0, 0.002), (6, 10.0, 0.01)):
        found = ran(build("flyball"), order, step, stop)
        height, lost = known.governor(stop)
        add(
            "A05 flyball",
            f"s at {stop:g} s, m",
            "three coordinates, Radau",
            order,
            step,
            abs(last(found, "s")[0] - height),
            found,
        )
        error = abs(found.ledger.summary().network.dissipated - lost)
        add("A05 flyball", f"dissipated until {stop:g} s, J", "three coordinates, Radau", order, step, error, found)

    for order, step in ((2, 1e-3), (6, 2.5e-3)):
        found = ran(build("car_axis"), order, step, 3.0)
        ends = last(found, "left[1]", "left[2]", "right[1]", "right[2]")
        add(
            "car axis",
            "four coordinates at 3 s",
            "published",
            order,
            step,
            float(np.abs(ends - known.CAR_AXIS).max()),
            found,
        )

    q, v = independent("heavy_top_reference").heavy_top(0.1, precession=1.0)
    found = ran(build("heavy_top", precession=1.0), 6, 1e-3, 0.1)
    error = float(np.abs(last(found, *(f"q[{i + 1}]" for i in range(12))) - q).max())
    add("heavy top", "directors at .1 s", "Euler's equations", 6, 1e-3, error, found)
    add("heavy top", "energy, J", "constant", 6, 1e-3, float(np.ptp(found.column("energy.stored"))), found)
    add("heavy top", "Lz, kg.m2/s", "constant", 6, 1e-3, float(np.ptp(_vertical(found))), found)
    return table(["mechanism", "quantity", "beside", "order", "h, s", "difference", "unexplained, J"], rows, ".1e")


def _vertical(found: Result, mass: float = 15.0, radius: float = 0.5) -> Array:
    """Angular momentum about the vertical of the top in directors."""
    q, v = (np.stack([found.column(f"{n}[{i + 1}]") for i in range(12)], 1).reshape(-1, 4, 3) for n in "qv")
    masses = np.array([mass, *[mass * radius**2 / 4] * 2, 0.0])
    return (masses[:, None] * np.cross(q, v)).sum(axis=1)[:, 2]


def mechanism_windows() -> PageBlock:
    """A02: windows of four bars through their flat positions for 20 s, the first crank's tip at 400 times beside one equation."""
    known, rows = independent("mechanism_reference"), list[list[Any]]()
    for (n, kernels), steps in WINDOWS.items():
        exact = known.parallel(n, np.linspace(0.0, TIME, ROWS + 1))
        for order in (2, 6):
            for h in steps:
                try:
                    found = ran(build("four_bar", n=n), order, h, TIME, kernels)
                except StepFailure as failed:
                    rows.append([n, kernels, order, f"{h:g}", f"gives up at {failed.time:g} s", "", ""])
                    continue
                at = np.arange(0, round(TIME / h) + 1, round(TIME / h) // ROWS)
                error = np.abs(np.array([found.column(f"B0[{i}]")[at] for i in (1, 2)]) - exact).max()
                verdict = found.ledger.summary().components[0].verdict
                rows.append([n, kernels, order, f"{h:g}", float(error), _ledger(found), str(verdict)])
    return table(["windows", "kernels", "order", "h, s", "largest error, m", "unexplained, J", "ledger"], rows, ".1e")


def mechanism_slopes() -> PageBlock:
    """Observed orders of positions, velocities and joint forces at the end of a short run, against the last but finer steps of
    order 6."""
    rows = list[list[Any]]()
    for name, (stop, two, six) in SLOPES.items():
        exact = ran(build(name), 6, six[-1] / 4, stop)
        for order, steps in ((2, two), (6, six)):
            runs = [ran(build(name), order, h, stop) for h in steps]
            cells = list[Any]()
            for pattern in GROUPS.values():
                own = [n for n in exact.names if re.match(pattern, n)]
                at = last(exact, *own)
                size = np.abs(at).max()
                errors = [float(np.abs(last(r, *own) - at).max() / size) for r in runs]
                cells += [errors[-1], _observed(errors, steps)]
            rows.append([name if order == 2 else "", order, f"{steps[-1]:g}", *cells])
    return table(["mechanism", "order", "h, s", *(c for g in GROUPS for c in (g, "slope"))], rows, ".1e")


def _observed(errors: Sequence[float], steps: Sequence[float]) -> str:
    """Slopes between neighbours; "exact" where there is only rounding."""
    return "exact" if max(errors) < 1e-12 else ", ".join(slopes(errors, steps)[1:])
