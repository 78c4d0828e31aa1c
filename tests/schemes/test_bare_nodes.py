"""Bare nodes: impulse pairs give Kirchhoff at the step ends, order 2k and an exact balance; where they apply and where not."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from reference_tools import read

from phfmu import (
    PHDAE,
    Collocated,
    Event,
    NativeInstance,
    Network,
    Options,
    PythonInstance,
    build_model,
)
from phfmu.components.control import meter
from phfmu.components.electrical.machines.machine_data import machine_set
from phfmu.components.electrical.machines.machine_init import steady_state
from phfmu.components.electrical.machines.synchronous_machine import synchronous_machine
from phfmu.components.electrical.rl_line import rl_line
from phfmu.components.electrical.sources import balanced_current_source
from phfmu.components.scenes.electrical.smib import smib
from phfmu.components.scenes.electrical.two_machine import two_machine
from phfmu.discretise.start import project_start
from phfmu.network.couplings.monolithic import Monolithic
from phfmu.runs.loop import run
from phfmu.terms.bare import bare_nodes
from phfmu.terms.extraction.extract import extract
from tests.engines import ENGINES
from tests.schemes.bare_scenes import (
    RATED,
    STOP,
    joined,
    lumped,
    mean_voltage,
    plant_current,
    saturable,
    saturable_pair,
    scene_inductance,
    two_bare_nodes,
)
from tests.wide import slow, wide


def place(names: list[str], which: str) -> list[int]:
    return [names.index(f"{which}[{j}]") for j in (1, 2, 3)]


def stepped(
    h: float, scheme: Collocated, *, engine=NativeInstance, declaration: PHDAE | None = None, n: int | None = None
):
    """smib with the torque step at t = 0: (model, instance, record)."""
    declaration = smib().declaration() if declaration is None else declaration
    model = build_model(declaration, scheme)
    instance = engine(model)
    free = [name for p in declaration.ports if p.external for name in p.input_names()]
    u = model.u0.copy()
    u[free.index("gen.shaft.torque")] *= 1.1
    instance.set_input(u)
    wanted = ("x", "a", "signals", "stored", "dissipated", "supplied", "pairs")
    return model, instance, instance.run(0.0, h, n or round(STOP / h), record=wanted)


def errors(h: float, scheme: Collocated, scene=None) -> tuple[float, float, float]:
    """Relative error of the stator currents, of the mean voltage [V] at the node, and max |sum of currents| [A]."""
    declaration = (scene or smib()).declaration()
    model, instance, r = stepped(h, scheme, declaration=declaration)
    observed = instance.signal("observables")
    current = observed[place(list(model.observable_names), "gen.I")]
    names = [n for v in declaration.algebraics for n in v.names()]
    voltage = r["a"][-1][place(names, "bus1.v")]
    kirchhoff = np.max(np.abs(r["signals"][:, instance.layout["observables"]][:, -len(model.checks) :]))
    reference = lumped()[0](STOP)  # type: ignore[operator]
    return np.max(np.abs(current - reference)) / RATED, np.max(np.abs(voltage - mean_voltage(h))), kirchhoff


@pytest.mark.parametrize(
    ("k", "steps"), [slow((1, (1e-3, 5e-4, 2.5e-4))), (2, (1e-3, 5e-4, 2.5e-4)), slow((3, (2e-3, 1e-3)))]
)
def test_order_of_currents_and_mean_node_voltage(k: int, steps: tuple[float, ...]) -> None:
    """Against the same circuit without a node: order 2, 4, 6; Kirchhoff at the step ends to rounding."""
    found = np.array([errors(h, Collocated(k)) for h in steps])
    slopes = np.log2(found[:-1, :2] / found[1:, :2])
    np.testing.assert_allclose(slopes, 2 * k, atol=0.15 if k < 3 else 0.25)
    assert found[:, 2].max() <= 1e-10 * RATED


def test_plain_collocation_loses_order_at_the_node() -> None:
    """What the impulses are there for: without them order 2 at k = 2, and 560 A instead of 0 at the step ends."""
    found = np.array([errors(h, Collocated(2, impulses=False)) for h in (1e-3, 5e-4)])
    assert np.log2(found[0, 0] / found[1, 0]) == pytest.approx(2.0, abs=0.2)
    assert found[0, 2] > 100.0


@pytest.mark.parametrize("k", wide([1, 2, 3], 1, 2))
def test_balance_of_every_component_and_of_the_node(k: int) -> None:
    model, instance, r = stepped(1e-3, Collocated(k))
    H = instance.signal("H").sum()
    assert np.max(np.abs(r["stored"] + r["dissipated"] - r["supplied"])) <= 1e-15 * H
    names = [n for p in model.declaration.ports if p.bound is not None for n in [p.name] * p.n]
    at_node = [i for i, n in enumerate(names, model.step.nu) if n in ("gen.terminal", "line.a")]
    assert np.max(np.abs(r["pairs"][:, at_node].sum(axis=1))) <= 1e-14 * H
    change = H - sum(NativeInstance(model).signal("H"))
    assert change == pytest.approx(r["stored"].sum(), abs=1e-13 * H)


def test_python_and_native_agree() -> None:
    (_, _, a), (_, _, b) = (stepped(1e-3, Collocated(2), engine=e, n=20) for e in ENGINES)
    for block in ("x", "a", "pairs"):
        scale = np.max(np.abs(a[block]), axis=0) + 1e-300
        assert np.max(np.abs(a[block] - b[block]) / np.maximum(scale, 1e-6 * scale.max())) <= 1e-10


@pytest.mark.parametrize("k", [1, 2, 3])
def test_there_and_back(k: int) -> None:
    """The pair is time-symmetric: T of the reversed step is the inverse."""
    model, instance, _ = stepped(1e-3, Collocated(k), n=10)
    for i in range(10):
        instance.do_step((10 - i) * 1e-3, -1e-3)
    scale = np.array([v.nominal[j] for v in model.declaration.states for j in range(v.n)])
    assert np.max(np.abs(instance.x - model.x0) / scale) <= 1e-11


def test_other_references_for_the_node_voltages() -> None:
    """v -> S_c v (line-to-line voltages, bad scaling) changes no state: the pair is covariant."""
    s_c = np.array([[1.0, -1.0, 0.2], [0.0, 30.0, -1.0], [0.4, 0.0, 0.05]])
    data = machine_set("kundur555_1q", d=50.0)
    start = steady_state(data)

    def network(matrix: np.ndarray) -> PHDAE:
        def turned(model: PHDAE, port: str) -> PHDAE:
            new = [replace(p, on={v: _times(b, v.n, matrix) for v, b in p.on.items()}) if p.name == port else p
                   for p in model.ports]  # fmt: skip
            return replace(model, ports=tuple(new))

        net = Network("turned")
        net.add("gen", turned(synchronous_machine(data, start=start), "terminal"))
        net.add("line", turned(rl_line(1e-3, 1e-4, i=[-x for x in start.I[:3]], v=2e4), "a"))
        net.junction("bus1", ["gen.terminal", "line.a"])
        return net.compose()

    runs = []
    for matrix in (np.eye(3), s_c):
        model = build_model(network(matrix), Collocated(2))
        instance = NativeInstance(model)
        runs.append(instance.run(0.0, 5e-4, 40, record=("x",))["x"])
    scale = np.array([v.nominal[j] for v in model.declaration.states for j in range(v.n)])
    assert np.max(np.abs(runs[0] - runs[1]) / scale) <= 1e-12


def _times(b: object, n: int, matrix: np.ndarray) -> object:
    import casadi as ca

    return ca.mtimes(ca.SX(b) if ca.SX(b).numel() > 1 else ca.SX(b) * ca.SX.eye(n), ca.DM(matrix))  # type: ignore[arg-type]


@pytest.mark.slow
def test_abc_flux_machine() -> None:
    """H depends on the angle: corrected gradient there, the node stays exact."""
    found = np.array([errors(h, Collocated(2), smib(coordinates="abc-flux")) for h in (5e-4, 2.5e-4)])
    assert np.log2(found[0, 0] / found[1, 0]) == pytest.approx(4.0, abs=0.15)
    assert found[:, 2].max() <= 1e-10 * RATED


def test_two_machines_keep_kirchhoff_through_fault_and_clearing() -> None:
    scene = two_machine(t_fault=0.02, t_clear=0.06, stop=0.1)
    model = build_model(scene.declaration(), Collocated(2))
    r = run(Monolithic(model, NativeInstance(model)), Options(stop=0.1, step=1e-4, events=scene.events))
    assert r.worst and max(r.worst.values()) <= 1e-10 * RATED
    ref = read("two_machine_early")
    rows = [int(np.argmin(np.abs(r.time - t))) for t in ref["time"] if t <= 0.1]
    error = np.max(np.abs(r.column("m1.I[1]")[rows] - ref["I1[1]"][: len(rows)])) / np.max(np.abs(ref["I1[1]"]))
    assert error <= 1e-6


@pytest.mark.slow
def test_two_bare_nodes_in_a_row() -> None:
    """bus2 joins two lines (linear by itself) but shares a line with bus1: both get impulses."""
    declaration = two_bare_nodes()
    assert [(n.name, n.remedy) for n in bare_nodes(extract(declaration))] == [
        (f"bus{b}.v[{j}]", "pair") for b in (1, 2) for j in (1, 2, 3)
    ]
    ends = []
    for h in (1e-3, 5e-4, 2.5e-4, 1.25e-4):
        model = build_model(declaration, Collocated(2))
        instance = NativeInstance(model)
        ends.append(instance.run(0.0, h, round(0.016 / h), record=("x",))["x"][-1])
        assert np.max(np.abs(instance.signal("observables")[-6:])) <= 1e-10 * RATED
    scale = np.array([v.nominal[j] for v in declaration.states for j in range(v.n)])
    gaps = [np.max(np.abs(a - b) / scale) for a, b in zip(ends[:-1], ends[1:], strict=True)]
    assert np.log2(gaps[1] / gaps[2]) == pytest.approx(4.0, abs=0.15)


def test_which_nodes_are_bare() -> None:
    linear = joined(rl_line(1.0, 1.0), rl_line(1.0, 2.0))
    assert bare_nodes(extract(linear)) == []  # stays at rounding by itself
    assert build_model(linear, Collocated(2)).step.nw == 2 * 6 + 2 * 3
    (node,) = bare_nodes(extract(saturable_pair()))
    assert node.remedy == "projection" and "saturation" in node.reason
    assert bare_nodes(extract(smib(coordinates="current").declaration())) == []  # currents are states: linear


@pytest.mark.parametrize("k", [1, 2])
def test_saturation_projects_and_books_the_loss(k: int) -> None:
    """Kirchhoff exact at the step ends, the stored energy of a step exact, and the node loses, never gains."""
    declaration = joined(saturable("a", 1.0, 1.0), saturable("b", 0.5, -0.5897545123))
    start = project_start(build_model(declaration))
    ends, losses = [], []
    for h in (0.1, 0.05, 0.025, 0.0125):
        model = build_model(declaration, Collocated(k))
        instance = PythonInstance(model)
        instance.set_x(0.0, start.x)
        instance.initialise()
        H0 = instance.signal("H").sum()
        wanted = ("x", "stored", "dissipated", "supplied", "pairs", "signals")
        r = instance.run(0.0, h, round(1.0 / h), record=wanted, inputs=np.tile([5.0, 0.0], (round(1.0 / h), 1)))
        assert abs(instance.signal("observables")[-1]) <= 1e-12
        assert abs(instance.signal("H").sum() - H0 - r["stored"].sum()) <= 1e-13
        assert np.max(np.abs(r["stored"] + r["dissipated"] - r["supplied"])) <= 1e-14
        at_node = [i for i, p in enumerate(extract(declaration).pairs) if p.port.bound is not None]
        losses.append(-r["pairs"][:, at_node].sum())
        ends.append(r["x"][-1])
    assert min(losses) >= -1e-15 and losses[0] > (1e-7 if k == 1 else 1e-12)
    gaps = [np.max(np.abs(a - b)) for a, b in zip(ends[:-1], ends[1:], strict=True)]
    assert np.log2(gaps[1] / gaps[2]) == pytest.approx(2 * k, abs=0.15)


def test_an_event_that_breaks_kirchhoff_projects_the_state() -> None:
    """The line's inductance doubles: its current would halve at once; the impulse moves both sides, its loss is booked."""
    scene = smib()
    model = build_model(scene.declaration(), Collocated(2))
    sink = Rows()
    events = [Event(0.005, "line.L", 2.0 * scene_inductance(model))]
    instance = NativeInstance(model)
    before = instance.signal("H").sum()
    r = run(Monolithic(model, instance), Options(stop=0.01, step=1e-3, events=events, sink=sink))
    assert max(r.worst.values()) <= 1e-10 * RATED
    assert [(e.kind, e.component) for e in sink.events] == [
        ("parameter", "line"), ("reprojection", "gen"), ("reprojection", "line"),
    ]  # fmt: skip
    assert sink.events[0].energy_jump < 0 and sum(e.energy_jump for e in sink.events[1:]) < 0
    summary = r.ledger.summary()
    assert summary.closed and summary.events == {"parameter": 1, "reprojection": 1}
    stored = instance.signal("H").sum() - before
    booked = sum(c.stored for c in r.ledger.summary().components) + sum(e.energy_jump for e in sink.events)
    assert stored == pytest.approx(booked, abs=1e-12 * 2e9)


