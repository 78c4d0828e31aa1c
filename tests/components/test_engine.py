"""The piston engine and its machine beside their equations in the angle of the crank, the temperature of the gas and phase
coordinates, integrated by another method."""

from __future__ import annotations

from functools import cache
from pathlib import Path
from typing import Any

import casadi as ca
import numpy as np
import pytest

from phfmu import Monolithic, NativeInstance, Options, build_model, default_scheme, open_result, run
from phfmu.cli import main
from phfmu.components.mechanical.gas_cylinder import gas_cylinder
from phfmu.components.scenes.engine import CRANK, MASSES, RATIO, ROD, engine, generator_data
from tests.components.phase_coordinates import PhaseMachine, integrated
from tests.wide import wide

pytestmark = pytest.mark.usefixtures("compiler")

T_LOAD, STOP = 0.02, 0.05
#: 0.05 s hold one turn of the crank and a quarter: compression, fire, expansion, exhaust; rows that are compared
ROWS = 25
SIGNALS = (
    *("crank.main.angle", "crank.main.rate", "gas.T", "crankshaft.twist", "flywheel.w", "shaft.twist"),
    *("gen.p", "gen.theta", "gen.I[1]", "gen.I[2]", "gen.I[3]", "gen.I[4]"),
)
PORTS = ("gas.piston", "gas.hot", "gas.cold", "crank.main", "gen.shaft", "gen.field", "gen.terminal", "load.terminal")
SHORT = engine(t_load=T_LOAD, stop=STOP)
MEMBERS: Any = SHORT.system.members  # type: ignore[union-attr]


def parameters(member: str) -> dict[str, float]:
    declared = MEMBERS[member]
    return {p.name: float(np.ravel(p.start)[0]) for p in declared.parameters}


def port_start(member: str, port: str) -> float:
    declared = MEMBERS[member]
    return float(np.ravel(next(p.start for p in declared.ports if p.name == port))[0])


@cache
def crank_equation() -> ca.Function:
    """Of the angle: inertia, the force of gravity and inertia on it, place of the pin and its slope."""
    q, w = ca.SX.sym("q"), ca.SX.sym("w")
    end = CRANK * ca.vertcat(ca.cos(q), ca.sin(q))
    pin = ca.vertcat(end[0] + ca.sqrt(ROD**2 - end[1] ** 2), 0)
    turn = ca.asin(-end[1] / ROD)
    points = list(zip(MASSES, (end / 2, (end + pin) / 2, pin), strict=True))
    kinetic = (
        0.5 * (MASSES[0] * CRANK**2 / 12) * w**2 + 0.5 * (MASSES[1] * ROD**2 / 12) * (ca.jacobian(turn, q) * w) ** 2
    )
    kinetic += sum(0.5 * m * ca.sumsqr(ca.jacobian(p, q) * w) for m, p in points)
    potential = sum(9.81 * m * p[1] for m, p in points)
    inertia = ca.hessian(kinetic, w)[0]
    force = -ca.jacobian(potential, q) - 0.5 * ca.jacobian(inertia, q) * w**2
    return ca.Function("crank", [q, w], [inertia, force, pin[0], ca.jacobian(pin[0], q)])


