"""Small discretised models made by hand: plans without declaration, scheme or planner."""

from __future__ import annotations

from collections import defaultdict
from collections.abc import Callable, Sequence
from dataclasses import dataclass, field
from typing import Any

import casadi as ca
import numpy as np

from phfmu.plan.plan import Group, Kernel, Plan, Products

Triplet = tuple[int, int, float, int]


@dataclass(frozen=True, eq=False)
class HandMade:
    """A model without declaration."""

    name: str
    step: Plan
    instant: Plan
    x0: Any
    u0: Any = field(default_factory=lambda: np.zeros(0))
    p0: Any = field(default_factory=lambda: np.zeros(0))
    a0: Any = field(default_factory=lambda: np.zeros(0))
    t0: float = 0.0
    row_names: tuple[str, ...] = ()
    instant_names: tuple[str, ...] = ()
    events: None = None


def kernel(name: str, sizes: tuple[int, int, int], out: Callable, ledger: Callable | None = None) -> Kernel:
    """Kernel from functions of (x, y, p); sizes of x, y, p."""
    args = [ca.SX.sym(s, n) for s, n in zip("xyp", sizes, strict=True)]
    value = ca.densify(ca.vertcat(*out(*args)))
    jac = ca.jacobian(value, args[1])
    row, col = jac.sparsity().get_triplet()
    nonzeros = jac.nz[:] if row else ca.SX(0, 1)
    last = ca.Function("l", args, [ca.densify(ca.SX(e)) for e in ledger(*args)]) if ledger else None
    f = ca.Function("f", args, [value, nonzeros])
    return Kernel(name, f, last, *sizes, value.numel(), np.array(row, np.int32), np.array(col, np.int32))


def products(entries: dict[tuple[int, int], list[tuple[int, int, float, int]]]) -> Products:
    """Sums of products of a sparse matrix: (row, col) -> list of (slot, slot, value, power of h)."""
    keys = sorted(entries, key=lambda e: (e[1], e[0]))
    flat = [f for key in keys for f in entries[key]]
    s, t, value, power = (np.array([f[i] for f in flat]) for i in range(4))
    return Products(
        row=np.array([k[0] for k in keys], np.int32),
        col=np.array([k[1] for k in keys], np.int32),
        ptr=np.cumsum([0] + [len(entries[k]) for k in keys]).astype(np.int32),
        s=s.astype(np.int32),
        t=t.astype(np.int32),
        value=value.astype(float),
        power=power.astype(np.int8),
    )


def jacobian(plan: dict[str, Any], groups: Sequence[Group], const: Sequence[Triplet]) -> tuple[Products, Products]:
    """Newton matrix and the other derivative blocks, by brute force over all Jacobian entries."""
    nw, nu, k, nq, weights = (plan[n] for n in ("nw", "nu", "k", "nq", "weights"))
    nv = nw + nu * k + 1
    via_z, rows = defaultdict(list), [(r, c, 0, value, power) for r, c, value, power in const]
    for g in groups:
        for i in range(g.n):
            for e, (r, c) in enumerate(zip(g.kernel.jac_row, g.kernel.jac_col, strict=True)):
                slot = g.slot + i * g.kernel.nj + e
                if g.stage == 0:
                    via_z[g.oi[i, r]].append((g.yi[i, c], slot))
                else:
                    rows.append((g.oi[i, r], g.yi[i, c], slot, 1.0, int(g.power[r])))
    block: dict[bool, dict] = {True: defaultdict(list), False: defaultdict(list)}
    for r, c, s, value, power in rows:
        if r >= nw + nq * k or (r >= nw and (r - nw) % nq >= nu):
            continue
        row = r if r < nw else nw + (r - nw) % nq
        weight = 1.0 if r < nw else weights[(r - nw) // nq]
        for column, t in via_z[c - nv] if c >= nv else [(c, 0)]:
            if column == nv - 1:
                continue
            col = column if column < nw else nw + (column - nw) % nu
            block[row < nw and col < nw][row, col].append((s, t, weight * value, power))
    for i in plan["reg"]:
        block[True][i, i] += []
    return products(block[True]), products(block[False])


SIZES = {"nx": 0, "nw": 0, "nz": 0, "nu": 0, "k": 1, "np": 0, "nq": 0, "nobs": 0, "na": 0}
LISTS = ("groups", "const", "update", "mean", "reg", "pair_src")


def make_plan(**given: Any) -> Plan:
    """Plan with one component from SIZES, LISTS, `increments`, `weights` and `nodes`; what is not given is absent.

    groups: (kernel, stage, xi, yi, pi, oi, power); const: (row, Y index, value, power of h);
    update: (x, w, factor); mean: (a, w, factor); reg: rows whose diagonal is regularised.
    """
    plan: dict[str, Any] = SIZES | {n: [] for n in LISTS} | {"weights": [1.0], "nodes": [0.5]}
    plan |= {"increments": [0] * given.get("nw", 0)} | given
    groups, slot = [], 1
    for kern, stage, *tables, power in plan["groups"]:
        n = len(tables[3])
        xi, yi, pi, oi = (np.array(t, np.int32).reshape(n, -1) for t in tables)
        groups.append(Group(kern, stage, slot, xi, yi, pi, oi, np.array(power, np.int8), np.zeros(n, np.int32)))
        slot += n * kern.nj
    matrix, derivative = jacobian(plan, groups, plan["const"])
    nw = plan["nw"]
    place = {rc: e for e, rc in enumerate(zip(matrix.row.tolist(), matrix.col.tolist(), strict=True))}

    def column(name: str, i: int, dtype: Any) -> Any:
        return np.array([e[i] for e in plan[name]], dtype)

    return Plan(
        **{n: plan[n] for n in SIZES},
        ncomp=1,
        groups=tuple(groups),
        nslot=slot,
        const_row=column("const", 0, np.int32),
        const_src=column("const", 1, np.int32),
        const_val=column("const", 2, float),
        const_pow=column("const", 3, np.int8),
        matrix=matrix,
        colptr=np.searchsorted(matrix.col, np.arange(nw + 1)).astype(np.int32),
        order=np.arange(nw, dtype=np.int32),
        pivot_row=np.full(nw, -1, np.int32),
        regularised=np.array([place[i, i] for i in plan["reg"]], np.int32),
        derivative=derivative,
        update_x=column("update", 0, np.int32),
        update_w=column("update", 1, np.int32),
        update_c=column("update", 2, float),
        mean_a=column("mean", 0, np.int32),
        mean_w=column("mean", 1, np.int32),
        mean_c=column("mean", 2, float),
        mean_pow=np.zeros(len(plan["mean"]), np.int8),
        work_pair=np.zeros(0, np.int32),
        work_row=np.zeros(0, np.int32),
        guess_ptr=np.arange(nw + 1, dtype=np.int32),
        guess_idx=np.arange(nw, dtype=np.int32),
        guess_val=np.ones(nw),
        guess_pow=np.array(plan["increments"], np.int8),
        increments=np.array(plan["increments"], np.int8),
        weights=np.array(plan["weights"], float),
        nodes=np.array(plan["nodes"], float),
        pair_src=np.array(plan["pair_src"], np.int32),
        pair_owner=np.zeros(plan["nq"], np.int32),
        nominal=np.ones(nw),
    )


MIDPOINT = kernel("midpoint", (1, 1, 1), lambda x, y, p: [p * (x + y / 2)], lambda x, y, p: (p * (x + y / 2) * y, 0))
DAMPER = kernel("damper", (0, 1, 1), lambda x, y, p: [p * y], lambda x, y, p: (0, p * y * y))
NOTHING = [[]]


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
