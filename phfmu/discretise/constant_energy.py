"""The constant part of H: the energy of each summand that no state enters, by component.

A ledger is judged against the energies that vary; beside a constant of 1e12 J the rounding of H would hide what is made.
"""

from __future__ import annotations

import casadi as ca
import numpy as np
from numpy.typing import NDArray

from phfmu.discretise.accounts import Accounts
from phfmu.discretise.model import Model
from phfmu.terms.canonical import member


class Constants:
    """The constant part of H, by component: each summand with all states at zero, or at the start where it has no value there."""

    def __init__(self, model: Model):
        d = model.declaration
        summands = [(e.owner, e.expr) for e in d.energies] + [(p.owner, p.hamiltonian) for p in d.closed]
        x, p = (ca.vertcat(ca.SX(0, 1), *(v.sx for v in some)) for some in (d.states, d.parameters))
        H = ca.vertcat(ca.SX(0, 1), *(e for _, e in summands))
        starts = ca.DM(model.x0[: x.numel()])
        zero, start = (ca.densify(ca.substitute(H, x, point)) for point in (0 * starts, starts))
        self._values = ca.Function("H", [p], [zero, start])
        self._zero, self._start = zero, start
        self._p0 = model.p0
        self._owner = np.array([member(model.members, owner) for owner, _ in summands], int)
        self._count, self._accounts = len(model.members), Accounts.of(model.members)

    @property
    def parameters(self) -> frozenset[int]:
        """Places of the parameters that they depend on."""
        lost = ~np.isfinite(np.array(self._values(self._p0)[0]).ravel())
        on_zero, on_start = (self._values.jac_sparsity(i, 0).get_triplet() for i in range(2))
        return frozenset(on_zero[1]) | {j for i, j in zip(*on_start, strict=True) if lost[i]}

    def booked(self, p: NDArray[np.float64]) -> tuple[float, ...]:
        """The constant part of H [J] for these parameters, by the components that are booked; () if it is zero."""
        held = self.at(p)
        return held if self._accounts is None or not held else tuple(self._accounts.folded(np.array(held)).tolist())

    def at(self, p: NDArray[np.float64]) -> tuple[float, ...]:
        """The constant part of H [J] for these parameters, by component; () if it is zero."""
        zero, start = (np.array(values).ravel() for values in self._values(p))
        value = np.where(np.isfinite(zero), zero, np.where(np.isfinite(start), start, 0.0))
        found = np.bincount(self._owner, value, self._count)
        return tuple(found.tolist()) if found.any() else ()

    @property
    def expression(self) -> ca.SX:
        """The sum over the components as an expression of the parameters, with the summands at zero that have a value there."""
        zero, start = (np.isfinite(np.array(values).ravel()) for values in self._values(self._p0))
        chosen = [self._zero[i] if at_zero else self._start[i] if at_start else ca.SX(0)
                  for i, (at_zero, at_start) in enumerate(zip(zero, start, strict=True))]  # fmt: skip
        return ca.sum1(ca.vertcat(ca.SX(0), *chosen))
