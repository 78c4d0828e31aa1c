"""Three ideal poles before a star that is joined to nothing else: against matrix exponentials between zeros of the currents."""

from __future__ import annotations

from collections.abc import Callable
from functools import cache
from math import pi

import casadi as ca
import numpy as np
import pytest
from scipy.linalg import expm
from scipy.optimize import brentq

from phfmu import (
    ELECTRICAL,
    PHDAE,
    Collocated,
    Event,
    Guard,
    Monolithic,
    NativeInstance,
    Options,
    Port,
    StateEvent,
    Switch,
    SwitchedInstance,
    algebraic,
    block,
    build_model,
    energy,
    parameter,
    run,
    skew,
    state,
    time,
)
from tests.wide import slow

W, E = 2 * pi * 50, 325.0
ANGLES = np.array([0.3, 0.3 - 2 * pi / 3, 0.3 + 2 * pi / 3])
LS, RS = 2e-3, 0.1
LL, RL = np.array([18e-3, 20e-3, 25e-3]), np.array([4.0, 5.0, 6.5])
COMMAND, BETWEEN, STOP = 0.0125, 0.0165, 0.03


def isolated() -> PHDAE:
    """Source, R, L - pole - R, L in each phase, and a star point: potentials of the nodes are algebraic, the star's floats."""
    source, load = state("source", 3, unit="Wb", nominal=0.03), state("load", 3, unit="Wb", nominal=0.3)
    up, down = algebraic("up", 3, unit="V", nominal=300.0), algebraic("down", 3, unit="V", nominal=300.0)
    star = algebraic("star", unit="V", nominal=300.0)
    i = algebraic("i", 3, unit="A", nominal=30.0)
    s, command = parameter("s", 1.0, 3), parameter("command", 1.0)
    poles = tuple(
        Switch(
            f"pole{j + 1}", i.part(j, 1), {up.part(j, 1): -1.0, down.part(j, 1): 1.0}, s.part(j, 1), law="free",
            nominal=300.0, unit="V",
        )
        for j in range(3)
    )  # fmt: skip
    zeros = tuple(
        StateEvent(
            Guard(f"zero{j + 1}", i.part(j, 1).sx, 0, 30.0, "A"),
            when={"command": 0.0, f"s[{j + 1}]": 1.0},
            sets={f"s[{j + 1}]": 0.0},
        )
        for j in range(3)
    )
    voltages = ca.vertcat(*(E * ca.cos(W * time + float(a)) for a in ANGLES))
    eye = ca.SX.eye(3)
    return PHDAE(
        "isolated",
        states=(source, load),
        algebraics=(up, down, star, i),
        parameters=(s, command),
        energies=(energy(ca.sumsqr(source.sx) / (2 * LS)), energy(ca.sum1(load.sx**2 / (2 * ca.DM(LL))))),
        structure=(skew(source, up, -eye), skew(load, down, eye), skew(load, star, -ca.SX.ones(3, 1))),
        dissipation=(block((source,), RS * eye), block((load,), ca.SX(ca.diag(ca.DM(RL))))),
        ports=(Port("grid", ELECTRICAL, "effort", {source: eye}, size=3, source=voltages, nominal=E),),
        state_events=zeros,
        switches=poles,
    )


def flow(closed: tuple[int, ...]) -> np.ndarray:
    """A of y' = A y, y = [i (3), cos W t, sin W t]: the closed poles between the sources and one potential of the star."""
    L, R = LS + LL, RS + RL
    e = np.array([[E * np.cos(a), -E * np.sin(a)] for a in ANGLES])  # e = this [cos W t, sin W t]
    A = np.zeros((5, 5))
    A[3, 4], A[4, 3] = -W, W
    if len(closed) > 1:
        rows = np.zeros((3, 5))
        for j in closed:
            rows[j, j], rows[j, 3:] = -R[j], e[j]
        v = sum(rows[j] / L[j] for j in closed) / sum(1 / L[j] for j in closed)
        for j in closed:
            A[j] = (rows[j] - v) / L[j]
    return A


def first_zero(at: Callable[[float], np.ndarray], poles: tuple[int, ...], begin: float) -> tuple[float, int]:
    """When the first of the currents changes its sign, within half a period."""
    grid = np.linspace(begin, begin + 0.01, 201)
    i = np.array([at(t) for t in grid])[:, poles]
    n = int(np.flatnonzero((i[:-1] * i[1:] < 0).any(axis=1))[0])
    found = (
        (brentq(lambda t: at(t)[j], grid[n], grid[n + 1], xtol=1e-17, rtol=9e-16), j)  # noqa: B023
        for j in poles
        if at(grid[n])[j] * at(grid[n + 1])[j] < 0
    )
    return min(found)


