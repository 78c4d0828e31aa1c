"""Saturated synchronous machines against their equations in currents, and their operating points against phasors."""

from __future__ import annotations

from functools import cache

import numpy as np
import pytest
from scipy.integrate import solve_ivp
from scipy.optimize import brentq, root

from phfmu import Collocated, FMUInstance, NativeInstance, PythonInstance, build_model, check, export
from phfmu.components.electrical import (
    MachineDataError,
    Saturation,
    from_per_unit,
    machine_at_bus,
    machine_names,
    machine_set,
    steady_state,
    synchronous_machine,
)
from tests.components.orders import orders
from tests.wide import longer, turning

POINTS = ((0.7, 0.7), (0.9, 1.0), (1.1, 1.6), (1.2, 2.3))
CURVES = {
    "quadratic": Saturation(0.1, 0.4),
    "from 1": Saturation(0.0, 0.3),
    "exponential": Saturation(0.1, 0.4, "exponential"),
    "table": Saturation(points=POINTS, rounding=0.4),
    "salient": Saturation(0.1, 0.4, axes="d"),
}
ANGLES = np.array([0.0, 2 * np.pi / 3, -2 * np.pi / 3])


def extra(curve: Saturation, u: float) -> float:
    """S(u) u, from the definitions and not from the package."""
    if curve.points:
        f, i = np.array([(0.0, 0.0), *curve.points]).T
        g, w = np.diff(i) / np.diff(f), curve.rounding * np.diff(f).min()
        bends = zip(g, g[1:], f[1:], strict=False)
        s = lambda x: (x + np.hypot(x, w)) / 2.0  # noqa: E731
        return g[0] * u + sum((b - a) * (s(u - k) - s(-u - k)) for a, b, k in bends) - u
    if curve.kind == "exponential":
        return curve.S10 * u ** (1.0 + np.log(curve.S12 / curve.S10) / np.log(1.2))
    q = np.sqrt(1.2 * curve.S12 / curve.S10) if curve.S10 else np.inf
    A = (q - 1.2) / (q - 1.0) if curve.S10 else 1.0
    B = 1.2 * curve.S12 / (1.2 - A) ** 2
    return B * max(u - A, 0.0) ** 2


class CurrentMachine:
    """The saturated machine with the currents (d, q, 0, rotor) as states: (Lambda + n dm/dF n^T) i' = v - R i + omega J psi.

    m_a (1/Lm_a + S(|m|)/Lmd) = F_a = n_a^T i with the m of the salient form in d alone.
    """

    def __init__(self, data, curve: Saturation):
        self.data, self.curve, k = data, curve, np.sqrt(1.5)
        self.n = 3 + len(data.axis)
        self.Lm = np.array([data.Ld, data.Lq]) - data.Ll
        self.rated = data.Vn_rms_ll / data.omega
        self.turns = np.zeros((2, self.n))
        self.turns[0, 0] = self.turns[1, 1] = 1.0
        for j, (a, M) in enumerate(zip(data.axis, data.M_stator_rotor, strict=True)):
            row = "dq".index(a)
            self.turns[row, 3 + j] = k * M / self.Lm[row]
        full = np.zeros((self.n, self.n))
        full[:3, :3] = np.diag([data.Ld, data.Lq, data.L0])
        full[3:, 3:] = data.L_rotor
        for j, (a, M) in enumerate(zip(data.axis, data.M_stator_rotor, strict=True)):
            row = "dq".index(a)
            full[row, 3 + j] = full[3 + j, row] = k * M
        self.leakage = full - self.turns.T @ np.diag(self.Lm) @ self.turns
        self.mask = np.array([1.0, 1.0 if curve.axes == "dq" else 0.0])
        self.R = np.array([data.Ra] * 3 + list(data.R_rotor))

    def _s(self, r: float) -> float:
        return extra(self.curve, r / self.rated) / (r / self.rated) / self.Lm[0] if r else 0.0

    def main(self, F: np.ndarray) -> np.ndarray:
        def flux(r: float) -> np.ndarray:
            return F / (1 / self.Lm + self.mask * self._s(r))

        most = np.linalg.norm(flux(0.0) * self.mask)
        r = (
            brentq(lambda r: r - np.linalg.norm(flux(r) * self.mask), 0.0, most, xtol=1e-13, rtol=1e-15)
            if most
            else 0.0
        )
        return flux(r)

    def fluxes(self, i: np.ndarray) -> np.ndarray:
        return self.leakage @ i + self.turns.T @ self.main(self.turns @ i)

    def rates(self, x: np.ndarray, v: np.ndarray, Vf: float, tau: float) -> np.ndarray:
        i, w, theta = x[: self.n], x[-2] / self.data.J, x[-1]
        m = self.main(self.turns @ i)
        psi = self.leakage @ i + self.turns.T @ m
        c, h = m * self.mask, 1e-5 * self.rated
        r = np.linalg.norm(c)
        slope = (self._s(r - 2 * h) - 8 * self._s(r - h) + 8 * self._s(r + h) - self._s(r + 2 * h)) / (12 * h)
        inverse = np.diag(1 / self.Lm + self.mask * self._s(r)) + slope / r * np.outer(c, c)
        L = self.leakage + self.turns.T @ np.linalg.solve(inverse, self.turns)
        a = theta - ANGLES
        T = np.sqrt(2 / 3) * np.array([np.cos(a), -np.sin(a), np.full(3, np.sqrt(0.5))])
        u = -self.R * i
        u[:3] += T @ v + w * np.array([psi[1], -psi[0], 0.0])
        u[3] += Vf
        torque = psi[0] * i[1] - psi[1] * i[0]
        return np.concatenate([np.linalg.solve(L, u), [tau + torque - self.data.d * w, w]])


