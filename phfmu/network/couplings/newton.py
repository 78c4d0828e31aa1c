"""Newton coupling: an interface Newton iteration on the step maps of the members; the iteration is `runtime/interface_newton.c`.

With k_J node values xi_i per junction variable and a pair of impulses m, m' at bare nodes, the rows of a step are

    r_i = P^T (R* Y)_i + C xi_i,      r_e = P_b^T y1,      r_T = m' - (-1)^k_J T m,

with T m = 1/n sum_l (cos^2 t_l S1 + sin^2 t_l S0)^-1 S0 m, the rule of composed models (`schemes/impulses.py`), S0 before the
step and S1 after it.  dT/dS1 is left out of the matrix, which is that of the first trial of a step, taken anew where rows stall.
Held values are the case k = 1 without impulses,

    r(xi) = P^T Y(P xi + U_free) + C xi = 0,     dr/dxi = P^T G P + C,     G = dY/dU of each member's step,

whose matrix is taken at each trial.  sym(G) > 0 makes it regular.

By the members' own books the junctions take W = h sum b_i xi_i.r_i + m.r_0 + m'.r_e + (m S0 m - m' S1 m')/2, r_0 being r_e before
the step; also where the iteration stops early.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

from numpy.typing import NDArray

from phfmu.network.interface.coupled_members import CoupledMembers
from phfmu.network.interface.unknowns import InterfaceUnknowns

Array = NDArray[Any]


@dataclass(frozen=True)
class Continuation:
    """Start of the iteration of the next step of the same length.

    found:   unknowns of the step, as the master has them: xi at the nodes, impulses at the start and at the end
    missed:  what the continuation of the step before missed of it, that one's of the step before, and so on, as far as known
    """

    found: Array
    missed: tuple[Array, ...] = ()


class Newton:
    """Newton's method on the interface residual, with as many values per junction variable as members take: the order is theirs.

    `exchange`: unknowns at nodes; None: one held value per junction variable, so that the whole is of order 2.
    """

    repeats, closes = True, True
    #: of held values
    order = 2

    def __init__(self, exchange: InterfaceUnknowns | None = None):
        self.exchange = exchange
        if exchange is not None:
            self.order = 2 * int(exchange.counts.min(initial=exchange.counts.max(initial=1)))


def newton(joined: CoupledMembers) -> Newton:
    """The coupling with the most that the members offer, which may be one held value each."""
    exchange = InterfaceUnknowns(joined)
    return Newton() if exchange.held and not exchange.whole else Newton(exchange)