class Peer:
    """Its states: angle q, speed w of the crank, T of the gas; twist of the crankshaft, speed of the flywheel, twist of the
    shaft; fluxes of the windings with the line's, p, theta; fluxes of the load's coil; works at PORTS."""

    def __init__(self) -> None:
        self.gas, self.bearing = parameters("gas"), parameters("crank")["main.damping"]
        self.stiff, self.soft, self.wheel = (parameters(name) for name in ("crankshaft", "shaft", "flywheel"))
        self.line, self.load, self.data = parameters("line"), parameters("load"), generator_data()
        self.machine = PhaseMachine(self.data, self.line["R"], self.line["L"])
        self.Vf = port_start("gen", "field")
        g = self.gas
        self.nR = g["p_0"] * g["bore_area"] * g["h_1"] / g["T_0"]
        self.C = self.nR / 0.4
        self.top = CRANK + ROD + 2 * CRANK / (RATIO - 1)

    def gas_at(self, T: float, h: float, dh: float) -> tuple[float, float, float, float]:
        """Force of the gas on the piston beyond that of the air behind it, T', heat of both walls: C T' = heat - p V'."""
        g = self.gas
        push = self.nR * T / h
        hot = g["fire"] * (g["h_0"] / h) ** 4 * (g["T_fire"] - T)
        cold = g["exhaust"] * (h / g["h_1"]) ** 8 * (g["T_exhaust"] - T)
        return push - g["p_0"] * g["bore_area"], (hot + cold - push * dh) / self.C, hot, cold

    def rates(self, t: float, x: np.ndarray, relieved: int) -> np.ndarray:
        q, w, T, first, speed, second = x[:6]
        n, pairs = self.machine.n, self.data.pole_pairs
        flux, coil = x[6 : 8 + n], x[8 + n : 11 + n]
        inertia, force, pin, slope = (float(a) for a in crank_equation()(q, w))
        push, dT, hot, cold = self.gas_at(T, self.top - pin, -slope * w)
        rotor = flux[-2] / self.machine.J / pairs
        on_crank = self.stiff["c"] * first + self.stiff["d"] * (speed - w)
        on_rotor = -self.soft["c"] * second - self.soft["d"] * (rotor - speed)
        dw = (force - self.bearing * w - push * slope + on_crank) / inertia
        dspeed = (-on_crank - on_rotor - self.wheel["d"] * speed) / self.wheel["J"]
        I = self.machine.rates(flux, np.zeros(3), self.Vf, 0.0)[1]
        v = self.load["R"] * (2.0 if relieved else 1.0) * (-I[:3] - coil / self.load["L"])
        rates, _ = self.machine.rates(flux, v, self.Vf, on_rotor / pairs)
        at_bus1 = v @ I[:3] - self.line["R"] * I[:3] @ I[:3]  # without what the line stores
        work = [push * slope * w, hot, cold, on_crank * w, on_rotor * rotor, self.Vf * I[3], at_bus1, -v @ I[:3]]
        return np.concatenate([[w, dw, dT, speed - w, dspeed, rotor - speed], rates, v, work])

    def solved(self, r: Any) -> tuple[np.ndarray, np.ndarray]:
        """SIGNALS at the rows of r and works at PORTS at its end, from the start of r."""
        names, coils = [f"gen.I[{j + 1}]" for j in range(self.machine.n)], [f"load.flux[{j}]" for j in (1, 2, 3)]
        I = rows_of(r, names)[0]
        flux = rows_of(r, [n.replace("I", "flux") for n in names])[0]
        flux[:3] += self.line["L"] * I[:3]
        begin = rows_of(r, SIGNALS[:6])[0], flux, rows_of(r, ("gen.p", "gen.theta", *coils))[0], np.zeros(len(PORTS))
        x = integrated(self.rates, np.concatenate(begin), r.time, (T_LOAD,), 1e-13)
        currents = np.array([self.machine.rates(y[6 : 8 + self.machine.n], np.zeros(3), 0.0, 0.0)[1] for y in x])
        work = x[-1, -len(PORTS) :].copy()
        stored = 0.5 * self.line["L"] * (currents[:, :3] ** 2).sum(axis=1)
        work[PORTS.index("gen.terminal")] -= stored[-1] - stored[0]
        return np.hstack([x[:, :6], x[:, 6 + self.machine.n : 8 + self.machine.n], currents[:, :4]]), work


def rows_of(r: Any, names: Any) -> np.ndarray:
    return np.array([r.column(n) for n in names]).T


def simulated(order: int, step: float) -> Any:
    model = build_model(SHORT.declaration(), default_scheme(SHORT.declaration(), order))
    return run(Monolithic(model, NativeInstance(model)), Options(stop=STOP, step=step, events=SHORT.events))


@cache
def peer() -> tuple[np.ndarray, np.ndarray]:
    return Peer().solved(simulated(6, STOP / ROWS))


def supplied(r: Any) -> dict[str, float]:
    return {f"{p.component}.{p.port}": p.supplied for p in r.ledger.summary().ports}


def errors(r: Any) -> tuple[np.ndarray, np.ndarray]:
    """Largest errors of SIGNALS beside their largest values (of angles: in rad), errors of works beside the largest of them."""
    at, work = peer()
    own = rows_of(r, SIGNALS)
    own = own[np.searchsorted(r.time, np.linspace(0.0, STOP, len(at)) - 1e-9)]
    off, size = own - at, np.abs(at).max(axis=0)
    off[:, 0], size[0] = np.angle(np.exp(1j * off[:, 0])), 1.0
    works = supplied(r)
    return np.abs(off).max(axis=0) / size, np.abs([works[p] for p in PORTS] - work) / np.abs(work).max()


@pytest.mark.parametrize(("order", "step", "most"), [(2, 2e-4, 1e-2), (6, 4e-4, 1e-6)])
def test_states_and_works_have_the_order_of_the_scheme(order: int, step: float, most: float) -> None:
    coarse, fine = (np.concatenate(errors(simulated(order, h))) for h in (step, step / 2))
    assert fine.max() < most
    told = fine > 1e-12  # the peer has no more digits
    assert told.sum() > 15
    assert np.all(np.abs(np.log2(coarse / fine)[told] - order) < 0.5), np.log2(coarse / fine)


def closed(r: Any) -> None:
    """The ledger over both domains to 1e-12 of what it sums, and of each member and junction."""
    s = r.ledger.summary()
    passed = sum(abs(p.supplied) for p in s.ports)
    assert s.closed and s.network.dissipated > 0
    assert abs(s.network.unexplained) < 1e-12 * passed
    assert abs(s.network.stored + s.network.dissipated - s.network.external) < 1e-12 * passed