def inputs(data, start):
    """Phase voltages that are 6 % above those of the start and dip, with constant field and torque."""
    V = data.Vn_rms_ll * np.sqrt(2 / 3)

    def at(t):
        return np.array([*(V * (1.06 - 0.04 * np.sin(30 * t)) * np.cos(data.omega * t - ANGLES)), start.Vf, start.tau])

    return at


END = 0.1


@cache
def reference(name: str, kind: str) -> np.ndarray:
    """Currents (d, q, 0, rotor), momentum and angle at END: DOP853 in currents."""
    data = machine_set(name, saturation=CURVES[kind])
    start, machine = steady_state(data, P=0.7 * data.Sn, Q=0.4 * data.Sn), CurrentMachine(data, CURVES[kind])
    x0 = np.array(
        [*root(lambda i: machine.fluxes(i) - start.dq, np.ones(machine.n), tol=1e-13).x, start.p, start.theta]
    )
    u = inputs(data, start)
    end = solve_ivp(lambda t, x: machine.rates(x, u(t)[:3], *u(t)[3:]), (0, END), x0, "DOP853", rtol=1e-12, atol=1e-9)
    return end.y[:, -1]


def ran(model, k: int, n: int, at, engine=NativeInstance, h: float | None = None):
    """An instance after n steps, and the worst ledger gap beside the energy."""
    plan = build_model(model, Collocated(k))
    instance, worst, h = engine(plan), 0.0, h or END / n
    for j in range(n):
        instance.set_node_inputs(np.array([at(h * (j + c)) for c in plan.nodes]))
        instance.do_step(h * j, h)
        row = instance.ledger()
        gap = abs(float(np.sum(row["stored"] + row["dissipated"] - row["supplied"])))
        worst = max(worst, gap / float(np.sum(instance.signals()["H"])))
    instance.set_node_inputs(np.array([at(h * n)] * k))
    return instance, worst


def error(name: str, kind: str, coordinates: str, k: int, n: int) -> float:
    data = machine_set(name, saturation=CURVES[kind])
    start = steady_state(data, P=0.7 * data.Sn, Q=0.4 * data.Sn)
    unit, worst = ran(synchronous_machine(data, coordinates=coordinates, start=start), k, n, inputs(data, start))
    assert worst < 1e-12
    exact, machine = reference(name, kind), CurrentMachine(data, CURVES[kind])
    psi = machine.fluxes(exact[: machine.n])
    x = unit.x[:-2].copy()
    if coordinates == "abc-flux":
        a = unit.x[-1] - ANGLES
        x[:3] = np.sqrt(2 / 3) * np.array([np.cos(a), -np.sin(a), np.full(3, np.sqrt(0.5))]) @ x[:3]
    size = np.array([machine.rated] * 3 + list(np.abs(psi[3:])))
    return float(max(np.max(np.abs(x - psi) / size), abs(unit.x[-1] - exact[-1])))


WAYS = [(m, c, f) for m in machine_names() for c in CURVES for f in ("dq-flux", "abc-flux")]
FEW = [
    *((("kundur555_1q", "quadratic", "dq-flux"), k) for k in (1, 2, 3)),
    (("krause_hydro325", "salient", "dq-flux"), 2),
]
COUNT = {"dq-flux": {1: 100, 2: 40, 3: 25}, "abc-flux": {1: 400, 2: 100, 3: 50}}


