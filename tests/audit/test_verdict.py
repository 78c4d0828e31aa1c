"""The verdict on runs: what creates energy is found, what only rounds is not."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import casadi as ca
import numpy as np
import pytest

import phfmu as ph
from phfmu import PHDAE, Collocated, NativeInstance, Network, Options, PythonInstance, block, build_model, energy, run
from phfmu.audit import AuditWriter, BookedSteps, EventRow, LedgerSummary, read, summarise
from phfmu.audit.booking import Booking, PortKey
from phfmu.audit.kinds import Quality
from phfmu.components.mechanical.translational import mass, spring
from phfmu.network.couplings.coupled import Coupled
from phfmu.network.couplings.monolithic import Monolithic
from phfmu.network.members.engine_member import EngineMember
from phfmu.network.scene import Event
from phfmu.outcome.steps import Steps
from phfmu.signals import SignalKind
from tests.engines import ENGINES
from tests.wide import wide


def oscillator(gain: float = 0.0, damping: float = 0.0, constant: float = 0.0) -> PHDAE:
    """q' = p, p' = -k q - damping p + gain q beside a reservoir of `constant` J that nothing touches."""
    q, p, store = ph.state("q", start=1.0), ph.state("p"), ph.state("store", start=np.sqrt(2.0 * constant))
    k, g, d = ph.parameter("k", 4.0), ph.parameter("gain", gain), ph.parameter("damping", damping)
    return PHDAE(
        "oscillator",
        states=(q, p, store),
        parameters=(k, g, d),
        energies=(energy(0.5 * k.sx * q.sx**2), energy(0.5 * p.sx**2), energy(0.5 * store.sx**2)),
        structure=(block((q, p), ca.blockcat([[0.0, 1.0], [g.sx - 1.0, 0.0]])),),
        dissipation=(block((p,), d.sx),),
    )


def kinds(summary: LedgerSummary) -> set[str]:
    return {v.kind for v in summary.violations}


def ran(model: PHDAE, engine: type, stop: float = 10.0, events: Sequence[Event] = ()) -> LedgerSummary:
    built = build_model(model, Collocated(1))
    return run(Monolithic(built, engine(built)), Options(stop=stop, step=0.01, events=events)).ledger.summary()


@pytest.mark.parametrize("engine", wide(ENGINES, NativeInstance))
def test_energy_made_by_J_is_found_beside_a_large_constant(engine: type) -> None:
    """gain in J alone makes d/dt H = gain p k q: some joule, 1e-9 of what the reservoir holds."""
    assert ran(oscillator(constant=1e10), engine).closed
    summary = ran(oscillator(gain=0.5, constant=1e10), engine)
    (component,) = summary.components
    assert 0.1 < np.abs(component.H_end - 1e10) < 100.0 and component.H_start == pytest.approx(1e10, rel=1e-9)
    assert kinds(summary) == {"balance", "unexplained"}
    assert component.verdict == "VIOLATED"


@pytest.mark.parametrize("engine", ENGINES)
def test_a_negative_resistance_is_found(engine: type) -> None:
    summary = ran(oscillator(damping=-0.3), engine, stop=1.0)
    assert kinds(summary) == {"dissipation"}
    (violation,) = summary.violations
    assert violation.name == "oscillator" and violation.size < 0 and 0.0 <= violation.t0 < 1.0
    assert summary.components[0].worst_ratio <= 1.0  # the balance alone closes over it
    assert summary.network is not None and summary.network.verdict == "closed"


@pytest.mark.parametrize("engine", wide(ENGINES, NativeInstance))
def test_coming_to_rest_closes(engine: type) -> None:
    """Energies fall by 17 orders of magnitude; residuals of the last steps are those of the first ones' rounding."""
    summary = ran(oscillator(damping=2.0), engine, stop=20.0)
    assert summary.components[0].H_end < 1e-16 * summary.components[0].H_start
    assert summary.closed


def test_energy_that_the_engine_changes_unbooked_is_found(tmp_path) -> None:
    """A state that jumps between two calls of the engine; a changed parameter is booked and closes."""
    built = build_model(oscillator(), Collocated(1))
    assert (
        run(Monolithic(built, NativeInstance(built)), Options(stop=1.0, step=0.01, events=[Event(0.5, "k", 5.0)]))
        .ledger.summary()
        .closed
    )

    class Leaks(Monolithic):
        def advance(self, t0: float, h: float, n: int, first: int = 0) -> Steps:
            steps = super().advance(t0, h, n, first)
            self.instance.set_x(t0 + (first + n) * h, self.instance.x + [0.0, 0.01, 0.0])
            self.instance.initialise()
            return replace(steps, H=np.vstack([steps.H[:-1], self.energies()[None]]))

    with AuditWriter(tmp_path / "x.parquet") as sink:
        summary = run(Leaks(built, NativeInstance(built)), Options(stop=1.0, step=0.01, sink=sink)).ledger.summary()
    assert kinds(summary) == {"change"}
    assert summary.components[0].gap != 0.0
    assert summarise(tmp_path / "x.parquet") == summary


