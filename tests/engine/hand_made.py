"""Small discretised models made by hand: plans without declaration, scheme or planner."""

from __future__ import annotations

from typing import Any

import casadi as ca
import numpy as np

from tests.engine.plan_parts import NOTHING, HandMade, kernel, make_plan

MIDPOINT = kernel("midpoint", (1, 1, 1), lambda x, y, p: [p * (x + y / 2)], lambda x, y, p: (p * (x + y / 2) * y, 0))
DAMPER = kernel("damper", (0, 1, 1), lambda x, y, p: [p * y], lambda x, y, p: (0, p * y * y))


def oscillator(scale: float = 1.0) -> HandMade:
    """Mass 1/p1, spring p0, damper p2, force u: w = (dq, dp), Y = [dq, dp, u, h | force, velocity]."""
    stiff, mobile = scale * 9.0, 1 / 0.7
    groups = [
        (MIDPOINT, 0, [[0], [1]], [[0], [1]], [[0], [1]], [[0], [1]], [0]),
        (DAMPER, 1, [[]], [[5]], [[2]], [[1]], [1]),
    ]
    const = [(0, 0, 1.0, 0), (0, 5, -1.0, 1), (1, 1, 1.0, 0), (1, 4, 1.0, 1), (1, 2, -1.0, 1), (2, 5, 1.0, 0)]
    step = make_plan(
        nx=2, nw=2, nz=2, nu=1, np=3, nq=1, groups=groups, const=const, update=[(0, 0, 1.0), (1, 1, 1.0)],
        increments=[1, 1], pair_src=[2],
    )  # fmt: skip
    energy = kernel("H", (1, 0, 1), lambda x, y, p: [p * x], lambda x, y, p: (p * x * x / 2, 0))
    instant = make_plan(
        nx=2, nw=0, nz=2, nu=1, np=3, nq=1, nobs=1, pair_src=[0],
        groups=[(energy, 0, [[0], [1]], [[], []], [[0], [1]], [[0], [1]], [0])],
        const=[(0, 3, 1.0, 0), (1, 2, 1.0, 0)],
    )  # fmt: skip
    return HandMade("oscillator", step, instant, np.array([1.0, 0.2]), np.zeros(1), np.array([stiff, mobile, 0.3]))


def oscillator_step(x: np.ndarray, u: float, h: float, p: np.ndarray) -> tuple[np.ndarray, float]:
    """Midpoint rule in numpy: new state and mean velocity."""
    a = np.array([[0.0, p[1]], [-p[0], -p[2] * p[1]]])
    new = np.linalg.solve(np.eye(2) - h / 2 * a, (np.eye(2) + h / 2 * a) @ x + h * np.array([0.0, u]))
    return new, p[1] * (x[1] + new[1]) / 2


def pendulum() -> HandMade:
    """q' = p, p' = -sin q by the quotient gradient in closed form; no ports."""

    def gradient(x: Any, y: Any, p: Any) -> list[Any]:
        half = y / 2
        ratio = ca.if_else(ca.fabs(half) > 1e-4, ca.sin(half) / ca.if_else(half == 0, 1, half), 1 - half**2 / 6)
        return [ca.sin(x + half) * ratio]

    potential = kernel("cos", (1, 1, 0), gradient, lambda x, y, p: (ca.cos(x) - ca.cos(x + y), 0))
    kinetic = kernel("half", (1, 1, 0), lambda x, y, p: [x + y / 2], lambda x, y, p: ((x + y / 2) * y, 0))
    none = NOTHING
    step = make_plan(
        nx=2, nw=2, nz=2, increments=[1, 1], update=[(0, 0, 1.0), (1, 1, 1.0)],
        groups=[(potential, 0, [[0]], [[0]], none, [[0]], [0]), (kinetic, 0, [[1]], [[1]], none, [[1]], [0])],
        const=[(0, 0, 1.0, 0), (0, 4, -1.0, 1), (1, 1, 1.0, 0), (1, 3, 1.0, 1)],
    )  # fmt: skip
    energy = kernel("E", (2, 0, 0), lambda x, y, p: [0 * x[0]], lambda x, y, p: (x[1] ** 2 / 2 - ca.cos(x[0]), 0))
    instant = make_plan(nx=2, nw=0, nz=1, groups=[(energy, 0, [[0, 1]], none, none, [[0]], [0])])
    return HandMade("pendulum", step, instant, np.array([2.0, 0.1]))