@pytest.mark.parametrize(("way", "k"), turning(WAYS, (1, 2, 3), *FEW), ids=str)
def test_a_saturated_machine_converges_to_its_equations_in_currents(way, k):
    name, kind, coordinates = way
    n = COUNT[coordinates][k]
    found = [error(name, kind, coordinates, k, m) for m in (n, 2 * n)]
    assert found[1] < {1: 1e-2, 2: 3e-4, 3: 1e-5}[k]
    assert orders(found)[0] == pytest.approx(2 * k, abs=0.4), found


def test_engines_agree_and_long_steps_keep_the_balance():
    data = machine_set("krause_hydro325", saturation=CURVES["quadratic"])
    start = steady_state(data)
    model = synchronous_machine(data, start=start)
    for k in (1, 2, 3):
        ends = [ran(model, k, 50, inputs(data, start), e, 1e-3) for e in (NativeInstance, PythonInstance)]
        assert ends[0][0].x == pytest.approx(ends[1][0].x, rel=1e-11, abs=1e-11)
        assert max(worst for _, worst in ends) < 1e-13


@pytest.mark.parametrize("kind", longer(CURVES, "quadratic"))
def test_units_of_both_versions_step_as_the_engine(kind, tmp_path):
    data = machine_set("krause_hydro325", saturation=CURVES[kind])
    plan = build_model(machine_at_bus(data), Collocated(2))
    native, at, h = NativeInstance(plan), inputs(data, steady_state(data)), 5e-4
    us = [at(h * n) for n in range(60)]
    for n, u in enumerate(us):
        native.set_input(u)
        native.do_step(h * n, h)
    for path in export(plan, tmp_path, step=h):
        with FMUInstance(path) as unit:
            for n, u in enumerate(us):
                unit.set_input(u)
                unit.do_step(h * n, h)
            names = [f"psi[{j + 1}]" for j in range(data.n)]
            assert np.asarray(unit.get(names)) == pytest.approx(native.x[: data.n], rel=1e-12, abs=1e-12)


# -- the curve and its energy ------------------------------------------------------------------------------------------------


@pytest.mark.parametrize("kind", CURVES)
def test_the_field_current_at_no_load_is_that_of_the_curve(kind):
    """i_f = (1 + S(u)) u on the air-gap line's scale, from the formula of the curve; no current in the stator."""
    curve = CURVES[kind]
    data = machine_set("kundur555_1q", saturation=curve)
    air_gap = np.sqrt(2 / 3) * data.Vn_rms_ll / data.omega / data.M_stator_rotor[0]
    for u in (0.2, 0.8, 1.0, 1.1, 1.2, 1.4):
        start = steady_state(data, P=0.0, Q=0.0, V=u * data.Vn_rms_ll)
        assert start.I[3] / air_gap == pytest.approx(u + extra(curve, u), rel=1e-12)
        assert np.abs(start.I[:3]).max() < 1e-9 * air_gap
    if not curve.points:
        assert steady_state(data, P=0.0, Q=0.0).I[3] / air_gap == pytest.approx(1 + curve.S10, rel=1e-12)
        loaded = steady_state(data, P=0.0, Q=0.0, V=1.2 * data.Vn_rms_ll)
        assert loaded.I[3] / air_gap == pytest.approx(1.2 * (1 + curve.S12), rel=1e-12)


def phasor_solution(data, curve, P, Q, V):
    """Field current and rotor angle from the steady equations of the machine in currents, solved for (theta, i_f)."""
    machine, w = CurrentMachine(data, curve), data.omega
    i = -np.conj(complex(P, Q) / (1.5 * V * np.sqrt(2 / 3)))

    def stator(y):
        k = np.sqrt(1.5) * np.exp(-1j * y[0])
        x = np.zeros(machine.n)
        x[0], x[1], x[3] = (k * i).real, (k * i).imag, y[1] * 1e3
        psi = machine.fluxes(x)
        v = k * V * np.sqrt(2 / 3)
        gap = v - data.Ra * k * i - w * complex(-psi[1], psi[0])
        return [gap.real, gap.imag]

    theta, field = root(stator, [-1.0, 2.0], tol=1e-13).x
    return theta, field * 1e3


