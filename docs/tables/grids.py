"""Tables and pictures of docs/results/grids.md: power networks from files, their operating points, faults and trips."""

from __future__ import annotations

import json
import re
import sys
import tempfile
from collections.abc import Sequence
from functools import cache
from importlib import import_module
from pathlib import Path
from typing import Any

import numpy as np
from pages import DOCS, ROOT, Array, PageBlock, slopes, table

from phfmu import Collocated, Monolithic, NativeInstance, Options, Scene, build_model, run
from phfmu.components.grids import grid_model
from phfmu.components.scenes.electrical.grids import ieee39, new_england, public_grid, wecc240
from phfmu.derivatives.steady_steps import steady_steps
from phfmu.operating import NetworkPoint
from phfmu.runs.result import Result
from phfmu.studies.figures import pyplot, save

PUBLISHED = ROOT / "tests" / "reference" / "data" / "grids"
#: begin and end of the fault of long runs [s], their length [s], their rows [s], and their steps [s] by grid
FAULT, STOP, EACH = (0.1, 0.15), 10.0, 0.01
STEPS = {"ieee39": 1e-4, "wecc240": 2e-4}
#: kinds of members by the words that their names begin with
KINDS = {
    "machines": "gen", "lines": "line", "transformers": "transformer", "loads and charging": "load|shunt|reactor|conductance",
    "plants": "plant|feed", "series capacitors": "capacitors", "fault": "fault", "meters and controllers": "meter|avr|gov|pss",
}  # fmt: skip


def grid_power_flows() -> PageBlock:
    """Largest differences of the operating points from solutions of others: pandapower's, and those published with the cases."""
    rows = []
    for name in ("wscc9", "new_england", "ieee39", "wecc240"):
        if name == "wscc9":
            module: Any = import_module("phfmu.components.scenes.electrical.wscc9")  # the module, not its function
            point = module._point("dq-flux")
            flow = json.loads((ROOT / "tests" / "operating" / "wscc9_power_flow.json").read_text())
            base = {b: module.PLANTS[b][2] if b in module.PLANTS else module.VOLTAGE for b in flow}
            own = np.array([point.magnitude(f"bus{b}") / base[b] * np.exp(1j * point.angle(f"bus{b}")) for b in flow])
            other = np.array([v * np.exp(1j * np.radians(angle)) for v, angle, *_ in flow.values()])
            source, members = "`tests/operating/wscc9_power_flow.json`", len(point.started().members)
        else:
            model = grid_model(public_grid(name), plants="currents", controls=False)
            point, voltages, members = model.point, model.voltages(), len(model.network.members)
            numbers, other, source = _solved(name)
            own = np.array([voltages[n] for n in numbers])
        magnitude, angle = np.abs(np.abs(own) - np.abs(other)), np.abs(np.angle(own / other))
        rows.append(
            [
                name,
                len(own),
                members,
                point.iterations,
                point.residual,
                float(magnitude.max()),
                float(angle.max()),
                source,
            ]
        )
    head = ["grid", "buses", "members", "iterations", "residual of the rates", "voltage, pu", "angle, rad", "beside"]
    return table(head, rows, notes=(
        "The files of 39 and 240 buses have five or six digits of voltages and allow no smaller difference; in the latter the "
        "resistance of a series capacitor is left out, which moves seven voltages beside it by more than 1e-5.",
    ))  # fmt: skip


def _solved(name: str) -> tuple[list[int], Array, str]:
    """Buses, phasors in per unit, and where they are from."""
    if name == "new_england":
        import pandapower.networks as cases  # pyright: ignore[reportMissingImports]
        from pandapower import runpp  # pyright: ignore[reportMissingImports]

        net: Any = cases.case39()
        runpp(net, tolerance_mva=1e-10, calculate_voltage_angles=True, trafo_model="pi", init="dc", numba=False)
        v = net.res_bus.vm_pu.to_numpy() * np.exp(1j * np.radians(net.res_bus.va_degree.to_numpy()))
        return [int(k) + 1 for k in net.bus.index], v, "`runpp` of pandapower on its case39"
    flow = json.loads((PUBLISHED / f"{name}.json").read_text())
    v = np.array(flow["bus_Vm"]) * np.exp(1j * np.array(flow["bus_Va"]))
    return list(flow["bus_num"]), v, "published with the case, five digits"