@cache
def exact() -> tuple[float, int, float, np.ndarray]:
    """When the first pole opens, which, when the other two do at once; the currents at BETWEEN."""

    def three(t: float) -> np.ndarray:
        return expm(flow((0, 1, 2)) * t) @ [0.0, 0.0, 0.0, 1.0, 0.0]

    first, pole = first_zero(three, (0, 1, 2), COMMAND)
    left = tuple(j for j in range(3) if j != pole)
    middle = three(first)
    middle[pole] = 0.0

    def two(t: float) -> np.ndarray:
        return expm(flow(left) * (t - first)) @ middle

    second, _ = first_zero(two, left, first + 1e-4)
    assert first < BETWEEN < second
    return first, pole, second, two(BETWEEN)[:3]


@cache
def model(k: int):
    return build_model(isolated(), Collocated(k))


def opened(k: int, n: int):
    stepper = Monolithic(model(k), SwitchedInstance(model(k), NativeInstance))
    return run(stepper, Options(stop=STOP, step=STOP / n, events=(Event(COMMAND, "command", 0.0),)))


def currents(result) -> np.ndarray:
    row = int(np.flatnonzero(np.abs(result.time - BETWEEN) < 1e-9)[0])
    return np.array([result.column(f"source[{j}]")[row] for j in (1, 2, 3)]) / LS


def test_the_last_two_poles_open_at_once_and_the_star_floats():
    """Each mode has its structure: three currents of sum zero, two opposite ones, none and a potential that no row determines."""
    result = opened(3, 120)
    first, pole, second, i = exact()
    told = [n for n in result.notes if "zero" in n]
    assert len(told) == 2
    assert [float(n.split("t = ")[1].split(" s")[0]) for n in told] == pytest.approx([first, second], abs=1e-11)
    assert f"zero{pole + 1}, pole{pole + 1} off" in told[0]
    assert all(f"pole{j + 1} off" in told[1] for j in range(3) if j != pole)
    found = np.unique(result.time)
    assert np.abs(found - first).min() <= 1e-12 and np.abs(found - second).min() <= 1e-12
    assert currents(result) == pytest.approx(i, abs=1e-8)
    after = result.time > second
    for j in range(3):
        assert np.abs(result.column(f"source[{j + 1}]")[after]).max() / LS <= 1e-20  # A
        wanted = E * np.cos(W * result.time[after] + ANGLES[j])  # the voltage that comes back is the source's
        assert result.column(f"up_end[{j + 1}]")[after] == pytest.approx(wanted, abs=1e-9)
        assert np.abs(result.column(f"down_end[{j + 1}]")[after]).max() <= 1e-20
    assert np.abs(result.column("star_end")[after]).max() <= 1e-20  # least in norm
    summary = result.ledger.summary()
    assert summary.closed and summary.events["state"] == 2
    assert abs(sum(c.jumps or 0.0 for c in summary.components)) <= 1e-12  # J of 18


def test_the_potential_of_the_star_while_one_pole_is_open():
    """That of the two closed branches, e - R i - L i', and the open side of the third follows it."""
    result = opened(3, 120)
    _, pole, _, i = exact()
    a, b = (j for j in range(3) if j != pole)
    e = E * np.cos(W * BETWEEN + ANGLES)
    L, R = LS + LL, RS + RL
    rate = (e[a] - e[b] - (R[a] + R[b]) * i[a]) / (L[a] + L[b])
    star = e[a] - R[a] * i[a] - L[a] * rate
    row = int(np.flatnonzero(np.abs(result.time - BETWEEN) < 1e-9)[0])
    assert result.column("star_end")[row] == pytest.approx(star, rel=1e-9)
    assert result.column(f"down_end[{pole + 1}]")[row] == pytest.approx(star, rel=1e-9)


@pytest.mark.parametrize("k", [3, slow(1), slow(2)])
def test_order_2k_through_the_openings(k):
    n = {1: 480, 2: 120, 3: 60}[k]
    errors = [np.abs(currents(opened(k, m)) - exact()[3]).max() for m in (n, 2 * n)]
    assert np.log2(errors[0] / errors[1]) == pytest.approx(2 * k, abs=0.25)
