"""E11, J, R and B of a declaration as whole matrices."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING

import casadi as ca

from phfmu.declare.entries.coefficients import coefficient, square, stacked
from phfmu.declare.error import DeclarationError
from phfmu.declare.variable import Variable, key, slices

if TYPE_CHECKING:
    from phfmu.declare.phdae import PHDAE
    from phfmu.declare.port import Port


@dataclass(frozen=True, eq=False)
class Matrices:
    """E11 (n1 x n1) on the states; J, R (n x n) and B (n x m) on (states, algebraic variables) and all ports."""

    E: ca.SX
    J: ca.SX
    R: ca.SX
    B: ca.SX


def matrices(model: PHDAE) -> Matrices:
    """The whole matrices of a small model; holonomic constraints and closed-form pairs are not part of them."""
    variables = (*model.states, *model.algebraics)
    place, n, n1 = slices(variables), sum(v.n for v in variables), model.x.numel()

    def rows(vs: Sequence[Variable | Port]) -> list[int]:
        if any(key(v) not in place for v in vs):
            raise DeclarationError(
                model.name,
                f"the model has feedthrough ({', '.join(v.name for v in vs)} in one block)",
                "let its ports act by `on` only",
            )
        return [i for v in vs for i in range(place[key(v)].start, place[key(v)].stop)]

    E, J, R, B = ca.SX.eye(n1), ca.SX(n, n), ca.SX(n, n), ca.SX(n, sum(p.n for p in model.ports))
    for where, value in model.E.items():
        index = rows(stacked(where))
        E[index, index] = square(value, len(index))
    for total, blocks in ((J, model.structure), (R, model.dissipation)):
        for b in blocks:
            index = rows(b.variables)
            total[index, index] += b.matrix
    at = 0
    for port in model.ports:
        for v, value in port.on.items():
            B[place[key(v)], at : at + port.n] = coefficient(value, v.n, port.n)
        at += port.n
    return Matrices(*(ca.sparsify(m) for m in (E, J, R, B)))
