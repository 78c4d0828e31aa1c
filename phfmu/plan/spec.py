"""Specification of one kernel: local expressions and the addresses of their arguments and results.

Local arguments of a term, created on demand.
"""

from __future__ import annotations

import hashlib
from collections.abc import Sequence
from dataclasses import dataclass, field

import casadi as ca
import numpy as np

from phfmu.declare.variable import ValueKind
from phfmu.plan.address import Address, Old, Place, states_then_time
from phfmu.plan.plan import Kernel
from phfmu.terms.term import Term

#: (address, power of h, expression)
Result = tuple[Address, int, ca.SX]


@dataclass
class Spec:
    """A kernel before it is compiled: symbols, addresses and results.

    `x`: local old values, whose indices `old` gives; `p`: parameters; `y`: symbol per argument address; `out`: (address,
    power of h, expression) per result; `stored`, `lost`, `numerical`: ledger expressions or None; `report`: nothing is solved
    for the results, so they need no derivatives.
    """

    stage: int
    x: ca.SX
    p: ca.SX
    y: list[tuple[Address, ca.SX]]
    out: list[Result]
    stored: ca.SX | None = None
    lost: ca.SX | None = None
    report: bool = False
    numerical: ca.SX | None = None
    old: Old = states_then_time


_cache: dict[str, Kernel] = {}


def build(spec: Spec) -> Kernel:
    """The kernel of a spec; kernels of equal content are one object."""
    y = ca.vertcat(*(s for _, s in spec.y)) if spec.y else ca.SX(0, 1)
    out = ca.vertcat(*(e for _, _, e in spec.out)) if spec.out else ca.SX(0, 1)
    out = ca.densify(out)
    jac = ca.SX(out.numel(), y.numel()) if spec.report else ca.jacobian(out, y)
    row, col = jac.sparsity().get_triplet()
    nonzeros = ca.SX(jac.nz[:]) if row else ca.SX(0, 1)
    out, nonzeros = ca.cse([out, nonzeros])  # derivatives repeat the trigonometry of their function
    args = [spec.x, y, spec.p]
    text = ca.Function("k", args, [out, nonzeros]).serialize()
    has_ledger = spec.stored is not None or spec.lost is not None
    ledger_out = [ca.SX(0) if e is None else ca.densify(e) for e in (spec.stored, spec.lost)]
    if spec.numerical is not None:
        ledger_out.append(ca.densify(spec.numerical))
    ledger_out = ca.cse(ledger_out)
    if has_ledger:
        text += ca.Function("l", args, ledger_out).serialize()
    digest = hashlib.sha256(text.encode()).hexdigest()[:16]
    name = f"k_{digest}"
    if name not in _cache:
        function = ca.Function(name, args, [out, nonzeros], ["x", "y", "p"], ["out", "jac"])
        ledger = ca.Function(f"l_{digest}", args, ledger_out) if has_ledger else None
        _cache[name] = Kernel(
            name, function, ledger, spec.x.numel(), y.numel(), spec.p.numel(), out.numel(),
            np.array(row, np.int32), np.array(col, np.int32), has_ledger and spec.numerical is not None,
        )  # fmt: skip
    return _cache[name]


def substituted(exprs: Sequence[ca.SX], pairs: Sequence[tuple[ca.SX, ca.SX]]) -> list[ca.SX]:
    """`exprs` with every (old, new) pair replaced at once; empty symbols are left out."""
    old = [o for o, _ in pairs if o.numel()]
    new = [n for o, n in pairs if o.numel()]
    return ca.substitute(list(exprs), old, new) if old else list(exprs)


@dataclass
class Arguments:
    """Symbols of a term's arguments at k nodes, in a fixed order, with their addresses."""

    term: Term
    k: int
    y: list[tuple[Address, ca.SX]] = field(default_factory=list)

    def symbol(self, place: Place, j: int = 0, node: int = 0) -> ca.SX:
        """An argument as a fresh scalar symbol."""
        s = ca.SX.sym("y")  # kernels that differ in names only are one
        self.y.append((Address(place, j, node), s))
        return s

    def matrix(self, place: Place, n: int) -> ca.SX:
        """n x k symbols of one place, node by node."""
        return ca.horzcat(*(ca.vertcat(*(self.symbol(place, j, i) for j in range(n))) for i in range(self.k)))

    @property
    def x(self) -> ca.SX:
        """Old states of the term, then time if it depends on it."""
        return ca.vertcat(self.term.symbols(ValueKind.STATE), self.term.symbols(ValueKind.TIME))

    @property
    def p(self) -> ca.SX:
        return self.term.symbols(ValueKind.PARAMETER)