def bar(copies: int) -> HandMade:
    """Two unit masses in the plane on a bar, gravity on the first; `copies` equal constraint rows."""
    nw = 8 + copies
    free = kernel("free", (1, 1, 0), lambda x, y, p: [x + y / 2], lambda x, y, p: ((x + y / 2) * y, 0))

    def tie(x: Any, y: Any, p: Any) -> list[Any]:
        d = (x[:2] + y[:2] / 2) - (x[2:] + y[2:4] / 2)
        z = y[4:6] - y[6:8]
        return [d[0] * y[8], d[1] * y[8], -d[0] * y[8], -d[1] * y[8], -ca.dot(d, z)]

    constraint = kernel("bar", (4, 9, 0), tie)
    lam, speed = range(8, nw), [[4 + i] for i in range(4)]
    nv = nw + 1
    velocity = [nv + i for i in range(4)]
    step = make_plan(
        nx=8, nw=nw, nz=4, na=copies, increments=[1] * 8 + [0] * copies,
        update=[(i, i, 1.0) for i in range(8)], mean=[(j, 8 + j, 1.0) for j in range(copies)], reg=list(lam),
        groups=[
            (free, 0, speed, speed, [[]] * 4, [[i] for i in range(4)], [0]),
            (constraint, 1, [[0, 1, 2, 3]] * copies, [[0, 1, 2, 3, *velocity, j] for j in lam], [[]] * copies,
             [[4, 5, 6, 7, j] for j in lam], [1, 1, 1, 1, 0]),
        ],
        const=[(i, i, 1.0, 0) for i in range(8)] + [(i, velocity[i], -1.0, 1) for i in range(4)]
        + [(5, nw, 9.81, 0)],
    )  # fmt: skip
    instant = make_plan(nx=8, nw=0, na=copies)
    x0 = np.array([0.0, 0.0, 1.0, 0.0, 0.0, 0.5, 0.0, -0.5])
    return HandMade("bar", step, instant, x0, a0=np.zeros(copies))


def blow_up() -> HandMade:
    """x' = x^2 by the midpoint rule: no real solution for h x > 1/2."""
    square = kernel("square", (1, 1, 0), lambda x, y, p: [-((x + y / 2) ** 2)])
    step = make_plan(
        nx=1, nw=1, increments=[1], update=[(0, 0, 1.0)], const=[(0, 0, 1.0, 0)],
        groups=[(square, 1, [[0]], [[0]], NOTHING, [[0]], [1])],
    )  # fmt: skip
    return HandMade("blow-up", step, make_plan(nx=1, nw=0), np.array([1.0]), row_names=("balance of x",))


A2 = np.array([[1 / 4, 1 / 4 - np.sqrt(3) / 6], [1 / 4 + np.sqrt(3) / 6, 1 / 4]])
C2 = np.array([0.5 - np.sqrt(3) / 6, 0.5 + np.sqrt(3) / 6])


