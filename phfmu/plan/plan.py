"""The plan: one discretised system as index tables, sums of products and kernels.

A plan knows neither physics nor schemes.  With the value spaces

    x = [old state | t | old algebraic variables],   v = [w | u | h],   Y = [v | Z],

it describes   Z = sum of stage-0 kernels(x, v, p),
               R = C(h) Y + sum of h^pow * stage-1 kernels(x, Y, p),
               A = dR/dw  as, per nonzero, a sum of  c h^j V[s] V[t]  over kernel Jacobian entries V.

The Python evaluator and the C runtime run from the same plan.
"""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import Any

import numpy as np
from numpy.typing import NDArray

Ints = NDArray[np.int32]
Floats = NDArray[np.float64]
Powers = NDArray[np.int8]


@dataclass(frozen=True)
class Kernel:
    """A local function with its sparse Jacobian, shared by all its instances.

    `function`: (x, y, p) -> (out, jac);  `ledger`: (x, y, p) -> (stored, lost) or
    (stored, lost, numerical), or None.
    `jac_row`, `jac_col`: position of each Jacobian nonzero, columns into the y locals.
    `loses_energy`: the ledger has a third output, the numerical loss.
    """

    name: str
    function: Any
    ledger: Any
    nx: int
    ny: int
    np: int
    no: int
    jac_row: Ints
    jac_col: Ints
    loses_energy: bool = False

    @property
    def nj(self) -> int:
        return len(self.jac_row)


@dataclass(frozen=True)
class Group:
    """All instances of one kernel: gather tables xi, yi, pi, target table oi (each n x local size).

    `power`: power of h on each output; `owner`: component id of each instance; `slot`: first index in V.
    """

    kernel: Kernel
    stage: int
    slot: int
    xi: Ints
    yi: Ints
    pi: Ints
    oi: Ints
    power: Powers
    owner: Ints

    @property
    def n(self) -> int:
        return len(self.owner)


@dataclass(frozen=True)
class Products:
    """Sparse matrix whose entry e is  sum_l value[l] h^power[l] V[s[l]] V[t[l]],  l in ptr[e]..ptr[e+1]."""

    row: Ints
    col: Ints
    ptr: Ints
    s: Ints
    t: Ints
    value: Floats
    power: Powers

    @property
    def nnz(self) -> int:
        return len(self.row)


@dataclass(frozen=True)
class Holds:
    """Holonomic constraints whose rows may rest: redundant ones are left out, w[row] = 0 in their place.

    `rows`: of each its k nodes, then the velocity level if the scheme has one;  `rests`: redundant at the start;
    `size`: natural size of the velocity constraint, against which one that rests is still redundant;
    `vanishing`: a mass they act on is so small that rounding of the forces moves it: Newton's method begins with delta.
    """

    rows: tuple[tuple[int, ...], ...] = ()
    rests: NDArray[np.bool_] = field(default_factory=lambda: np.zeros(0, bool))
    size: Floats = field(default_factory=lambda: np.zeros(0))
    vanishing: bool = False

    def __len__(self) -> int:
        return len(self.rows)

    def of(self, chosen: NDArray[np.bool_]) -> Ints:
        """Rows of the chosen constraints."""
        return np.array([row for rows, c in zip(self.rows, chosen, strict=True) if c for row in rows], np.int32)


@dataclass(frozen=True)
class Plan:
    """One discretised system; see the module text for the spaces and `docs/internals/plan.md` for the use.

    `matrix` is A in CSC order (columns ascending, rows ascending inside a column).
    `derivative` holds the other blocks of d[residual | mean pair outputs]/d[w | held inputs].
    `order[j]`: j-th pivot column, `pivot_row[j]`: its preferred row or -1.
    `mean_*`: algebraic reports a[mean_a] = sum mean_c h^mean_pow Y[mean_w].
    `ncondensed`: so many values of condensed variables, the last rows of R, are copied to the end of Z after the solve.
    `work_*`: pairs that get the energy R[work_row] beside h sum b y u.
    `regularised`: entries of A that get +delta after row scaling, in the factor only; with `hold` attempts are
    made without it first, with it first where masses are vanishing.
    `hold`: constraints whose rows may rest; none where the scheme cannot leave rows out.
    `schur`: what the fast solver of constrained particles needs besides, or None where it does not apply.
    `carries`: 1 if the reported algebraic variables belong to the end of a step and enter the next one; else they are
    means over the step.
    """

    nx: int
    nw: int
    nu: int
    k: int
    nz: int
    np: int
    nq: int
    nobs: int
    na: int
    ncomp: int
    groups: tuple[Group, ...]
    nslot: int
    const_row: Ints
    const_src: Ints
    const_val: Floats
    const_pow: Powers
    matrix: Products
    colptr: Ints
    order: Ints
    pivot_row: Ints
    regularised: Ints
    derivative: Products
    update_x: Ints
    update_w: Ints
    update_c: Floats
    mean_a: Ints
    mean_w: Ints
    mean_c: Floats
    mean_pow: Powers
    work_pair: Ints
    work_row: Ints
    guess_ptr: Ints
    guess_idx: Ints
    guess_val: Floats
    guess_pow: Powers
    increments: Powers
    weights: Floats
    nodes: Floats
    pair_src: Ints
    pair_owner: Ints
    nominal: Floats
    schur: Any = None
    hold: Holds = field(default_factory=Holds)
    carries: int = 0
    ncondensed: int = 0

    @property
    def nv(self) -> int:
        """Length of v = [w | u | h]."""
        return self.nw + self.nu * self.k + 1

    @property
    def nrow(self) -> int:
        """Rows of R: residual, pair outputs per node, observables."""
        return self.nw + self.nq * self.k + self.nobs

    @property
    def seeds(self) -> NDArray[np.bool_]:
        """Mask of the reported algebraic variables whose unknown may start from a reported value; increments start from 0."""
        at = np.minimum(self.mean_w, max(self.nw - 1, 0))
        return (self.mean_w < self.nw) & (np.append(self.increments, 0)[at] == 0)
