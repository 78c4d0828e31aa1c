"""Small discretised models made by hand: plans without declaration, scheme or planner."""

from __future__ import annotations

from collections import defaultdict
from collections.abc import Callable, Sequence
from dataclasses import dataclass, field
from typing import Any

import casadi as ca
import numpy as np

from phfmu.discretise.plan import Group, Kernel, Plan, Products

Ints = Sequence[Sequence[int]]


@dataclass(frozen=True)
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


def make_plan(
    *, nx: int, nw: int, nz: int = 0, nu: int = 0, k: int = 1, np_: int = 0, nq: int = 0, nobs: int = 0, na: int = 0,
    groups: Sequence[tuple[Kernel, int, Ints, Ints, Ints, Ints, Sequence[int]]] = (),
    const: Sequence[tuple[int, int, float, int]] = (), update: Sequence[tuple[int, int, float]] = (),
    mean: Sequence[tuple[int, int, float]] = (), increments: Sequence[int] = (), reg: Sequence[int] = (),
    weights: Sequence[float] = (1.0,), pair_src: Sequence[int] = (), order: Sequence[int] | None = None,
) -> Plan:  # fmt: skip
    """Plan with one component; Jacobian products by brute force. `reg`: rows with a regularised diagonal."""
    nv = nw + nu * k + 1
    made, slot = [], 1
    via_z, rows = defaultdict(list), []
    for kern, stage, xi, yi, pi, oi, power in groups:
        tables = [np.array(t, np.int32).reshape(len(oi), -1) for t in (xi, yi, pi, oi)]
        made.append(Group(kern, stage, slot, *tables, np.array(power, np.int8), np.zeros(len(oi), np.int32)))
        for i in range(len(oi)):
            for r, c in zip(kern.jac_row, kern.jac_col, strict=True):
                if stage == 0:
                    via_z[oi[i][r]].append((yi[i][c], slot))
                else:
                    rows.append((oi[i][r], yi[i][c], slot, 1.0, power[r]))
                slot += 1
    rows += [(r, s, 0, c, h) for r, s, c, h in const]
    block: dict[bool, dict] = {True: defaultdict(list), False: defaultdict(list)}
    for r, c, s, value, power in rows:
        for column, t in via_z[c - nv] if c >= nv else [(c, 0)]:
            row, external = r, (r - nw) % max(nq, 1)
            if row >= nw:
                if row >= nw + nq * k or external >= nu:
                    continue
                row, value = nw + external, value * weights[(r - nw) // nq]
            if column == nv - 1:
                continue
            col = column if column < nw else nw + (column - nw) % nu
            block[row < nw and col < nw][row, col].append((s, t, value, power))
    for i in reg:
        block[True][i, i] += []
    matrix, derivative = products(block[True]), products(block[False])
    triplet = [np.array([e[i] for e in const]) for i in range(4)]
    at = {(r, c): e for e, (r, c) in enumerate(zip(matrix.row.tolist(), matrix.col.tolist(), strict=True))}
    return Plan(
        nx=nx, nw=nw, nu=nu, k=k, nz=nz, np=np_, nq=nq, nobs=nobs, na=na, ncomp=1, groups=tuple(made), nslot=slot,
        const_row=triplet[0].astype(np.int32), const_src=triplet[1].astype(np.int32),
        const_val=triplet[2].astype(float), const_pow=triplet[3].astype(np.int8), matrix=matrix,
        colptr=np.searchsorted(matrix.col, np.arange(nw + 1)).astype(np.int32),
        order=np.array(range(nw) if order is None else order, np.int32), pivot_row=np.full(nw, -1, np.int32),
        regularised=np.array([at[i, i] for i in reg], np.int32), derivative=derivative,
        update_x=np.array([e[0] for e in update], np.int32), update_w=np.array([e[1] for e in update], np.int32),
        update_c=np.array([e[2] for e in update], float), mean_a=np.array([e[0] for e in mean], np.int32),
        mean_w=np.array([e[1] for e in mean], np.int32), mean_c=np.array([e[2] for e in mean], float),
        guess_ptr=np.arange(nw + 1, dtype=np.int32), guess_idx=np.arange(nw, dtype=np.int32),
        guess_val=np.ones(nw), guess_pow=np.array(increments or [0] * nw, np.int8),
        increments=np.array(increments or [0] * nw, np.int8), weights=np.array(weights, float),
        pair_src=np.array(pair_src, np.int32), pair_owner=np.zeros(nq, np.int32), nominal=np.ones(nw),
    )  # fmt: skip


MIDPOINT = kernel(
    "midpoint", (1, 1, 1), lambda x, y, p: [p * (x + y / 2)], lambda x, y, p: (p * (x + y / 2) * y, 0)
)
DAMPER = kernel("damper", (0, 1, 1), lambda x, y, p: [p * y], lambda x, y, p: (0, p * y * y))
NOTHING = [[]]


def oscillator(scale: float = 1.0) -> HandMade:
    """Mass p1, spring p0, damper p2, force u: w = (dq, dp); Y = [dq, dp, u, h | z_q = force, z_p = velocity]."""
    stiff, mobile = scale * 9.0, 1 / 0.7
    groups = [
        (MIDPOINT, 0, [[0], [1]], [[0], [1]], [[0], [1]], [[0], [1]], [0]),
        (DAMPER, 1, [[]], [[5]], [[2]], [[1]], [1]),
    ]
    const = [(0, 0, 1.0, 0), (0, 5, -1.0, 1), (1, 1, 1.0, 0), (1, 4, 1.0, 1), (1, 2, -1.0, 1), (2, 5, 1.0, 0)]
    step = make_plan(
        nx=2, nw=2, nz=2, nu=1, np_=3, nq=1, groups=groups, const=const, update=[(0, 0, 1.0), (1, 1, 1.0)],
        increments=[1, 1], pair_src=[2],
    )  # fmt: skip
    energy = kernel("H", (1, 0, 1), lambda x, y, p: [p * x], lambda x, y, p: (p * x * x / 2, 0))
    instant = make_plan(
        nx=2, nw=0, nz=2, nu=1, np_=3, nq=1, nobs=1, pair_src=[0],
        groups=[(energy, 0, [[0], [1]], [[], []], [[0], [1]], [[0], [1]], [0])],
        const=[(0, 3, 1.0, 0), (1, 2, 1.0, 0)],
    )  # fmt: skip
    return HandMade(
        "oscillator", step, instant, np.array([1.0, 0.2]), np.zeros(1), np.array([stiff, mobile, 0.3])
    )


def oscillator_step(x: np.ndarray, u: float, h: float, p: np.ndarray) -> tuple[np.ndarray, float]:
    """Midpoint rule in numpy: new state and mean velocity."""
    a = np.array([[0.0, p[1]], [-p[0], -p[2] * p[1]]])
    new = np.linalg.solve(np.eye(2) - h / 2 * a, (np.eye(2) + h / 2 * a) @ x + h * np.array([0.0, u]))
    return new, p[1] * (x[1] + new[1]) / 2


def pendulum() -> HandMade:
    """q' = p, p' = -sin q by the quotient gradient in closed form; no ports."""

    def gradient(x: Any, y: Any, p: Any) -> list[Any]:
        half = y / 2
        ratio = ca.if_else(
            ca.fabs(half) > 1e-4, ca.sin(half) / ca.if_else(half == 0, 1, half), 1 - half**2 / 6
        )
        return [ca.sin(x + half) * ratio]

    potential = kernel("cos", (1, 1, 0), gradient, lambda x, y, p: (ca.cos(x) - ca.cos(x + y), 0))
    kinetic = kernel("half", (1, 1, 0), lambda x, y, p: [x + y / 2], lambda x, y, p: ((x + y / 2) * y, 0))
    none = NOTHING
    step = make_plan(
        nx=2, nw=2, nz=2, increments=[1, 1], update=[(0, 0, 1.0), (1, 1, 1.0)],
        groups=[(potential, 0, [[0]], [[0]], none, [[0]], [0]), (kinetic, 0, [[1]], [[1]], none, [[1]], [0])],
        const=[(0, 0, 1.0, 0), (0, 4, -1.0, 1), (1, 1, 1.0, 0), (1, 3, 1.0, 1)],
    )  # fmt: skip
    energy = kernel(
        "E", (2, 0, 0), lambda x, y, p: [0 * x[0]], lambda x, y, p: (x[1] ** 2 / 2 - ca.cos(x[0]), 0)
    )
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
    lam = range(8, nw)
    nv = nw + 1
    velocity = [nv + i for i in range(4)]
    step = make_plan(
        nx=8, nw=nw, nz=4, na=copies, increments=[1] * 8 + [0] * copies, update=[(i, i, 1.0) for i in range(8)],
        mean=[(j, 8 + j, 1.0) for j in range(copies)], reg=list(lam),
        groups=[
            (free, 0, [[4 + i] for i in range(4)], [[4 + i] for i in range(4)], [[]] * 4, [[i] for i in range(4)], [0]),
            (constraint, 1, [[0, 1, 2, 3]] * copies, [[0, 1, 2, 3, *velocity, j] for j in lam], [[]] * copies,
             [[4, 5, 6, 7, j] for j in lam], [1, 1, 1, 1, 0]),
        ],
        const=[(i, i, 1.0, 0) for i in range(8)] + [(i, velocity[i], -1.0, 1) for i in range(4)] + [(5, nw, 9.81, 1)],
    )  # fmt: skip
    # row 5 has h * 9.81 from the entry h of v; the power of h is 0 there
    const_pow = step.const_pow.copy()
    const_pow[-1] = 0
    object.__setattr__(step, "const_pow", const_pow)
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
        nx=1, nw=2, nu=1, k=2, nq=1, increments=[1, 1], weights=[0.5, 0.5], update=[(0, 0, 0.5), (0, 1, 0.5)],
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
    node = kernel("node", (1, 3, 0), lambda x, y, p: [y[1] - x - y[0] / 2 + y[1] ** 3 - y[2]])
    step = make_plan(
        nx=1, nw=2, nu=1, nq=1, na=1, increments=[1, 0], update=[(0, 0, 1.0)], mean=[(0, 1, 1.0)], pair_src=[2],
        groups=[(node, 1, [[0]], [[0, 1, 2]], NOTHING, [[1]], [0]),
                (kernel("flow", (1, 2, 0), lambda x, y, p: [x + y[0] / 2 - y[1]]), 1, [[0]], [[0, 1]], NOTHING, [[0]],
                 [1])],
        const=[(0, 0, 1.0, 0), (2, 1, 1.0, 0)],
    )  # fmt: skip
    now = kernel("now", (1, 2, 0), lambda x, y, p: [y[0] - x + y[0] ** 3 - y[1]])
    instant = make_plan(
        nx=1, nw=1, nu=1, nq=1, na=1, mean=[(0, 0, 1.0)], pair_src=[1],
        groups=[(now, 1, [[0]], [[0, 1]], NOTHING, [[0]], [0])], const=[(1, 0, 1.0, 0)],
    )  # fmt: skip
    return HandMade("node", step, instant, np.array([0.3]), np.array([0.5]), a0=np.array([0.1]))