def grid_steady() -> PageBlock:
    """`wscc9_steady` after 1 s, turned back to the start: largest difference of a state relative to its amplitude, from the
    operating point of the equations and from where the steps stay."""
    rows = []
    point: Any = import_module("phfmu.components.scenes.electrical.wscc9")._point("dq-flux")
    for k, step in ((1, 1e-4), (1, 5e-5), (2, 1e-4), (2, 5e-5), (3, 2e-4), (3, 1e-4)):
        found = steady_steps(point, Collocated(k), step)
        moved = f"{found.omega / point.omega - 1.0:.1e}"
        rows.append([2 * k, f"{1e6 * step:g}", *_drift(point, k, step), _drift(found, k, step)[0], moved])
    return table(
        ["order", "step, us", "drift after 1 s", "of", "from where steps stay", "frequency of the steps"], rows
    )


def _drift(point: NetworkPoint, k: int, step: float) -> tuple[float, str]:
    """The largest difference after 1 s, and of which state."""
    declaration = point.started().compose()
    unit = NativeInstance(build_model(declaration, Collocated(k)))
    unit.run(0.0, step, round(1.0 / step), record=())
    names = [n for v in declaration.states for n in v.names()]
    drift = point.drift(dict(zip(names, np.array(unit.x), strict=True)), 1.0)
    last = max(drift, key=lambda n: drift[n])
    return float(drift[last]), f"`{last}`"


def _of_tests(module: str) -> Any:
    """A module of the tests, which compare with the same references."""
    sys.path.insert(0, str(ROOT))
    return import_module(f"tests.{module}")


def _nine() -> Any:
    """The nine buses in phase coordinates, integrated by DOP853."""
    return _of_tests("components.test_nine_buses")


def grid_fault_orders() -> PageBlock:
    """`wscc9`, a fault of 20 ohm at bus 7 from 20 to 40 ms, to 60 ms: line currents beside their largest, rotor angles."""
    nine, rows, steps = _nine(), [], (1e-4, 5e-5, 2.5e-5)
    for k in (1, 2, 3):
        found = [nine.errors(k, h, 0.05, 0) for h in steps]
        orders = [slopes([e[j] for e in found], steps) for j in (0, 1)]
        for n, h in enumerate(steps):
            cells = [c for j in (0, 1) for c in (float(found[n][j]), orders[j][n])]
            rows.append([2 * k if n == 0 else "", f"{1e6 * h:g}", *cells])
    return table(["order", "step, us", "line currents / max", "slope", "rotor angles, rad", "slope"], rows)


def grid_openings() -> PageBlock:
    """`wscc9_trip`, 25 us: when the poles of line 5-7 open beside the zeros in phase coordinates, current and loss of each."""
    nine, rows = _nine(), []
    zeros = nine.opened()
    for k in (1, 2, 3):
        r = nine.tripped(k)
        for pole, ((t, i), zero, lost) in enumerate(zip(nine.openings(r), zeros, nine.lost(r), strict=True)):
            rows.append([2 * k if not pole else "", "abc"[pole], f"{1e3 * t:.9f}", abs(t - zero), abs(i), lost])
    return table(["order", "pole", "opens at, ms", "from the zero, s", "current, A", "lost, J"], rows)


def simulated(scene: Scene, k: int, step: float, signals: Sequence[str] = (), every: float | None = None) -> Result:
    """The scene in order 2k; its ledger must be closed."""
    model = build_model(scene.declaration(), Collocated(k))
    r = run(
        Monolithic(model, NativeInstance(model)),
        Options(
            stop=scene.stop, step=step, events=scene.events, restart=scene.restart, signals=tuple(signals), every=every
        ),
    )
    assert r.ledger.summary().closed, scene.name
    return r


