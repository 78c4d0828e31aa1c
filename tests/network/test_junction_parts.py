"""What a coupling does at its junctions, part by part: parts come from rows and impulses, junctions from the books of members."""

from __future__ import annotations

from dataclasses import replace
from functools import cache
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from phfmu import (
    ELECTRICAL,
    PHDAE,
    Collocated,
    Coupled,
    EngineMember,
    Event,
    Monolithic,
    NativeInstance,
    Network,
    Options,
    Port,
    PythonInstance,
    build_model,
    damping,
    energy,
    run,
    state,
)
from phfmu.audit import AuditWriter, Booking, Ledger, PartKey, PortKey, audit_table, read, summarise
from phfmu.audit.tables.sheets import sheets
from phfmu.components.scenes.electrical.smib import smib
from phfmu.network.couplings.coupling import Unconverged
from phfmu.network.couplings.newton import Newton, newton
from phfmu.network.couplings.unconverged import POLICIES
from phfmu.outcome.status import Status
from phfmu.outcome.steps import Steps
from tests.engines import ENGINES
from tests.network.both_loops import called_back, impatient

H = 1e-3
PARTS = [
    *(("bus1", part) for part in ("node 1", "node 2", "impulse at start", "impulse at end")),
    *(("bus2", part) for part in ("node 1", "node 2")),
]


@cache
def models(k: int) -> dict[str, Any]:
    net: Any = smib().system
    return {n: build_model(d, Collocated(k)) for n, d in net.members.items()}


def coupled(engine: Any, coupling: Any = newton, k: int = 2) -> Coupled:
    members: list[Any] = [EngineMember(n, m, engine(m)) for n, m in models(k).items()]
    net: Any = smib().system
    return Coupled(net, members, coupling)


def stopped(engine: Any) -> Any:
    """A run of which the first trial of each step is kept."""
    own = impatient(coupled(engine, lambda j: POLICIES["accept"](newton(j))))
    return run(own, Options(stop=5 * H, step=H))


def of_junctions(summary: Any) -> dict[str, float]:
    sums = dict.fromkeys((j.junction for j in summary.junctions), 0.0)
    for p in summary.parts:
        sums[p.junction] += p.residual
    return sums


def test_parts_add_up_to_the_junction_whatever_is_left_of_the_iteration() -> None:
    summary = stopped(PythonInstance).ledger.summary()
    assert [(p.junction, p.part) for p in summary.parts] == PARTS
    for j in summary.junctions:
        assert abs(j.residual) > 1e-9 * j.exchanged, "there is something to explain"
        own = [p.residual for p in summary.parts if p.junction == j.junction]
        assert sum(own) == pytest.approx(j.residual, abs=1e-12 * j.exchanged)
        assert max(map(abs, own)) < 1e3 * abs(j.residual) and min(map(abs, own[:2])) > 1e-3 * abs(j.residual)
    assert not summary.violations


@pytest.mark.slow
def test_steps_taken_in_parts_have_them_too() -> None:
    """Halved where the iteration is given up: both halves, and theirs, are in the parts."""
    own = coupled(PythonInstance, lambda j: POLICIES["halve"](newton(j)))
    take = own._one

    def only_short(last: Any, t: float, h: float) -> Any:
        if h > H / 3:
            raise Unconverged(Status.NO_CONVERGENCE, "smib", t, h)
        return take(last, t, h)

    own._one = only_short  # type: ignore[method-assign]
    result = run(own, Options(stop=2 * H, step=H))
    summary = result.ledger.summary()
    assert summary.events == {"halved": 2} and summary.closed
    (start,) = [p for p in summary.parts if p.part == "impulse at start"]
    sums = of_junctions(summary)
    for j in summary.junctions:
        assert j.exchanged and sums[j.junction] == pytest.approx(j.residual, abs=1e-14 * j.exchanged)
    whole = run(coupled(PythonInstance), Options(stop=2 * H, step=H / 4)).ledger.summary()
    (quarters,) = [p for p in whole.parts if p.part == "impulse at start"]
    assert start.residual == pytest.approx(quarters.residual, rel=1e-3), "of all four quarters"


def test_compiled_steps_say_the_same(tmp_path: Path) -> None:
    """Rows of the audit file, step by step; the impulses at both ends are far from rounding and cancel."""
    tables = []
    for name, own in {"c": coupled(NativeInstance), "called": called_back(coupled(NativeInstance))}.items():
        path = tmp_path / f"{name}.audit.parquet"
        with AuditWriter(path) as sink:
            result = run(own, Options(stop=20 * H, step=H, sink=sink))
        assert own.master.calls == (name == "called")
        assert summarise(path).parts == result.ledger.summary().parts and summarise(path).closed
        tables.append(read(path).to_pylist())
    found = [
        np.array(
            [[r["residual"] for r in t if (r["row"], r["junction"], r["part"]) == ("part", *key)] for key in PARTS]
        )
        for t in tables
    ]
    assert found[0].shape == found[1].shape == (6, 20)
    assert found[0] == pytest.approx(found[1], abs=1e-8)
    assert np.abs(found[0][2]).min() > 1e-7 and np.abs(found[0][[2, 3]].sum(axis=0)).max() < 1e-8
    for t, values in zip(tables, found, strict=True):
        for i, junction in enumerate(("bus1", "bus2")):
            rows = [r for r in t if r["row"] == "junction" and r["junction"] == junction]
            own = values[[0, 1, 2, 3]] if i == 0 else values[[4, 5]]
            left = own.sum(axis=0) - [r["residual"] for r in rows]
            assert np.abs(left).max() <= 1e-14 * max(r["exchanged"] for r in rows)


