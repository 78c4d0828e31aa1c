"""The planner: kernels and instances of a scheme -> one Plan of index tables and sums of products."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field

import numpy as np
from numpy.typing import NDArray

from phfmu.declare.error import DeclarationError
from phfmu.declare.variable import ValueKind
from phfmu.plan.layout import Layout
from phfmu.plan.ordering import StructurallySingular, elimination_order
from phfmu.plan.plan import Group, Holds, Ints, Kernel, Plan, Powers, Products
from phfmu.plan.spec import Spec, build
from phfmu.terms.term import Term


@dataclass
class Tables:
    """Index tables of one kernel while instances are collected."""

    kernel: Kernel
    stage: int
    power: NDArray[np.int8]
    x: list[list[int]] = field(default_factory=list)
    y: list[list[int]] = field(default_factory=list)
    p: list[list[int]] = field(default_factory=list)
    o: list[list[int]] = field(default_factory=list)
    owner: list[int] = field(default_factory=list)


@dataclass(frozen=True)
class SchemeMaps:
    """Linear maps of a scheme from unknowns to reported and carried values.

    `update`: (state, w, weight) with x' = x + sum weight w;  `mean`: (reported algebraic, Y index, weight, power of h);
    `guess`: per unknown a list of (w of the last step, weight, power of h/h_last);  `weights`, `nodes`: quadrature on
    [0, 1];  `work`: (pair, row of R), energy that goes through a pair beside h sum b y u;  `jumps`: (state, w), by how much a
    state jumps at the start of the step;  `carries`: see `Plan`.
    """

    update: list[tuple[int, int, float]]
    mean: list[tuple[int, int, float, int]]
    guess: list[list[tuple[int, float, int]]]
    weights: NDArray[np.float64]
    nodes: NDArray[np.float64]
    work: list[tuple[int, int]] = field(default_factory=list)
    jumps: list[tuple[int, int]] = field(default_factory=list)
    carries: bool = False


def make_plan(
    layout: Layout,
    work: Sequence[tuple[Term, list[Spec]]],
    constants: Sequence[tuple[int, int, float, int]],
    maps: SchemeMaps,
    hold: Holds | None = None,
) -> Plan:
    """Assemble the plan.  `constants`: (row, Y index, value, power of h).  DeclarationError if structurally singular."""
    hold = Holds() if hold is None else hold
    terms = layout.terms
    groups = _groups(layout, work)
    nslot = 1 + sum(g.n * g.kernel.nj for g in groups)
    const = np.array([(r, s, q) for r, s, _, q in constants], np.int32).reshape(-1, 3)
    value = np.array([v for _, _, v, _ in constants], float)
    entries = _derivatives(layout, groups, const, value)
    matrix, derivative = _split(layout, entries, len(terms.pairs), maps.weights)
    matrix, weak = _with_diagonal(layout, matrix)
    colptr = np.searchsorted(matrix.col, np.arange(layout.nw + 1)).astype(np.int32)
    resting = hold.of(hold.rests)
    used = ~np.isin(matrix.row, resting) | (matrix.row == matrix.col)
    zero = np.setdiff1d(weak, resting).astype(np.int32)
    order, pivot = _ordered(layout, matrix, used, zero)
    regularised = np.flatnonzero((matrix.row == matrix.col) & np.isin(matrix.col, weak)).astype(np.int32)
    guess = [(len(g), [i for i, _, _ in g], [c for _, c, _ in g], [q for _, _, q in g]) for g in maps.guess]
    nq = len(terms.pairs)
    return Plan(
        nx=terms.n1, nw=layout.nw, nu=terms.nu, k=layout.k, nz=layout.nz, np=terms.np, nq=nq, nobs=layout.nobs,
        na=terms.na, ncondensed=layout.ncondensed, ncomp=len(terms.members), groups=tuple(groups), nslot=nslot,
        const_row=const[:, 0].astype(np.int32), const_src=const[:, 1].astype(np.int32), const_val=value,
        const_pow=const[:, 2].astype(np.int8), matrix=matrix, colptr=colptr, order=order, pivot_row=pivot,
        regularised=regularised, derivative=derivative, hold=hold,
        update_x=np.array([u[0] for u in maps.update], np.int32),
        update_w=np.array([u[1] for u in maps.update], np.int32),
        update_c=np.array([u[2] for u in maps.update], float),
        mean_a=np.array([u[0] for u in maps.mean], np.int32),
        mean_w=np.array([u[1] for u in maps.mean], np.int32),
        mean_c=np.array([u[2] for u in maps.mean], float),
        mean_pow=np.array([u[3] for u in maps.mean], np.int8),
        work_pair=np.array([u[0] for u in maps.work], np.int32),
        work_row=np.array([u[1] for u in maps.work], np.int32),
        guess_ptr=np.cumsum([0] + [g[0] for g in guess]).astype(np.int32),
        guess_idx=np.array([i for g in guess for i in g[1]], np.int32),
        guess_val=np.array([i for g in guess for i in g[2]], float),
        guess_pow=np.array([i for g in guess for i in g[3]], np.int8),
        increments=np.array([u.role.vanishes for u in layout.unknowns], np.int8),
        weights=np.asarray(maps.weights, float), nodes=np.asarray(maps.nodes, float),
        pair_src=np.array([layout.input_index(j, i) for i in range(layout.k) for j in range(nq)], np.int32),
        pair_owner=np.array([p.owner for p in terms.pairs], np.int32),
        nominal=layout.nominals(),
        carries=int(maps.carries),
    )  # fmt: skip


def _ordered(layout: Layout, matrix: Products, used: NDArray[np.bool_], zero: NDArray[np.int32]) -> tuple[Ints, Ints]:
    """Pivot columns and rows of A without the rows at rest; DeclarationError if it is structurally singular."""
    try:
        return elimination_order(layout.nw, matrix.row[used], matrix.col[used], zero)
    except StructurallySingular as e:
        names, unknowns, model = layout.names(), layout.unknowns, layout.terms.model
        raise DeclarationError(
            model.name,
            f"structurally singular: {', '.join(names[r] for r in e.rows)} cannot be solved for "
            f"{', '.join(unknowns[c].variable for c in e.cols)}",
            "check for an ideal loop of sources or a port without "
            "inertia, compliance or resistance" + (", or for redundant constraints" if model.constraints else ""),
            "singular",
        ) from None


def _groups(layout: Layout, work: Sequence[tuple[Term, list[Spec]]]) -> list[Group]:
    tables: dict[tuple[str, int, tuple[int, ...]], Tables] = {}
    built: dict[int, Kernel] = {}  # terms of one kind share their specs
    for term, specs in work:
        for spec in specs:
            kernel = built.get(id(spec)) or built.setdefault(id(spec), build(spec))
            power = tuple(q for _, q, _ in spec.out)
            t = tables.get((kernel.name, spec.stage, power))
            if t is None:
                t = Tables(kernel, spec.stage, np.array(power, np.int8))
                tables[kernel.name, spec.stage, power] = t
            t.x.append(spec.old(layout, term)[: kernel.nx])
            t.y.append([a(layout, term) for a, _ in spec.y])
            t.p.append(list(term.indices(ValueKind.PARAMETER)) if kernel.np else [])
            t.o.append([a(layout, term) for a, _, _ in spec.out])
            t.owner.append(term.owner)
    groups, slot = [], 1
    for t in sorted(tables.values(), key=lambda t: (t.stage, t.kernel.name)):
        n = len(t.owner)
        arrays = [np.array(v, np.int32).reshape(n, -1) for v in (t.x, t.y, t.p, t.o)]
        groups.append(Group(t.kernel, t.stage, slot, *arrays, power=t.power, owner=np.array(t.owner, np.int32)))
        slot += n * t.kernel.nj
    return groups


@dataclass
class _Entries:
    """dR/dv entries: row, col, slots s and t, value, power of h (parallel arrays)."""

    row: Ints
    col: Ints
    s: Ints
    t: Ints
    value: NDArray[np.float64]
    power: Powers

    @staticmethod
    def joined(parts: Sequence[_Entries]) -> _Entries:
        return _Entries(
            *(np.concatenate([getattr(p, f) for p in parts]) for f in ("row", "col", "s", "t", "value", "power"))
        )


def derivative_slots(groups: Sequence[Group], stage: int) -> tuple[Ints, Ints, Ints, Powers]:
    """Target, Y column, slot in V and power of h of every Jacobian entry of one stage."""
    out: list[tuple[NDArray, ...]] = [(np.zeros(0, np.int32),) * 3 + (np.zeros(0, np.int8),)]
    for g in groups:
        if g.stage == stage and g.kernel.nj:
            target = g.oi[:, g.kernel.jac_row].ravel()
            column = g.yi[:, g.kernel.jac_col].ravel()
            slot = np.arange(g.slot, g.slot + g.n * g.kernel.nj, dtype=np.int32)
            power = np.tile(g.power[g.kernel.jac_row], g.n)
            out.append((target, column, slot, power))
    target, column, slot, power = (np.concatenate(parts) for parts in zip(*out, strict=True))
    return target, column, slot, power


def _derivatives(layout: Layout, groups: Sequence[Group], const: NDArray, value: NDArray) -> _Entries:
    nv = layout.nv
    z_row, z_col, z_slot, _ = derivative_slots(groups, 0)
    by_z = np.argsort(z_row, kind="stable")
    z_ptr = np.searchsorted(z_row[by_z], np.arange(layout.nz + 1))
    row, col, slot, power = derivative_slots(groups, 1)
    c_row, c_src, c_pow = const[:, 0], const[:, 1], const[:, 2].astype(np.int8)
    rows = np.concatenate([c_row, row])
    cols = np.concatenate([c_src, col])
    slots = np.concatenate([np.zeros_like(c_row), slot])
    powers = np.concatenate([c_pow, power])
    values = np.concatenate([value, np.ones(len(row))])
    direct = cols < nv
    d = _Entries(
        rows[direct], cols[direct], slots[direct], np.zeros(direct.sum(), np.int32), values[direct], powers[direct]
    )
    via = np.flatnonzero(~direct)
    z = cols[via] - nv
    count = z_ptr[z + 1] - z_ptr[z]
    outer = np.repeat(via, count)
    offset = np.arange(count.sum()) - np.repeat(np.cumsum(count) - count, count)
    inner = by_z[np.repeat(z_ptr[z], count) + offset]
    chained = _Entries(rows[outer], z_col[inner], slots[outer], z_slot[inner], values[outer], powers[outer])
    return _Entries.joined([d, chained])


def _split(layout: Layout, e: _Entries, nq: int, weights: NDArray) -> tuple[Products, Products]:
    """The Newton matrix, and the derivative blocks with held inputs and mean outputs."""
    nw, nu, k = layout.nw, layout.terms.nu, layout.k
    keep = (e.row < nw + nq * k) & (e.col < nw + nu * k)
    pair = (e.row - nw) % max(nq, 1)
    node = (e.row - nw) // max(nq, 1)
    keep &= (e.row < nw) | (pair < nu)
    row = np.where(e.row < nw, e.row, nw + pair)
    value = np.where(e.row < nw, e.value, e.value * weights[np.clip(node, 0, k - 1)])
    col = np.where(e.col < nw, e.col, nw + (e.col - nw) % max(nu, 1))
    inside = keep & (row < nw) & (col < nw)
    return (
        _products(e, row, col, value, inside),
        _products(e, row, col, value, keep & ~inside),
    )


def _products(e: _Entries, row: NDArray, col: NDArray, value: NDArray, mask: NDArray) -> Products:
    chosen = np.flatnonzero(mask)
    chosen = chosen[np.lexsort((row[chosen], col[chosen]))]
    r, c = row[chosen], col[chosen]
    new = np.ones(len(chosen), bool)
    new[1:] = (r[1:] != r[:-1]) | (c[1:] != c[:-1])
    starts = np.flatnonzero(new)
    return Products(
        r[starts].astype(np.int32), c[starts].astype(np.int32), np.append(starts, len(chosen)).astype(np.int32),
        e.s[chosen].astype(np.int32), e.t[chosen].astype(np.int32), value[chosen].astype(float),
        e.power[chosen].astype(np.int8),
    )  # fmt: skip


def _with_diagonal(layout: Layout, m: Products) -> tuple[Products, NDArray[np.int32]]:
    """Add empty diagonal entries where an unknown has none; returns also those columns."""
    present = set(m.col[m.row == m.col].tolist())
    weak = np.array([i for i in range(layout.nw) if i not in present], np.int32)
    row, col = np.concatenate([m.row, weak]), np.concatenate([m.col, weak])
    length = np.concatenate([np.diff(m.ptr), np.zeros(len(weak), np.int32)])
    start = np.concatenate([m.ptr[:-1], np.zeros(len(weak), np.int32)])
    order = np.lexsort((row, col))
    ptr = np.concatenate([[0], np.cumsum(length[order])]).astype(np.int32)
    pick = np.repeat(start[order] - ptr[:-1], length[order]) + np.arange(ptr[-1])
    return Products(row[order], col[order], ptr, m.s[pick], m.t[pick], m.value[pick], m.power[pick]), weak
