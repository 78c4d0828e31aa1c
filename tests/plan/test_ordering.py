"""Ordering of matrices, kernels of chains, and models whose structure is singular."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest
from scipy.sparse import csc_matrix
from scipy.sparse.linalg import splu

import phfmu as ph
from phfmu import PHDAE, Collocated, DeclarationError, block, build_model, energy
from phfmu.components.library import build
from phfmu.components.mechanical.translational import mass, spring
from phfmu.declare.variable import ValueKind
from phfmu.discretise.onestep import step_layout
from phfmu.plan import ordering
from phfmu.plan.address import Address, increment, row
from phfmu.plan.ordering import StructurallySingular, elimination_order
from phfmu.plan.planner import make_plan
from phfmu.plan.spec import Arguments, Spec
from phfmu.terms.extraction.extract import extract


def chain(n: int) -> PHDAE:
    net = ph.Network(f"chain{n}")
    for j in range(n):
        net.add(f"m{j}", mass(1.0 + j, k=0.5, d=0.1))
    for j in range(n - 1):
        net.add(f"s{j}", spring(2.0 + j, d=0.2))
    for j in range(n):
        springs = [f"s{j - 1}.b"] * (j > 0) + [f"s{j}.a"] * (j < n - 1)
        net.junction(f"j{j}", [f"m{j}.flange", *springs])
    return net.compose()


def test_kernels_of_a_chain_do_not_grow_with_its_length():
    small, large = (build_model(chain(n)) for n in (4, 24))
    names = [{g.kernel.name for g in m.step.groups} for m in (small, large)]
    assert names[0] == names[1] and len(small.kernels) == len(large.kernels)
    instances = [sum(g.n for g in m.step.groups) for m in (small, large)]
    assert instances[1] > instances[0] and instances[1] <= 7 * instances[0]


# -- structure -------------------------------------------------------------------------------------


def test_structurally_singular_models_are_refused_with_the_names():
    x, a, b = ph.state("x"), ph.algebraic("a"), ph.algebraic("b")
    half = (energy(x**2 / 2),)
    with pytest.raises(DeclarationError, match="structurally singular") as error:
        build_model(PHDAE("open", (x,), (a, b), energies=half, dissipation=(block([a], 1.0),)))
    assert str(error.value).startswith("open: ") and "equation of b cannot be solved for" in str(error.value)
    rows = (ph.skew(x, a, 1.0), ph.skew(x, b, 1.0))
    loop = PHDAE("loop", (x,), (a, b), energies=half, structure=rows)
    with pytest.raises(DeclarationError, match="singular: equation of [ab] cannot be solved for"):
        build_model(loop)


def fill(n, row, col, weak):
    """Nonzeros of L + U with the given order and preferred pivots, all pivots structurally present."""
    order, pivot = elimination_order(n, row, col, weak)
    assert sorted(order) == sorted(pivot) == list(range(n))
    values = np.random.default_rng(0).uniform(1.0, 2.0, len(row))
    a = csc_matrix((values, (row, col)), shape=(n, n))[pivot][:, order]
    lu = splu(a.tocsc(), permc_spec="NATURAL", diag_pivot_thresh=0.0)
    return lu.L.nnz + lu.U.nnz


def ladder(n: int, scrambled: bool):
    """Branches with a diagonal between n nodes without one: [D, G; -G^T, 0]."""
    ends = [(j, n + node) for j in range(n) for node in (j, j + 1) if node < n]
    row, col = np.array([(j, j) for j in range(n)] + ends + [(b, a) for a, b in ends], np.int32).T
    new = np.random.default_rng(n).permutation(2 * n).astype(np.int32) if scrambled else np.arange(2 * n)
    return 2 * n, new[row], new[col]


@pytest.mark.parametrize("scrambled", [False, True])
@pytest.mark.parametrize("diagonal", [False, True])
def test_ladder_of_zero_diagonals_fills_linearly(scrambled, diagonal):
    """Nodes without a diagonal, or with one that is present but zero: both are eliminated as pairs."""
    sizes = []  # nonzeros per unknown
    for n in (50, 200, 800):
        size, row, col = ladder(n, scrambled)
        weak = np.setdiff1d(np.arange(size), row[row == col]).astype(np.int32)
        if diagonal:
            row, col = np.append(row, weak).astype(np.int32), np.append(col, weak).astype(np.int32)
        sizes.append(fill(size, row, col, weak) / size)
    assert max(sizes) <= 8.0 and sizes[-1] <= 1.5 * sizes[0]


def sheet(n: int) -> tuple[int, Any, Any]:
    """Positions q and velocities v of n x n masses: q' = v, M v' = -K q, K with the five points of a grid."""
    at = {(i, j): i * n + j for i in range(n) for j in range(n)}
    near = [(a, at[i + x, j + y]) for (i, j), a in at.items() for x, y in STAR if (i + x, j + y) in at]
    m = n * n
    entries = [(a, a) for a in range(2 * m)] + [(a, m + a) for a in range(m)] + [(m + a, b) for a, b in near]
    row, col = np.array(entries, np.int32).T
    return 2 * m, row, col


STAR = ((0, 0), (1, 0), (-1, 0), (0, 1), (0, -1))


def test_positions_of_a_sheet_are_eliminated_first_and_leave_the_fill_of_its_stiffness() -> None:
    """The Schur complement of the positions is the 5-point matrix of the velocities: no more fill than that has by itself."""
    size, row, col = sheet(16)
    order, _ = elimination_order(size, row, col, np.zeros(0, np.int32))
    assert set(order[: size // 2].tolist()) == set(range(size // 2))
    m = size // 2
    stiff = (row >= m) & (col < m)
    alone = fill(m, row[stiff] - m, col[stiff], np.zeros(0, np.int32))
    positions = 2 * m + stiff.sum()  # of U: diagonal and D_v; of L: the stiffness and, counted by scipy, its diagonal
    assert fill(size, row, col, np.zeros(0, np.int32)) <= alone + positions + m


def test_an_order_that_saves_nothing_stays_that_of_minimum_degree() -> None:
    size, row, col = ladder(30, scrambled=False)
    weak = np.setdiff1d(np.arange(size), row[row == col]).astype(np.int32)
    whole = ordering._MatrixPattern(size, row, col)
    for one, other in zip(
        elimination_order(size, row, col, weak), ordering._minimum_degree(whole, row, col), strict=True
    ):
        np.testing.assert_array_equal(one, other)


def test_ordering_reports_rows_and_columns_without_partner():
    row, col = np.array([0, 1, 1, 2], np.int32), np.array([0, 0, 1, 0], np.int32)
    with pytest.raises(StructurallySingular) as error:
        elimination_order(3, row, col, np.zeros(0, np.int32))
    assert len(error.value.rows) == len(error.value.cols) == 1 and error.value.cols == [2]
    assert [len(v) for v in elimination_order(0, row[:0], col[:0], col[:0])] == [0, 0]


def test_equal_kernels_with_other_powers_of_h_are_groups_of_their_own() -> None:
    """A damper's -z on a state goes with h, an equal kernel on an algebraic row does not: names do not tell them apart."""
    scheme = Collocated(1)
    layout = step_layout(extract(build("mass")), scheme)
    flow = next(t for t in layout.terms.terms if scheme.specs(t) and t.index.get(ValueKind.STATE))

    def spec(power: int) -> Spec:
        args = Arguments(flow, 1)
        d = args.symbol(increment)
        return Spec(1, args.x, args.p, args.y, [(Address(row), power, 3 * d)])

    work = [(flow, [spec(0)]), (flow, [spec(1)]), (flow, [spec(0)])]
    plan = make_plan(layout, work, scheme.constants(layout), scheme.maps(layout))
    assert [(g.n, g.power.tolist()) for g in plan.groups] == [(2, [0]), (1, [1])]
    assert plan.groups[0].kernel is plan.groups[1].kernel