class Unit:
    """A unit of another tool: it takes 1 W from its port and says what `books` says."""

    lands = False
    units: dict[str, str] = {}
    kinds: dict[str, SignalKind] = {}
    labels: dict[str, str] = {}

    def __init__(self, pairs: Sequence[float], supplied: float, estimated: bool = False):
        self.names: list[str] = []
        quality = Quality.ESTIMATED if estimated else Quality.EXACT
        port = (PortKey("unit", "shaft", quality=quality),) if len(pairs) else ()
        self.booking = Booking(("unit",), port, frozenset({"unit"} if estimated and not port else ()))
        self._pairs, self._supplied, self._H = np.array(pairs, float), supplied, 0.0

    def inputs(self) -> dict[str, float]:
        return {}

    def settable(self) -> list[str]:
        return []

    def read(self) -> np.ndarray:
        return np.zeros(0)

    def energies(self) -> np.ndarray:
        return np.array([self._H])

    def check_start(self) -> None: ...

    def check_changed(self) -> None: ...

    def prepare(self, t0: float, h: float) -> None: ...

    def rest_changes(self) -> dict:
        return {}

    def notes(self) -> list[str]:
        return []

    def advance(self, t0: float, h: float, n: int, first: int = 0) -> Steps:
        gained = np.full((n, 1), h * self._supplied)
        H = self._H + np.cumsum(gained, axis=0)
        self._H = float(H[-1, 0])
        pairs = np.tile(h * self._pairs, (n, 1))
        return Steps(H, gained, np.zeros((n, 1)), gained, pairs, signals=np.zeros((n, 0)))


def test_books_and_ports_of_a_unit_must_agree() -> None:
    """Ports say 5.80 J, books 2.87 J: each for itself closes."""
    assert run(Unit([5.8], 5.8), Options(stop=1.0, step=0.1)).ledger.summary().closed
    summary = run(Unit([5.8], 2.87), Options(stop=1.0, step=0.1)).ledger.summary()
    assert kinds(summary) == {"ports", "unexplained"}
    assert summary.violations[0].size == pytest.approx(0.1 * (2.87 - 5.80), rel=1e-12)
    assert summary.components[0].verdict == "VIOLATED"


def test_a_unit_that_tells_nothing_is_not_called_closed() -> None:
    verdicts = [
        run(unit, Options(stop=1.0, step=0.1)).ledger.summary().components[0].verdict
        for unit in (Unit([], 0.0, estimated=True), Unit([1.0], 1.0, estimated=True), Unit([1.0], 1.0))
    ]
    assert verdicts == ["none", "estimated", "closed"]


def test_a_changed_parameter_without_energy_is_a_parameter() -> None:
    """What sets it says what it is, not whether H changed; one event at several components is one."""
    built = build_model(oscillator(constant=1.0), Collocated(1))
    result = run(Monolithic(built, NativeInstance(built)), Options(stop=1.0, step=0.01, events=[Event(0.5, "k", 4.0)]))
    assert result.ledger.summary().events == {"parameter": 1}


def test_a_log_tells_how_each_step_was_solved(tmp_path) -> None:
    """Iterations in the row of the network, of a coupling also by which test it took the step; a unit does not tell."""
    net = Network("pair")
    net.add("m", mass(1.0, q=0.1))
    net.add("s", spring(40.0, elongation=0.1))
    net.connect("m.flange", "s.a", name="joint")
    models = {name: build_model(part) for name, part in net.members.items()}
    coupled = Coupled(net, [EngineMember(name, m, PythonInstance(m)) for name, m in models.items()])
    whole = build_model(oscillator(), Collocated(1))
    rows = {}
    for name, stepper in {
        "coupled": coupled, "whole": Monolithic(whole, PythonInstance(whole)), "unit": Unit([5.8], 5.8)
    }.items():  # fmt: skip
        with AuditWriter(tmp_path / f"{name}.parquet") as sink:
            result = run(stepper, Options(stop=0.1, step=0.01, sink=sink))
        rows[name] = [row for row in read(tmp_path / f"{name}.parquet").to_pylist() if row["row"] == "network"]
        assert sum(row.get("iterations", 0) for row in rows[name]) == result.iterations
    assert {row["accepted_by"] for row in rows["coupled"]} == {"energy"}
    assert all(1 <= row["iterations"] <= 4 for row in rows["coupled"] + rows["whole"])
    assert "accepted_by" not in rows["whole"][0] and "iterations" not in rows["unit"][0]


class Blocks:
    """A sink that keeps what it is given."""

    def __init__(self) -> None:
        self.blocks: list[BookedSteps] = []

    def write_steps(self, block: BookedSteps) -> None:
        self.blocks.append(block)

    def write_event(self, event: EventRow) -> None: ...

    def flush(self) -> None: ...


def test_members_and_the_audit_have_one_booking() -> None:
    """What a stepper calls the columns of its steps is what the ledger has: the same object, in no second form."""
    model = build_model(oscillator(), Collocated(1))
    net = Network("pair")
    net.add("m", mass(1.0, q=0.1))
    net.add("s", spring(40.0, elongation=0.1))
    net.connect("m.flange", "s.a", name="joint")
    parts = [EngineMember(n, m, PythonInstance(m)) for n, m in ((n, build_model(d)) for n, d in net.declared.items())]
    steppers = (Monolithic(model, PythonInstance(model)), Coupled(net, parts), Unit([5.8], 5.8, estimated=True))
    for stepper in steppers:
        sink = Blocks()
        run(stepper, Options(stop=0.1, step=0.01, sink=sink))
        assert sink.blocks and all(b.booking is stepper.booking for b in sink.blocks)
    joined, unit = steppers[1].booking, steppers[2].booking
    assert [(p.component, p.port, p.junction) for p in joined.ports[:2]] == [
        ("m", "flange", "joint"),
        ("s", "a", "joint"),
    ]
    assert unit.quality("unit") == Quality.ESTIMATED