def test_the_engine_obeys_the_second_law_and_comes_to_rest_in_its_speed() -> None:
    """Efficiency below those of Otto and Carnot; each turn of the last ones does the same work."""
    scene = engine(t_load=4.0, stop=4.0)
    model = build_model(scene.declaration(), default_scheme(scene.declaration(), 2))
    r = run(Monolithic(model, NativeInstance(model)), Options(stop=4.0, step=2e-4))
    closed(r)
    work, hot, cold = (supplied(r)[f"gas.{name}"] for name in ("piston", "hot", "cold"))
    assert work < 0 < hot and cold < 0
    otto, carnot = 1 - RATIO**-0.4, 1 - 300.0 / 2100.0
    assert 0.4 < -work / hot < otto < carnot
    # entropy of the world: the walls gave hot/T_fire and got -cold/T_exhaust, the gas has its S
    assert r.column("gas.S")[-1] - hot / 2100.0 - cold / 300.0 > 0
    speed = r.column("flywheel.w")
    last, before = speed[r.time > 3.8].mean(), speed[(r.time > 3.6) & (r.time <= 3.8)].mean()
    assert abs(last / before - 1.0) < 3e-3 and 0.9 < last / speed[0] < 1.1


APART = {
    "apart": ("--coupling", "newton"),
    "python": ("--engine", "python"),
    "fmi2": ("--coupling", "newton", "--engine", "fmu", "--fmi", "2.0"),
    "fmi3": ("--coupling", "newton", "--engine", "fmu", "--fmi", "3.0"),
}


@pytest.mark.parametrize(("way", "order"), wide([(w, k) for w in APART for k in (2, 6)], ("apart", 6), ("fmi3", 2)))
def test_members_apart_are_the_composed_engine(way: str, order: int, tmp_path: Path) -> None:
    """States and works to the tolerance of the coupling, in every engine and as units, through the event."""
    stop = ("--stop", "0.004") if way == "python" else ("--stop", "0.03")
    text = f"engine(t_load={T_LOAD})"
    found = []
    for name, more in (("one", ()), (way, APART[way])):
        file = str(tmp_path / f"{name}.csv")
        words = ("run", text, *stop, "--order", str(order), *more, "--quiet", "-o", file)
        assert main(list(words)) == 0
        found.append(open_result(file))
    declared = SHORT.declaration()
    for v in declared.states:
        for column, nominal in zip(v.names(), v.nominal, strict=True):
            a, b = (r.column(column) for r in found)
            assert np.abs(a - b).max() <= 1e-10 * max(np.abs(a).max(), nominal), column


@pytest.mark.parametrize(("version", "inside"), wide([(v, i) for v in (2, 3) for i in (False, True)], (3, False)))
def test_the_engine_as_one_unit_is_the_engine(version: int, inside: bool, tmp_path: Path) -> None:
    """Composed to one model, or with its members apart within."""
    more = ("--as-unit", "--events", "inside") if inside else ("--events", "inside")
    text = f"engine(t_load={T_LOAD})"
    assert main(["export", text, *more, "--order", "6", "--fmi", str(version), "-o", str(tmp_path)]) == 0
    unit = next(tmp_path.glob("*.fmu"))
    for target, file in ((str(unit), "unit.csv"), (text, "own.csv")):
        assert main(["run", target, "--stop", "0.03", *(("--order", "6") if target == text else ()), "--quiet",
                     "-o", str(tmp_path / file)]) == 0  # fmt: skip
    a, b = (open_result(str(tmp_path / file)) for file in ("own.csv", "unit.csv"))
    for v in SHORT.declaration().states:
        for column, nominal in zip(v.names(), v.nominal, strict=True):
            one, two = a.column(column), b.column(column)
            assert np.abs(one - two).max() <= 1e-10 * max(np.abs(one).max(), nominal), column


@pytest.mark.slow
@pytest.mark.parametrize("order", [2, 6])
def test_ten_times_as_long(order: int) -> None:
    scene = engine()
    model = build_model(scene.declaration(), default_scheme(scene.declaration(), order))
    r = run(Monolithic(model, NativeInstance(model)), Options(stop=10.0, step=1e-4, every=100, events=scene.events))
    closed(r)


def test_gas_alone_is_adiabatic_without_walls() -> None:
    """A piston driven through a stroke and back at a given speed: p V^kappa stays, whatever the order."""
    gas = gas_cylinder(fire=0.0, exhaust=0.0).with_starts({"piston.velocity": 1.0})
    for order in (2, 4, 6):
        model = build_model(gas, default_scheme(gas, order))
        r = run(Monolithic(model, NativeInstance(model)), Options(stop=0.13, step=1e-3))
        p, V = r.column("p"), r.column("V")
        assert np.ptp(p * V**1.4) < 1e-10 * (p * V**1.4)[0] and p[-1] > 5 * p[0]
        work = supplied(r)["gas_cylinder.piston"]
        gained = (p[-1] * V[-1] - p[0] * V[0]) / 0.4 - 1e5 * (V[0] - V[-1])
        assert work == pytest.approx(gained, rel=1e-10)


@pytest.mark.parametrize(
    ("given", "said"), [({"ratio": 1.0}, "ratio = 1"), ({"bore": -0.1}, "bore = -0.1"), ({"height": 0.0}, "height = 0")]
)
def test_cylinders_that_cannot_be_are_refused(given: dict[str, float], said: str) -> None:
    with pytest.raises(ValueError, match=said):
        gas_cylinder(**given)  # type: ignore[arg-type]