def swing(r: Result) -> dict[str, Array]:
    """Angle of each machine [rad] from the mean of all, from its start on."""
    machines = sorted({m[1] for n in r.names if (m := re.fullmatch(r"(gen\w+)\.theta", n))})
    turned = np.array([r.column(f"{m}.theta") - r.column(f"{m}.theta")[0] for m in machines])
    return dict(zip(machines, turned - turned.mean(axis=0), strict=True))


#: times at which the fault of `new_england` ends [s], and until when its machines are looked at [s]
CLEARED, FIRST_SWINGS = (0.2225, 0.223), 5.0


def grid_clearing() -> PageBlock:
    """`new_england`, fault of 0.001 pu at bus 16 from 0.1 s on: the largest angle from the mean of all machines within 5 s.

    By steps of orders 2 and 4, and by phasors, which leave out the transients of stators and lines.
    """
    rows = []
    for k in (1, 2):
        for clear in CLEARED:
            r = simulated(new_england(t_clear=clear, stop=FIRST_SWINGS), k, 1e-4, ["gen*.theta"], EACH)
            rows.append([f"order {2 * k}", *_synchronism(clear, swing(r))])
    swings = _of_tests("reference.phasor_reference").Swings(public_grid("new_england"))
    for clear in (0.2175, 0.22):
        turned = swings.after(16, FAULT[0], clear, np.arange(clear, FIRST_SWINGS, EACH))
        found = {f"gen{b}": a for b, a in zip(swings.buses, turned, strict=True)}
        rows.append(["phasors", *_synchronism(clear, found)])
    return table(["by", "fault ends at, s", "largest angle, rad", "of", "synchronism"], rows)


def _synchronism(clear: float, turned: dict[str, Array]) -> list[str]:
    """When the fault ends, the largest angle and its machine, and which machines lose their synchronism."""
    angles = {m: float(np.abs(a).max()) for m, a in turned.items()}
    lost = [m for m, a in angles.items() if a > np.pi]
    first = max(angles, key=lambda m: angles[m])
    return [f"{clear:g}", f"{angles[first]:.2f}", f"`{first}`", f"lost: {', '.join(lost)}" if lost else "held"]


@cache
def faulted(name: str) -> Result:
    """The long run of `ieee39` or `wecc240` with its controllers."""
    make = {"ieee39": ieee39, "wecc240": wecc240}[name]
    scene = make(t_fault=FAULT[0], t_clear=FAULT[1], stop=STOP, controls=True)
    kept = ["*.energy.stored", "*.energy.supplied", "*.energy.dissipated", "gen*.theta", "gen*.p"]
    return simulated(scene, 1, STEPS[name], kept, EACH)


def speeds(r: Result) -> dict[str, Array]:
    """Deviation of each machine's speed from its start, in per unit."""
    return {n[:-2]: r.column(n) / r.column(n)[0] - 1.0 for n in r.names if re.fullmatch(r"gen\w+\.p", n)}


def grid_ieee39() -> PageBlock:
    """`ieee39` with its controllers, a fault of 50 ms at bus 16, 10 s: where the energy went, in MJ."""
    return _energies("ieee39")


def grid_map() -> PageBlock:
    """docs/results/img/grids_map.svg: the 39 buses of `ieee39`, energy through all ports in its fault."""
    return PageBlock(draw=_map)


def _map() -> Sequence[Path]:
    from phfmu.cli import main
    from phfmu.report.page.flows import ports
    from phfmu.report.page.grid_diagram import grid_diagram
    from phfmu.report.page.history import read_history

    with tempfile.TemporaryDirectory() as folder:
        audit = Path(folder) / "ieee39.audit.parquet"
        main(["run", "ieee39", "--stop", f"{FAULT[1]:g}", "--audit", str(audit), "--quiet"])
        svg, _ = grid_diagram(ports(read_history(audit).within(*FAULT)), {})
    path = DOCS / "results" / "img" / "grids_map.svg"
    path.write_text(svg + "\n", encoding="utf-8")
    return [path]


