"""Explicit couplings against matrices: errors, limits of stability and steps that follow the energy of junctions.

Members are stepped so finely inside each step that they are exact for the inputs they hold; beside them stands the same
arithmetic with matrix exponentials, which knows nothing of the package.
"""

from __future__ import annotations

from dataclasses import replace
from math import exp, pi
from typing import Any

import numpy as np
import pytest
from scipy.linalg import expm

from phfmu import (
    PHDAE,
    TRANSLATIONAL,
    Collocated,
    Coupled,
    EngineMember,
    GaussSeidel,
    Jacobi,
    NativeInstance,
    Network,
    Options,
    Port,
    algebraic,
    build_model,
    damping,
    energy,
    run,
    skew,
    state,
)
from phfmu.components.mechanical.translational import mass
from phfmu.network.couplings.newton import Newton
from tests.wide import slow

PARTS = 24
MC, MW, KC, DC, KW = 400.0, 40.0, 15000.0, 1000.0, 150000.0


def far_side(name: str, m: float, k: float, kc: float, dc: float = 0.0, d: float = 0.0, lead: float = 0.0) -> PHDAE:
    """A mass m on a spring k to ground (or road), joined by a spring kc and damper dc to a port that gives its end's velocity.

    H = (m v^2 + k t^2 + kc e^2)/2,  e' = v - u,  t' = -v,  m v' = -kc e - dc (v - u) + k t - d v;  t starts at `lead`.
    """
    e, v, t = state("e", unit="m"), state("v", unit="m/s"), state("t", unit="m", start=lead)
    H = (energy(0.5 * m * v.sx**2), energy(0.5 * k * t.sx**2), energy(0.5 * kc * e.sx**2))
    structure = [skew(e, v, 1.0), skew(v, t, 1.0)]
    on: dict[Any, Any] = {e: -1.0}
    more: dict[str, Any] = {}
    loss = [damping(v, d)] if d else []
    if dc:
        f, w = algebraic("f", unit="N"), algebraic("w", unit="m/s")
        structure += [skew(f, w, -1.0), skew(f, v, 1.0)]
        on[f] = -1.0
        loss.append(damping(w, dc))
        more = {"algebraics": (f, w)}
    return PHDAE(name, states=(e, v, t), energies=H, E={v: m}, structure=tuple(structure), dissipation=tuple(loss),
                 ports=(Port("top", TRANSLATIONAL, "flow", on),), **more)  # fmt: skip