def test_parts_that_do_not_add_up_are_found(tmp_path: Path) -> None:
    own = coupled(PythonInstance)
    advance = own._works.grouped

    def wrong(works: Any) -> Any:
        found = advance(works)
        found[..., 2] += 1.0
        return found

    own._works.grouped = wrong  # type: ignore[method-assign]
    with AuditWriter(tmp_path / "wrong.parquet") as sink:
        result = run(own, Options(stop=2 * H, step=H, sink=sink))
    assert summarise(tmp_path / "wrong.parquet").violations == result.ledger.summary().violations
    (found,) = result.ledger.summary().violations
    assert (found.kind, found.name, found.steps) == ("parts", "bus1", 2) and found.size == pytest.approx(-1.0, abs=1e-6)
    assert "the parts of the junction's energy miss -1.000e+00 J of it" in str(found)
    (bus1,) = [j for j in result.ledger.summary().junctions if j.junction == "bus1"]
    assert bus1.verdict == "VIOLATED"


def test_only_scenes_with_several_parts_show_them() -> None:
    """One held value each: its energy is that of the junction."""
    one = run(coupled(PythonInstance, k=1, coupling=lambda _: Newton()), Options(stop=2 * H, step=H))
    assert not one.ledger.summary().parts
    assert "part" not in [s.title for s in sheets(one.ledger.summary())]
    two = run(coupled(PythonInstance, k=1), Options(stop=2 * H, step=H)).ledger.summary()
    assert [(p.junction, p.part) for p in two.parts] == [
        ("bus1", part) for part in ("held value", "impulse at start", "impulse at end")
    ]
    text = audit_table(two, by=["part"])
    assert [line.split("  ")[0] for line in text.splitlines()[2:]] == ["junction", "-" * len(text.splitlines()[3])] + [
        "bus1"
    ] * 3


# -- losses that are booked ----------------------------------------------------------------------------------------


def saturable(name: str, scale: float, start: float) -> PHDAE:
    """An inductor with H = (flux^2/2 + flux^4/4)/scale."""
    flux = state("flux", unit="Wb", start=start)
    h = energy((flux**2 / 2 + flux**4 / 4) / scale)
    ports = (Port("p", ELECTRICAL, "effort", {flux: 1}), Port("drive", ELECTRICAL, "effort", {flux: 1}))
    return PHDAE(name, states=(flux,), energies=(h,), dissipation=(damping(flux, 0.3),), ports=ports)


def saturated(engine: Any, k: int = 1) -> Monolithic:
    net = Network("saturated")
    net.add("a", saturable("a", 1.0, 1.0))
    net.add("b", saturable("b", 0.5, -0.6))
    net.junction("bus", ["a.p", "b.p"])
    model = build_model(net.compose(), Collocated(k))
    return Monolithic(model, engine(model))


OPTIONS = Options(stop=1.0, step=0.1, events=[Event(0.0, "a.drive.v", 5.0)], project=True)


@pytest.mark.parametrize("engine", ENGINES)
def test_the_loss_of_a_projection_is_booked(engine: Any, tmp_path: Path) -> None:
    """It is far from rounding, of order 2, and all that the junction lost; the file says so too."""
    lost = []
    for h in (0.1, 0.05):
        path = tmp_path / f"{h}.audit.parquet"
        with AuditWriter(path) as sink:
            summary = run(saturated(engine), replace(OPTIONS, step=h, sink=sink)).ledger.summary()
        (part,), (junction,) = summary.parts, summary.junctions
        assert (part.junction, part.part) == ("bus", "projection")
        assert summary.closed and summarise(path).closed and junction.verdict == "closed"
        assert part.residual < -1e-9 and part.residual == pytest.approx(junction.residual, abs=1e-14)
        lost.append(-part.residual)
    assert lost[0] > 3 * lost[1]


@pytest.mark.parametrize("leak", [1e-6, -1e-6], ids=["made", "lost"])
def test_what_a_junction_leaks_beside_is_found(leak: float, monkeypatch: pytest.MonkeyPatch) -> None:
    """A member gets more through its port than the other gives, and dissipates it: only the junction can tell."""
    own = saturated(PythonInstance)
    recorded = Steps.recorded

    def leaking(r: Any, signals: Any) -> Steps:
        s = recorded(r, signals)
        at = own.booking.junctions["bus"][0]
        s.pairs[0, at] += leak
        s.supplied[0, 0] += leak
        s.dissipated[0, 0] += leak
        return s

    monkeypatch.setattr(Steps, "recorded", leaking)
    summary = run(own, replace(OPTIONS, stop=0.1)).ledger.summary()
    assert {(v.kind, v.name) for v in summary.violations} == {("junction", "bus"), ("parts", "bus")}
    assert all(v.size == pytest.approx(leak, abs=1e-12) for v in summary.violations)


def test_a_projection_that_gains_is_no_loss() -> None:
    ports = (PortKey("a", "p", junction="bus"), PortKey("b", "p", junction="bus"))
    booking = Booking(("a", "b"), ports, parts=(PartKey("bus", "projection"),))
    for made, closed in ((-1e-3, True), (1e-3, False)):
        gained = np.array([[1.0, -1.0 + made]])
        ledger = Ledger()
        steps = Steps(gained + 5.0, gained, np.zeros((1, 2)), gained, gained, works=np.array([[made]]))
        ledger.add(booking, [0], [0.0], 0.1, steps)
        assert ledger.summary().closed is closed