def gauss_two() -> HandMade:
    """x' = -x + u with two Gauss nodes; unknowns h times the slopes, outputs the stage values."""
    const = [(i, i, 1.0, 0) for i in range(2)] + [(i, 2 + i, -1.0, 1) for i in range(2)]
    const += [(i, j, A2[i, j], 1) for i in range(2) for j in range(2)]
    const += [(2 + i, j, A2[i, j], 0) for i in range(2) for j in range(2)]
    old = kernel("old", (1, 0, 0), lambda x, y, p: [x, x, x, x])
    loss = kernel("loss", (1, 2, 0), lambda x, y, p: [], lambda x, y, p: (
        x * (y[0] + y[1]) / 2 + (y[0] + y[1]) ** 2 / 8,
        0.5 * sum((x + A2[i, 0] * y[0] + A2[i, 1] * y[1]) ** 2 for i in range(2)),
    ))  # fmt: skip
    step = make_plan(
        nx=1, nw=2, nu=1, k=2, nq=1, increments=[1, 1], weights=[0.5, 0.5],
        nodes=[0.5 - 3**-0.5 / 2, 0.5 + 3**-0.5 / 2], update=[(0, 0, 0.5), (0, 1, 0.5)],
        groups=[(old, 1, [[0]], NOTHING, NOTHING, [[0, 1, 2, 3]], [1, 1, 0, 0]),
                (loss, 1, [[0]], [[0, 1]], NOTHING, NOTHING, [])],
        const=const, pair_src=[2, 3],
    )  # fmt: skip
    now = kernel("now", (1, 0, 0), lambda x, y, p: [x])
    instant = make_plan(
        nx=1, nw=0, nu=1, nq=1, nobs=1, groups=[(now, 1, [[0]], NOTHING, NOTHING, [[0]], [0])], pair_src=[0],
        const=[(1, 0, 1.0, 0)],
    )  # fmt: skip
    return HandMade("gauss", step, instant, np.array([1.0]), np.zeros(1))


def implicit_node() -> HandMade:
    """x' = i, a node voltage a with (a - x) + a^3 = u, i = a - x; the node is an algebraic variable."""
    flow = kernel("flow", (1, 2, 0), lambda x, y, p: [x + y[0] / 2 - y[1]])
    node = kernel("node", (1, 3, 0), lambda x, y, p: [y[1] - x - y[0] / 2 + y[1] ** 3 - y[2]])
    step = make_plan(
        nx=1, nw=2, nu=1, nq=1, na=1, increments=[1, 0], update=[(0, 0, 1.0)], mean=[(0, 1, 1.0)],
        groups=[(node, 1, [[0]], [[0, 1, 2]], NOTHING, [[1]], [0]),
                (flow, 1, [[0]], [[0, 1]], NOTHING, [[0]], [1])],
        pair_src=[2],
        const=[(0, 0, 1.0, 0), (2, 1, 1.0, 0)],
    )  # fmt: skip
    now = kernel("now", (1, 2, 0), lambda x, y, p: [y[0] - x + y[0] ** 3 - y[1]])
    instant = make_plan(
        nx=1, nw=1, nu=1, nq=1, na=1, mean=[(0, 0, 1.0)], pair_src=[1],
        groups=[(now, 1, [[0]], [[0, 1]], NOTHING, [[0]], [0])], const=[(1, 0, 1.0, 0)],
    )  # fmt: skip
    return HandMade("node", step, instant, np.array([0.3]), np.array([0.5]), a0=np.array([0.1]))


def heat(n: int) -> HandMade:
    """x_i' = x_(i-1) - 2 x_i + x_(i+1) by the midpoint rule, ends at zero; linear with constant matrix."""
    spread = kernel("spread", (1, 0, 0), lambda x, y, p: [2 * x])
    give = kernel("give", (1, 0, 0), lambda x, y, p: [-x])
    inner = [(i, j) for i in range(n) for j in (i - 1, i + 1) if 0 <= j < n]
    none = [[]] * len(inner)
    step = make_plan(
        nx=n, nw=n, increments=[1] * n, update=[(i, i, 1.0) for i in range(n)],
        groups=[(spread, 1, [[i] for i in range(n)], none[:n], none[:n], [[i] for i in range(n)], [1]),
                (give, 1, [[j] for _, j in inner], none, none, [[i] for i, _ in inner], [1])],
        const=[(i, i, 1.0, 0) for i in range(n)] + [(i, i, 1.0, 1) for i in range(n)]
        + [(i, j, -0.5, 1) for i, j in inner],
    )  # fmt: skip
    x0 = np.sin(np.pi * np.arange(1, n + 1) / (n + 1)) + 0.1 * np.arange(n) / n
    return HandMade("heat", step, make_plan(nx=n), x0)