class Cut:
    """Two members, `near.flange` (force given) joined to `far.top` (velocity given), and their matrices."""

    def __init__(self, near: PHDAE, far: PHDAE, order: int = 6, parts: int = PARTS):
        self.models = [
            build_model(replace(d, name=n), Collocated(order // 2)) for n, d in (("near", near), ("far", far))
        ]
        self.parts, self.declared = parts, (near, far)

    def coupled(self, coupling: Any, **starts: float) -> Coupled:
        net = Network("cut")
        near, far = self.declared
        net.add("near", near)
        net.add("far", far)
        net.connect("near.flange", "far.top", name="joint")
        members: list[Any] = [EngineMember(m.name, m, NativeInstance(m), self.parts) for m in self.models]
        for m in members:
            x = [starts.get(f"{m.name}.{v.name}", 0.0 if starts else v.start[0]) for v in m.model.declaration.states]
            m.instance.set_x(0.0, np.array(x))
            m.instance.initialise()
        return Coupled(net, members, coupling)

    def matrix(self, coupling: Any, h: float, states: tuple[str, ...]) -> np.ndarray:
        """The linear map of one step, from steps that start at unit vectors."""
        columns = []
        for s in states:
            stepper = self.coupled(coupling(), **{s: 1.0})
            stepper.prepare(0.0, h)
            steps = stepper.advance(0.0, h, 1)
            columns.append([steps.signals[-1][stepper.names.index(n)] for n in states])
        return np.array(columns).T

    def run(self, coupling: Any, h: float, stop: float = 1.0, **more: Any) -> Any:
        return run(self.coupled(coupling), Options(stop=stop, step=h, **more))


def radius(M: np.ndarray) -> float:
    return float(np.abs(np.linalg.eigvals(M)).max())


@pytest.fixture(scope="module")
def car() -> Cut:
    """A quarter of a car at a step of the road of 0.1 m."""
    return Cut(mass(MC), far_side("wheel", MW, KW, KC, DC, lead=0.1))


@pytest.fixture(scope="module")
def plain_car() -> Cut:
    """Of order 2, without internal steps."""
    return Cut(mass(MC), far_side("wheel", MW, KW, KC, DC, lead=0.1), order=2, parts=1)


CAR = ("near.v", "far.e", "far.v", "far.t")


class Exact:
    """The quarter car by matrix exponentials: x = (vc, e, vw, t)."""

    A = np.array([[0, 1, 0], [-KC / MW, -DC / MW, KW / MW], [0, -1, 0]])
    B = np.array([-1, DC / MW, 0])
    C = np.array([KC, DC, 0])

    def __init__(self) -> None:
        F = np.zeros((4, 4))
        F[0, 0], F[0, 1:], F[1:, 0], F[1:, 1:] = -DC / MC, self.C / MC, self.B, self.A
        self.w, V = (np.asarray(a, complex) for a in np.linalg.eig(F))
        self.first = V[0] * np.linalg.solve(V, np.array([0, 0, 0, 0.1]))

    def vc(self, t: np.ndarray) -> np.ndarray:
        return np.real(np.exp(np.multiply.outer(t, self.w)) @ self.first)

    def held(self, h: float) -> np.ndarray:
        """Of (x, u) with u held and the integral of C x: 5 x 5."""
        M = np.zeros((5, 5))
        M[:3, :3], M[:3, 3], M[4, :3], M[4, 3] = self.A, self.B, self.C, -DC
        return expm(M * h)

    def jacobi(self, h: float) -> np.ndarray:
        E, M = self.held(h), np.zeros((4, 4))
        M[0, 0], M[0, 1:], M[1:, 0], M[1:, 1:] = 1 - h * DC / MC, h / MC * self.C, E[:3, 3], E[:3, :3]
        return M

    def gauss_seidel(self, h: float) -> np.ndarray:
        E, near, far = self.held(h), np.eye(4), np.eye(4)
        near[0, 0], near[0, 1:] = 1 - h * DC / MC, h / MC * self.C
        far[1:, 0], far[1:, 1:] = E[:3, 3], E[:3, :3]
        return far @ near


EXACT = Exact()


def test_the_benchmark_is_the_one_meant() -> None:
    assert np.sort(np.real(EXACT.w))[::2] == pytest.approx([-12.707, -1.043], abs=1e-3)
    assert EXACT.vc(np.linspace(0, 1, 10001)).max() == pytest.approx(0.52555, abs=1e-4)


@pytest.mark.parametrize(
    ("coupling", "ours", "limit"),
    [(Jacobi, EXACT.jacobi, 0.0623), (GaussSeidel, EXACT.gauss_seidel, 0.287)],
)
def test_a_step_is_that_of_matrices_and_stable_up_to_the_limit(
    car: Cut, coupling: Any, ours: Any, limit: float
) -> None:
    """The damper's feedthrough is solved at each instant; lagged, jacobi's limit would be 0.0533 s (below)."""
    for h, stable in ((0.99 * limit, True), (1.01 * limit, False)):
        M = car.matrix(coupling, h, CAR)
        scale = np.diag([1.0, 30.0, 1.0, 30.0])
        assert np.abs(scale @ (M - ours(h)) @ np.linalg.inv(scale)).max() <= 1e-5
        assert (radius(M) <= 1 + 1e-9) is stable


class Lagged:
    """Jacobi's coupling as masters do it that read outputs after a step, with the inputs of that step."""

    order, repeats, closes = 1, False, False

    def started(self, joined: Any, xi: Any, r: Any) -> Any:
        return np.linalg.solve(joined.face.C.toarray(), -joined.face.P.T @ joined.end_outputs())


@pytest.mark.parametrize(
    ("h", "off"),
    [(0.02, 1.525e-1), (0.01, 6.883e-2), (0.005, 3.270e-2), pytest.param(0.002, 1.236e-2, marks=pytest.mark.slow)],
)
def test_errors_of_lagged_outputs_are_those_of_a_separate_program(car: Cut, h: float, off: float) -> None:
    result = car.run(Lagged(), h)
    assert np.abs(result.column("near.v") - EXACT.vc(result.time)).max() == pytest.approx(off, rel=2e-3)


@pytest.mark.parametrize(("h", "grows"), [(0.052, False), (0.0545, True)])
def test_lagged_outputs_are_stable_up_to_0_0533(car: Cut, h: float, grows: bool) -> None:
    v = np.abs(car.run(Lagged(), h, stop=500 * h).column("near.v"))
    assert bool(v[450:].max() > v[200:250].max()) is grows


def test_the_error_of_jacobi_is_of_order_one_and_its_energy_is_told(car: Cut) -> None:
    """What the junction makes falls in proportion to the step, as the error does."""
    errors, made = [], []
    for h in (0.01, 0.005):
        result = car.run(Jacobi(), h)
        errors.append(np.abs(result.column("near.v") - EXACT.vc(result.time)).max())
        s = result.ledger.summary()
        made.append(s.junctions[0].residual)
        assert s.network is not None and abs(s.network.unexplained) <= 1e-11
    assert errors == pytest.approx([7.087e-2, 3.420e-2], rel=1e-3)
    assert made[0] / made[1] == pytest.approx(2.0, abs=0.2)


@pytest.mark.parametrize(("h", "off"), [(0.02, 5.427e-2), (0.01, 1.396e-2), (0.005, 3.603e-3), (0.002, 5.827e-4)])
def test_with_repeated_steps_the_error_is_of_order_two(plain_car: Cut, h: float, off: float) -> None:
    """Discrete gradient members joined by Newton's method."""
    result = plain_car.run(Newton(), h)
    assert np.abs(result.column("near.v") - EXACT.vc(result.time)).max() == pytest.approx(off, rel=2e-3)


def ecco(tolerance: float) -> tuple[int, float]:
    """Steps and error of a separate loop with the same rule."""
    z, t, h, last, n, worst = np.array([0, 0, 0, 0.1]), 0.0, 1e-4, 1.0, 0, 0.0
    while t < 1 - 1e-9:
        left, M = 1.0 - t, EXACT.jacobi
        now = left if h >= left * (1 - 1e-9) else h if 2 * h <= left else left / 2
        u, F = z[0], EXACT.C @ z[1:] - DC * z[0]
        mean = (EXACT.held(now) @ np.array([*z[1:], u, 0.0]))[4] / now
        z = M(now) @ z
        a, b = now * F * (u + z[0]) / 2, -now * u * mean
        eps = abs(a + b) / (tolerance * (1.0 + (abs(a) + abs(b)) / 2))
        t, n = t + now, n + 1
        worst = max(worst, abs(z[0] - EXACT.vc(np.array([t]))[0]))
        if n >= 2:
            factor = 0.8 * eps**-0.35 * last**0.2
            cut = h if now < h and factor >= 1 else 0.0
            h, last = min(max(now * min(max(factor, 0.2), 1.5), cut, 1e-4), 1e-2), eps
    return n, worst


@pytest.mark.parametrize(
    "tolerance", [1e-1, pytest.param(1e-2, marks=pytest.mark.slow), pytest.param(1e-3, marks=pytest.mark.slow)]
)
def test_steps_that_follow_the_energy_of_the_junction(car: Cut, tolerance: float) -> None:
    """As many as in a separate loop, and better than as many equal ones."""
    result = car.run(Jacobi(), 1e-4, ecco=tolerance, min_step=1e-4, max_step=1e-2)
    error = np.abs(result.column("near.v") - EXACT.vc(result.time)).max()
    n, off = ecco(tolerance)
    assert abs(result.steps - n) <= 1 and error == pytest.approx(off, rel=1e-2)
    equal = car.run(Jacobi(), 1.0 / result.steps)
    assert error < 0.95 * np.abs(equal.column("near.v") - EXACT.vc(equal.time)).max()
    assert result.time[-1] == 1.0 and 1e-4 <= result.smallest < result.largest <= 1e-2


K1, K12 = 4 * pi**2, 16 * pi**2


@pytest.fixture(scope="module")
def halves() -> Cut:
    """The oscillator cut in two: [m1, k1] | [k12, m2, k2]."""
    return Cut(mass(1.0, k=K1), far_side("half", 1.0, K1, K12))


HALVES = ("near.q", "near.v", "far.e", "far.v", "far.t")


def test_cut_in_two_jacobi_gains_at_any_step(halves: Cut) -> None:
    """Energy grows by exp(k12 H / m) in a second for small H; numbers beyond that from a separate program."""
    for h, rate in ((1e-4, 1.016), (1e-3, 1.171), (1e-2, 4.77), (0.04, 213.0)):
        growth = radius(halves.matrix(Jacobi, h, HALVES)) ** (2 / h)
        assert growth == pytest.approx(rate, rel=5e-3)
        if h <= 1e-3:
            assert growth == pytest.approx(exp(K12 * h), rel=2e-3)


def test_cut_in_two_gauss_seidel_is_neutral_up_to_its_limit(halves: Cut) -> None:
    """0.1325 s by matrix exponentials."""
    for h, stable in ((0.05, True), (0.131, True), (0.134, False)):
        assert (radius(halves.matrix(GaussSeidel, h, HALVES)) <= 1 + 1e-6) is stable, h


@pytest.mark.parametrize(
    ("dc", "jacobi", "seidel"),
    [(0.0, 0.100, 1.53), slow((0.1, None, 1.51)), slow((1.0, None, 1.55)), (2.0, None, 1.18)],
)
def test_limits_of_two_equal_masses_with_damping(dc: float, jacobi: float | None, seidel: float) -> None:
    """m = k = kc = 1, damped to ground by 0.1; limits of a separate program, on a grid of 0.8 %."""
    cut = Cut(mass(1.0, k=1.0, d=0.1), far_side("other", 1.0, 1.0, 1.0, dc, d=0.1))
    for coupling, limit in ((Jacobi, jacobi), (GaussSeidel, seidel)):
        if limit is not None:
            for h, stable in ((0.985 * limit, True), (1.015 * limit, False)):
                assert (radius(cut.matrix(coupling, h, HALVES)) <= 1 + 1e-9) is stable, (coupling, h)
