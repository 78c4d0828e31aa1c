"""Plans made by hand, from lists of what they hold."""

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


NOTHING = [[]]