def grid_wecc240() -> PageBlock:
    """`wecc240` with its controllers, a fault of 50 ms at bus 3803, 10 s: where the energy went, in MJ."""
    return _energies("wecc240")


def _energies(name: str) -> PageBlock:
    """Per kind of member: in the fault and after it."""
    r, rows = faulted(name), []
    first, cleared, last = (int(np.flatnonzero(r.time <= t + 1e-9)[-1]) for t in (*FAULT, STOP))
    owners = sorted({n.split(".energy.")[0] for n in r.names if ".energy." in n})
    sums = np.zeros(6)
    for kind, words in KINDS.items():
        own = [m for m in owners if re.match(rf"({words})\d", m)]
        spans = ((first, cleared), (cleared, last))
        moved = [_moved(r, own, what, *span) for span in spans for what in ("stored", "dissipated", "supplied")]
        values = np.array(moved) / 1e6
        if own and np.abs(values).max() > 5e-4:
            rows.append([kind, *(f"{v:.3f}" for v in values)])
        sums += values
    rows.append(["**all**", *(f"{v:.3f}" for v in sums)])
    head = [
        f"{what}, {when}"
        for when in ("in the fault", "after it")
        for what in ("stored", "dissipated", "taken at ports")
    ]
    return table(["members", *head], rows, notes=(_ending(r),), draw=lambda: _draw(name))


def _moved(r: Result, owners: Sequence[str], what: str, first: int, last: int) -> float:
    names = [n for m in owners if (n := f"{m}.energy.{what}") in r.names]
    return float(sum(r.column(n)[last] - r.column(n)[first] for n in names))


def _ending(r: Result) -> str:
    """Whether all machines hold their synchronism, and how far speeds are from each other at the end."""
    turned, moving = swing(r), speeds(r)
    lost = [m for m, a in turned.items() if np.abs(a).max() > np.pi]
    v = np.array(list(moving.values()))
    spread = v.max(axis=0) - v.min(axis=0)
    largest = max(float(np.abs(a).max()) for a in turned.values())
    words = (
        f"{', '.join(lost)} lose their synchronism" if lost else f"all {len(turned)} machines hold their synchronism"
    )
    return (
        f"{words}; speeds differ by {spread.max():.1e} per unit at the most, by {spread[-1]:.1e} at {STOP:g} s; "
        f"they are {v[:, -1].mean():+.1e} from where they began; "
        f"largest angle from the mean {largest:.2f} rad"
    )


def _draw(name: str) -> Sequence[Path]:
    """docs/results/img/grids_<name>.png: speeds of all machines, and energies by kind of member."""
    plt = pyplot()

    r = faulted(name)
    figure, (left, right) = plt.subplots(1, 2, figsize=(11, 3.6), constrained_layout=True)
    v = 1e3 * np.array(list(speeds(r).values()))
    left.plot(r.time, v.T, lw=0.6)
    left.set_ylabel("speed from that at the start, 1e-3 pu")
    left.set_title(f"{name}: {len(v)} machines", loc="left", fontsize=10)
    for kind, what in (("machines", "stored"), ("fault", "dissipated")):
        own = {n.split(".energy.")[0] for n in r.names if re.match(rf"({KINDS[kind]})\d.*\.energy\.", n)}
        E: Any = sum(r.column(f"{m}.energy.{what}") for m in own if f"{m}.energy.{what}" in r.names)
        right.plot(r.time, (E - E[0]) / 1e6, lw=1.2, label=f"{kind}: {what}")
    right.set_ylabel("MJ")
    right.legend(fontsize=8, frameon=False)
    for panel in (left, right):
        panel.set_xlabel("time, s")
        panel.grid(alpha=0.25)
        panel.spines[["top", "right"]].set_visible(False)
    path = DOCS / "results" / "img" / f"grids_{name}.png"
    save(figure, path, 110)
    return [path]
