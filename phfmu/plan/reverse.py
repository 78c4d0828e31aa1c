"""Kernels in reverse: from derivatives of a number by their results to those by their arguments.

    bar_(x, y, p) = (d results / d (x, y, p))^T bar,

at a cost that does not depend on how many arguments there are, see `runtime/reverse/reverse.h`.
"""

from __future__ import annotations

from functools import lru_cache

import casadi as ca

from phfmu.plan.plan import Kernel


@lru_cache(maxsize=4096)
def _reverse(function: ca.Function, results: int) -> ca.Function:
    """The first results, one value after the other, in reverse."""
    x, y, p = function.sx_in()
    out = ca.vertcat(*(ca.densify(r) for r in function.call([x, y, p])[:results]))
    bar = ca.SX.sym("bar", out.numel())
    along = ca.densify(ca.jtimes(out, ca.vertcat(x, y, p), bar, True))
    nx, ny = x.numel(), y.numel()
    parts = [along[:nx], along[nx : nx + ny], along[nx + ny :]]
    return ca.Function("reverse", [x, y, p, bar], ca.cse([ca.densify(r) for r in parts]), {"allow_free": False})


def reverse(kernel: Kernel) -> ca.Function:
    """(x, y, p, bar of out) -> bars of x, y, p."""
    return _reverse(kernel.function, 1)


def reverse_ledger(kernel: Kernel) -> ca.Function | None:
    """(x, y, p, bar of [stored, lost]) -> bars of x, y, p; None for a kernel without energies."""
    return None if kernel.ledger is None else _reverse(kernel.ledger, 2)