@pytest.mark.parametrize("kind", CURVES)
@pytest.mark.parametrize(("p", "q"), [(0.8, 0.2), (0.3, 0.6), (0.9, -0.2)])
def test_the_loaded_machine_solves_its_phasor_equation(kind, p, q):
    data = machine_set("krause_hydro325", saturation=CURVES[kind])
    start = steady_state(data, P=p * data.Sn, Q=q * data.Sn, V=1.05 * data.Vn_rms_ll)
    theta, field = phasor_solution(data, CURVES[kind], p * data.Sn, q * data.Sn, 1.05 * data.Vn_rms_ll)
    assert start.theta == pytest.approx(theta, abs=1e-10) and start.I[3] == pytest.approx(field, rel=1e-10)


@pytest.mark.parametrize("kind", CURVES)
def test_a_saturated_start_is_steady(kind):
    """20 cycles at order 4 with the balanced voltage of the start: momentum and rotor fluxes stay; folded, too."""
    data = machine_set("krause_hydro325", saturation=CURVES[kind])
    for model in (synchronous_machine(data), machine_at_bus(data)):
        v = np.array(model.port("terminal").start)
        field, torque = (np.ravel(model.port(n).start)[0] for n in ("field", "shaft"))
        phasor = 2 / 3 * np.sum(v * np.exp(1j * ANGLES))

        def at(t, phasor=phasor, field=field, torque=torque):
            return np.array([*(phasor * np.exp(1j * (data.omega * t - ANGLES))).real, field, torque])

        unit, _ = ran(model, 2, 333, at, NativeInstance, 1e-3)
        x0 = build_model(model, Collocated(2)).x0
        assert unit.x[:-1] == pytest.approx(x0[:-1], rel=1e-6, abs=1e-6 * np.abs(x0[:6]).max())


@pytest.mark.parametrize("kind", CURVES)
def test_currents_are_the_slopes_of_a_convex_energy(kind):
    """dH/dpsi by differences, the currents of the independent machine at these fluxes, and the curvature along random lines."""
    data = machine_set("kundur555_1q", saturation=CURVES[kind])
    machine, rng = CurrentMachine(data, CURVES[kind]), np.random.default_rng(3)
    unit = PythonInstance(build_model(synchronous_machine(data), Collocated(1)))
    base = machine.fluxes(np.array([0.0, 0.0, 0.0, 2500.0, 0.0, 0.0]))

    def energy(psi):
        unit.set_x(0.0, np.array([*psi, 0.0, 0.0]))
        return float(np.sum(unit.signals()["H"]))

    for _ in range(20):
        i = rng.normal(size=6) * [5e3, 5e3, 1e2, 1.5e3, 3e3, 3e3]
        psi = machine.fluxes(i)
        d = rng.normal(size=6) * np.abs(base).max() * [1, 1, 1e-2, 10, 1, 1]
        h = 1e-4
        e = [energy(psi + k * h * d) for k in (-2, -1, 0, 1, 2)]
        slope = (e[0] - 8 * e[1] + 8 * e[3] - e[4]) / (12 * h)
        assert slope == pytest.approx(i @ d, rel=2e-6, abs=1e-8 * energy(d))
        steps = [energy(psi + k * d) for k in (-0.5, 0.0, 0.5)]
        assert steps[0] + steps[2] - 2 * steps[1] > 0


def test_parameters_move_the_curve_and_no_saturation_costs_nothing():
    linear = synchronous_machine("kundur555_1q")
    assert not {"Ll", "A_sat", "B_sat"} & {p.name for p in linear.parameters}
    saturated = synchronous_machine("kundur555_1q", saturation=Saturation(0.1, 0.4))
    assert len(saturated.energies) == len(linear.energies) + 1 and check(saturated) == []
    plan = build_model(saturated, Collocated(1))
    unit = NativeInstance(plan)
    names = [p.name for p in saturated.parameters]
    values = [float(np.ravel(p.start)[0]) for p in saturated.parameters]
    values[names.index("B_sat")] = 0.0
    unit.set_parameters(values)
    other = NativeInstance(build_model(linear, Collocated(1)))
    for u in (unit, other):
        u.set_x(0.0, plan.x0)
    assert unit.signals()["y_end"] == pytest.approx(other.signals()["y_end"], rel=1e-12)


# -- data --------------------------------------------------------------------------------------------------------------------


