"""Parts of the C tables of a plan beside its own arrays: sizes, sums of products multiplied out, runs, groups in order."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

import numpy as np

from phfmu.events.event_plan import EventPlan
from phfmu.events.polynomial import guard_fit
from phfmu.plan.factor_entries import permuted_entries
from phfmu.plan.plan import Floats, Group, Ints, Kernel, Plan, Powers, Products
from phfmu.schur.lane_groups import KINDS, LaneGroup, in_order
from phfmu.schur.stepper import SchurStepper

#: factors that cost less than so many iterations are not kept over steps
LEAST_KEPT = 2


def factor_values(plan: Plan) -> dict[str, Any]:
    """Room for the entries of L + U of the Newton matrix; iterations that cost as much as a factor, 0 where that is not kept.

    In multiplications: an iteration takes two for each entry of L + U, with loads, and the values of the kernels, about a third
    of what they compute; a factor the derivatives, the products of the matrix, its scaling and the elimination. Constraints that
    may rest change the matrix; models with them keep no factor.
    """
    room, entries, elimination = _trial(plan.matrix.row, plan.colptr, plan.order, plan.pivot_row)
    kernels = sum(g.n * g.kernel.function.n_instructions() for g in plan.groups)
    factor = elimination + 2 * kernels // 3 + len(plan.matrix.s) + 2 * plan.matrix.nnz
    most = 0 if len(plan.hold) or not len(plan.update_w) else factor // max(2 * entries + kernels // 3, 1)
    return {"lucap": room, "keep_most": most if most >= LEAST_KEPT else 0}


def factor_room(row: Ints, colptr: Ints, order: Ints, pivot_row: Ints) -> int:
    """Room for the entries of L + U: all of them up to 64 unknowns, else 4 times a trial factorisation."""
    return _trial(row, colptr, order, pivot_row)[0]


def _trial(row: Ints, colptr: Ints, order: Ints, pivot_row: Ints) -> tuple[int, int, int]:
    """Room for L + U, the entries they have with the planned pivots, and the multiplications of a factorisation."""
    n = len(order)
    if n <= 64:
        return n * n, n * n, 0
    planned = np.array_equal(np.sort(pivot_row), np.arange(n))  # else those that are missing are found in the matrix
    trial = permuted_entries(row, np.repeat(np.arange(n), np.diff(colptr)), order, pivot_row if planned else None)
    return min(4 * trial.total + n, n * n), trial.total, trial.multiplications


@dataclass(frozen=True)
class _ConstantProducts:
    """Constant part of a sum of products: entry, value and power of h, one item per product."""

    entry: Ints
    value: Floats
    power: Powers


@dataclass(frozen=True)
class _VaryingProducts:
    """Entries with products that change from iteration to iteration, and those products."""

    entry: Ints
    ptr: Ints
    s: Ints
    t: Ints
    value: Floats
    power: Powers


def _constant_slots(plan: Plan) -> Floats:
    """Per slot its value if it is a number in the kernel, else nan."""
    slots = np.full(plan.nslot, np.nan)
    slots[0] = 1.0
    for g in plan.groups:
        jac = g.kernel.function.call(g.kernel.function.sx_in())[1]
        entries = [jac.nz[i] for i in range(g.kernel.nj)]
        row = [float(e) if e.is_constant() else np.nan for e in entries]
        slots[g.slot : g.slot + g.n * g.kernel.nj] = np.tile(row, g.n)
    return slots


def _split(products: Products, slots: Floats) -> tuple[_ConstantProducts, _VaryingProducts]:
    """Products of numbers are multiplied out here, the rest is left to every iteration."""
    entry = np.repeat(np.arange(products.nnz, dtype=np.int32), np.diff(products.ptr))
    known_s, known_t = ~np.isnan(slots[products.s]), ~np.isnan(slots[products.t])
    value = products.value * np.where(known_s, slots[products.s], 1.0) * np.where(known_t, slots[products.t], 1.0)
    s, t = np.where(known_s, np.int32(0), products.s), np.where(known_t, np.int32(0), products.t)
    fixed, rest = known_s & known_t, ~(known_s & known_t)
    varying, first = np.unique(entry[rest], return_index=True)
    ptr = np.append(first, rest.sum()).astype(np.int32)
    return (
        _ConstantProducts(entry[fixed], value[fixed], products.power[fixed]),
        _VaryingProducts(varying, ptr, s[rest], t[rest], value[rest], products.power[rest]),
    )


def update_runs(plan: Plan) -> dict[str, Any]:
    """The update by runs of neighbouring states whose unknowns are neighbours too, with the same weights: vectors."""
    terms: dict[int, list[tuple[int, float]]] = {}
    for state, w, c in zip(plan.update_x, plan.update_w, plan.update_c, strict=True):
        terms.setdefault(int(state), []).append((int(w), float(c)))
    runs: list[tuple[int, int]] = []
    for state in sorted(terms):
        if runs:
            first, n = runs[-1]
            if state == first + n and terms[state] == [(w + n, c) for w, c in terms[first]]:
                runs[-1] = (first, n + 1)
                continue
        runs.append((state, 1))
    flat = [term for first, _ in runs for term in terms[first]]
    ptr = np.cumsum([0] + [len(terms[first]) for first, _ in runs])
    return {
        "nupdate": len(runs),
        "update_x": [first for first, _ in runs],
        "update_n": [n for _, n in runs],
        "update_ptr": ptr,
        "update_w": [w for w, _ in flat],
        "update_c": [c for _, c in flat],
    }


def group_values(g: Group, nw: int, index: Callable[[Kernel], int]) -> dict[str, Any]:
    k = g.kernel
    after = np.asarray(g.oi) >= nw
    row = g.stage == 1
    sizes = {name: getattr(k, name) for name in ("nx", "ny", "np", "no", "nj")}
    return sizes | {
        "late": int(row and bool(np.all(after))),
        "reports": int(row and bool(np.any(after))),
        "kernel": index(k),
    }


def hold_values(plan: Plan) -> dict[str, Any]:
    """Rows of each constraint, their diagonal entries, and all entries of A in them."""
    row, col, hold = plan.matrix.row, plan.matrix.col, plan.hold
    rows = hold.of(np.ones(len(hold), bool))
    owner = np.full(plan.nw, -1)
    owner[rows] = np.repeat(np.arange(len(hold)), [len(r) for r in hold.rows])
    by_owner = np.argsort(owner[row], kind="stable")
    silent = by_owner[np.searchsorted(owner[row][by_owner], 0) :]
    own = np.full(plan.nw, -1)
    own[row[row == col]] = np.flatnonzero(row == col)
    return {
        "nhold": len(hold),
        "vanishing": int(hold.vanishing),
        "hold_ptr": np.cumsum([0] + [len(r) for r in hold.rows]),
        "hold_row": rows,
        "hold_own": own[rows],
        "silent_ptr": np.searchsorted(owner[row[silent]], np.arange(len(hold) + 1)),
        "silent": silent,
    }


def plan_values(plan: Plan, index: Callable[[Kernel], int]) -> dict[str, Any]:
    late = plan.const_row >= plan.nw
    by_row = np.argsort(late, kind="stable")
    const = {n: getattr(plan, n)[by_row] for n in ("const_row", "const_src", "const_val", "const_pow")}
    groups = sorted(plan.groups, key=lambda g: g.stage)
    fixed, varying = _split(plan.matrix, _constant_slots(plan))
    return (
        const
        | update_runs(plan)
        | {
            "ngroup": len(groups),
            "nconst": len(by_row),
            "nconst_early": int(np.sum(~late)),
            "nnz": plan.matrix.nnz,
            "nfixed": len(fixed.entry),
            "nvarying": len(varying.entry),
            "fixed": fixed,
            "varying": varying,
            "nderivative": plan.derivative.nnz,
            "nreg": len(plan.regularised),
            **hold_values(plan),
            "nmean": len(plan.mean_a),
            "nwork": len(plan.work_pair),
            **factor_values(plan),
            "groups": [(g, group_values(g, plan.nw, index)) for g in groups],
        }
    )


def lane_groups(schur: SchurStepper) -> list[tuple[LaneGroup, dict[str, Any]]]:
    """The groups in order of evaluation."""
    return [(g, {"kind": KINDS.index(g.kernel.kind)}) for g in in_order(schur.groups)]


def schur_sizes(schur: SchurStepper) -> dict[str, Any]:
    return {
        "npoint": len(schur.point_plus),
        "ngroup": len(schur.groups),
        "nload": len(schur.load_dof),
        "nlight": len(schur.light),
        "ntile": len(schur.tile.dof) - 1,
    }


def event_values(plan: EventPlan) -> dict[str, Any]:
    """Sizes, the jumps, and the matrices of the fit at its points."""
    found, polynomial, jump = guard_fit(plan.polynomial.nodes.k), plan.polynomial, plan.jump
    names = ("moved", "component", "most", "pushes")
    tables = {f"jump_{name}": () if jump is None else getattr(jump, name) for name in names}
    return {
        **tables,
        "jump_of": np.full(plan.n, -1) if jump is None else jump.of,
        "ngroup": len(plan.groups),
        "nrate": len(plan.rates),
        "npoint": len(found.tau),
        "nincrement": len(polynomial.w),
        "nstart": len(polynomial.start_w),
        "njump": 0 if jump is None else jump.n,
        "ncolumn": 0 if jump is None else jump.columns,
        "nmoved": len(tables["jump_moved"]),
        "ncomponent": len(tables["jump_component"]),
        "fit_tau": found.tau,
        "fit_weights": np.array([polynomial.nodes.integral(float(t)) for t in found.tau]),
        "fit_whole": found.whole,
        "fit_divided": found.divided,
    }
