"""The maps phi and U of a system transformation."""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import casadi as ca

from phfmu.declare.error import DeclarationError, Problem
from phfmu.declare.variable import Variable, _sx, time


@dataclass(frozen=True, eq=False)
class CoordinateMaps:
    """x = phi(x~) and the matrix U(x~) of the rows; DeclarationError if their shapes do not fit or time is in them.

    phi:  old variable -> expression of the new ones and of parameters;  new: the new variables;  U: (n x n), default identity
    """

    phi: Mapping[Variable, Any]
    new: tuple[Variable, ...]
    U: Any = None

    def __post_init__(self) -> None:
        phi = {v: ca.SX(_sx(e)) for v, e in self.phi.items()}
        object.__setattr__(self, "phi", phi)
        object.__setattr__(self, "new", tuple(self.new))
        n = sum(v.n for v in self.old)
        U = ca.SX.eye(n) if self.U is None else ca.SX(_sx(self.U))
        object.__setattr__(self, "U", ca.sparsify(U))
        if found := [*self._misshapen(), *self._timed()]:
            raise DeclarationError.of(found)

    def _misshapen(self) -> Iterator[Problem]:
        for v, e in self.phi.items():
            if e.shape != (v.n, 1):
                yield Problem("shape", f"phi of '{v.name}'", f"is {e.shape[0]} x {e.shape[1]}, expected {v.n} x 1",
                              "give one expression for each of its entries")  # fmt: skip
        names = f"({listed(self.old)}) from ({listed(self.new)})"
        n, m = sum(v.n for v in self.old), sum(v.n for v in self.new)
        if n != m:
            yield Problem("shape", "phi", f"makes {n} coordinates {names}, which have {m}: a diffeomorphism keeps their number",
                          "for a redundant description use constraints")  # fmt: skip
        elif self.U.shape != (n, n):
            yield Problem("shape", "U", f"is {self.U.shape[0]} x {self.U.shape[1]}, expected {n} x {n}: {names}",
                          "give it a row for each old coordinate, a column for each new one")  # fmt: skip

    def _timed(self) -> Iterator[Problem]:
        if any(s.element_hash() == time.element_hash() for s in self.foreign):
            yield Problem(
                "symbol", "phi or U", "depends on time", "a system transformation is a function of the state only"
            )

    @property
    def old(self) -> tuple[Variable, ...]:
        """The variables that are replaced."""
        return tuple(self.phi)

    @property
    def x(self) -> ca.SX:
        """The new variables, stacked."""
        return ca.vertcat(*(v.sx for v in self.new))

    @property
    def image(self) -> ca.SX:
        """phi(x~), stacked in the order of the old variables."""
        return ca.vertcat(*self.phi.values())

    @property
    def jacobian(self) -> ca.SX:
        """Dphi(x~)."""
        return ca.jacobian(self.image, self.x)

    @property
    def affine(self) -> bool:
        """True if Dphi does not depend on the new variables."""
        return not ca.depends_on(ca.veccat(self.jacobian), self.x)

    @property
    def foreign(self) -> tuple[ca.SX, ...]:
        """Symbols in phi and U that are not new variables: parameters of the model."""
        own = {s.element_hash() for s in ca.vertsplit(self.x)}
        found = ca.symvar(ca.vertcat(ca.vec(self.image), ca.vec(ca.SX(self.U))))
        return tuple(s for s in found if s.element_hash() not in own)

    def extended(self, also: Sequence[Variable]) -> CoordinateMaps:
        """The same maps with further variables mapped to themselves."""
        also = [v for v in also if v not in self.phi]
        if not also:
            return self
        phi = {**self.phi, **{v: v.sx for v in also}}
        return CoordinateMaps(phi, (*self.new, *also), ca.diagcat(self.U, ca.SX.eye(sum(v.n for v in also))))


def listed(variables: Sequence[Variable]) -> str:
    return ", ".join(v.name for v in variables)