@pytest.mark.parametrize(
    ("curve", "words"),
    [
        (Saturation(0.3, 0.32), r"S\(1.0\) = 0.3, S\(1.2\) = 0.32.*A = -.*at least 1.2 S\(1.0\)"),
        (Saturation(-0.1, 0.3), r"S\(1.0\) = -0.1"),
        (Saturation(0.1, 0.0), r"S\(1.2\) = 0"),
        (Saturation(0.0, 0.3, "exponential"), "rises from a positive"),
        (Saturation(points=((0.8, 0.7), (1.2, 2.0))), r"falls from 1 to 0.875 before the point \(0.8, 0.7\)"),
        (Saturation(points=((0.8, 0.8), (1.0, 1.4), (1.2, 1.7))), r"falls from 3 to 1.5 before the point \(1.2, 1.7\)"),
        (Saturation(points=((0.8, 0.8), (0.7, 1.4))), "must both rise"),
        (Saturation(0.1, 0.4, points=POINTS), "one of them"),
        (Saturation(0.1, 0.4, axes="q"), "axes = 'q'"),  # pyright: ignore[reportArgumentType]
    ],
)
def test_curves_that_are_not_convex_are_refused_with_their_numbers(curve, words):
    with pytest.raises(MachineDataError, match=words):
        machine_set("kundur555_1q", saturation=curve)


def test_data_that_tell_no_main_flux_are_refused():
    curve = Saturation(0.1, 0.4)
    with pytest.raises(MachineDataError, match="saturation without Ll"):
        machine_set("kundur555_1q", Ll=None, saturation=curve)
    with pytest.raises(MachineDataError, match=r"Ll = 0.006 H is not between 0 and min"):
        machine_set("kundur555_1q", Ll=6e-3, saturation=curve)
    with pytest.raises(MachineDataError, match=r"Ll = 0.002 H leaves the rotor windings on d leakages .* -"):
        machine_set("kundur555_1q", Ll=2e-3, saturation=curve)
    with pytest.raises(MachineDataError, match="take coordinates 'dq-flux' or 'abc-flux'"):
        synchronous_machine("kundur555_1q", coordinates="current", saturation=curve)
    rated = {"Sn": 1e8, "Vn_rms_ll": 1e4, "fn": 50.0, "H": 3.0}
    with pytest.raises(MachineDataError, match="flux of a GENCLS is constant"):
        from_per_unit("m", "GENCLS", **rated, xd1=0.3, saturation=curve)


def test_a_mapping_and_a_set_say_the_same():
    one = machine_set("kundur555_1q", saturation={"S10": 0.1, "S12": 0.4})
    assert one.saturation == Saturation(0.1, 0.4)
    assert machine_set(one, d=5.0).saturation == one.saturation


# -- grids -------------------------------------------------------------------------------------------------------------------


def test_a_grid_uses_its_saturation_where_asked_and_tells_it_otherwise():
    """39 buses with S(1.0) = 0.1, S(1.2) = 0.4: the fields of all machines against their phasor equations."""
    from dataclasses import replace

    from phfmu.components.grids import grid_model
    from phfmu.components.scenes.electrical.grids import public_grid

    grid = public_grid("ieee39")
    iron = [replace(d, values={**d.values, "S1": 0.1, "S12": 0.4}) if d.model == "GENROU" else d for d in grid.dynamics]
    grid = replace(grid, dynamics=tuple(iron))
    plain = grid_model(grid, plants="currents", controls=False)
    assert "S1 = 0.1 (saturation at 1.0)" in str(plain.report)
    model = grid_model(grid, plants="currents", controls=False, saturation=True)
    assert "S(1.0), S(1.2)" in str(model.report) and "saturation at" not in str(model.report)
    point, seen = model.point, 0
    for unit in (g for g in grid.generators if (g.bus, g.id) in {(d.bus, d.id) for d in iron if d.model == "GENROU"}):
        name = model.report.of(f"generator '{unit.id}' at bus {unit.bus}").members[0]
        data = next(d for d in iron if d.model == "GENROU" and d.bus == unit.bus)
        v = {k: data.values[k] for k in ("xd", "xq", "xd1", "xq1", "xd2", "xl", "Td10", "Td20", "Tq10", "Tq20", "H")}
        kv = grid.bus[unit.bus].kv * 1e3
        machine = from_per_unit(
            "m", Sn=unit.base * 1e6, Vn_rms_ll=kv, fn=grid.frequency, ra=data.values.get("ra", unit.r), **v
        )
        s = -point.power(f"{name}.terminal")
        V = abs(model.voltages()[unit.bus]) * kv
        _, field = phasor_solution(machine, Saturation(0.1, 0.4), s.real, s.imag, V)
        assert point.inputs[f"{name}.field.v"] == pytest.approx(machine.R_rotor[0] * field, rel=1e-8)
        seen += 1
    assert seen == 10