class Rows:
    """An audit sink that keeps event rows."""

    def __init__(self) -> None:
        self.events: list = []

    def write_event(self, row) -> None:
        self.events.append(row)

    def __getattr__(self, name: str):
        return lambda *args, **kwargs: None


def with_plant(plant: complex) -> PHDAE:
    """smib with a balanced current source at the node between machine and line."""
    members = smib().system.members  # type: ignore[union-attr]
    line = members["line"]
    own = dict(zip(line.states[0].names(), plant_current(plant, 2 * np.pi * 60.0, 0.0), strict=True))
    starts = dict(zip(line.states[0].names(), line.states[0].start, strict=True))
    net = Network("with_plant")
    net.add("gen", members["gen"])
    net.add("line", line.with_starts({n: starts[n] + float(line.parameters[1].start[0]) * own[n] for n in own}))
    net.add("grid", members["grid"])
    net.add("plant", balanced_current_source(plant, 60.0, v=2e4, i=abs(plant)))
    net.junction("bus1", ["gen.terminal", "line.a", "plant.terminal"])
    net.junction("bus2", ["line.b", "grid.terminal"])
    return net.compose()


@pytest.mark.parametrize("k", [1, 2, 3])
def test_what_a_source_gives_at_a_node_is_not_zero(k: int) -> None:
    """Its current is given by a row of its own, as that of a meter, and is another one."""
    plant = 0.4 * RATED * np.exp(0.3j)
    declaration = with_plant(plant)
    nodes = bare_nodes(extract(declaration))
    assert {n.remedy for n in nodes} == {"none"} and "other algebraic variables" in nodes[0].reason
    found = []
    for h in (4e-4, 2e-4):
        model, instance, r = stepped(h, Collocated(k), declaration=declaration)
        currents = instance.signal("observables")[place(list(model.observable_names), "gen.I")]
        found.append(np.max(np.abs(currents - lumped(plant)[0](STOP))) / RATED)  # type: ignore[operator]
        left = r["stored"] + r["dissipated"] - r["supplied"]
        assert np.abs(left).max() <= 1e-13 * np.abs(r["dissipated"]).sum()
    order = {1: 2, 2: 2, 3: 4}[k]  # the node is met at the nodes of the step only
    assert found[1] <= {1: 5e-4, 2: 4e-4, 3: 4e-8}[k] and np.log2(found[0] / found[1]) == pytest.approx(order, abs=0.1)


@pytest.mark.parametrize("k", [1, 2])
def test_an_ideal_meter_at_a_bare_node_changes_nothing(k: int) -> None:
    """Its current is an algebraic variable that is zero by a row of its own: Kirchhoff at the step ends needs the pairs still."""
    scene = smib()
    net = Network("metered")
    for name, member in (*scene.system.members.items(), ("meter", meter(24e3, 555e6, frequency=False))):
        net.add(name, member)
    net.junction("bus1", ["gen.terminal", "line.a", "meter.a"])
    net.junction("bus2", ["line.b", "grid.terminal"])
    events = (Event(0.0, "gen.shaft.torque", scene.events[0].value),)
    found = []
    for declaration in (net.compose(), scene.declaration()):
        unit = NativeInstance(build_model(declaration, Collocated(k)))
        r = run(Monolithic(unit.model, unit), Options(stop=STOP, step=2e-4, events=events))
        checks = np.abs(unit.signal("observables")[-len(unit.model.checks) :])
        assert (checks <= 1e-13 * np.array(unit.model.check_scale)).all()
        found.append(np.array([r.column(f"gen.I[{j}]") for j in (1, 2, 3)]))
    assert np.abs(found[0] - found[1]).max() < 1e-11 * RATED
