"""What an instance is made from: two plans and the start values."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from phfmu.discretise.plan import Kernel, Plan


@dataclass(frozen=True, eq=False)
class Model:
    """A discretised model: `step` advances it by h, `instant` gives its values at one time.

    Start values x0 (nx), algebraic start guesses a0 (na), inputs u0 (nu), parameters p0 (np), all SI; t0 in s.
    Both plans have the same x, inputs, parameters, pairs, algebraics and components; `instant` has k = 1.
    `equations`, `instant_equations`: names of the residual rows for messages, or empty.
    """

    name: str
    step: Plan
    instant: Plan
    x0: NDArray[np.float64]
    a0: NDArray[np.float64]
    u0: NDArray[np.float64]
    p0: NDArray[np.float64]
    t0: float = 0.0
    equations: tuple[str, ...] = ()
    instant_equations: tuple[str, ...] = ()

    def __post_init__(self) -> None:
        problems = []
        for size, values in (("nx", self.x0), ("na", self.a0), ("nu", self.u0), ("np", self.p0)):
            expected, given = getattr(self.step, size), np.shape(values)
            if given != (expected,):
                problems.append(f"start values for {size} = {expected} have shape {given}")
            if expected != getattr(self.instant, size):
                problems.append(f"{size}: step plan {expected}, instant plan {getattr(self.instant, size)}")
        for size in ("nq", "ncomp"):
            if getattr(self.step, size) != getattr(self.instant, size):
                problems.append(
                    f"{size}: step plan {getattr(self.step, size)}, instant plan {getattr(self.instant, size)}"
                )
        if self.instant.k != 1:
            problems.append(f"the instant plan has k = {self.instant.k}, not 1")
        if problems:
            raise ValueError(f"model {self.name}: " + "; ".join(problems))

    @property
    def kernels(self) -> list[Kernel]:
        """Kernels of both plans, in order of appearance; the same object may appear twice."""
        return [g.kernel for plan in (self.step, self.instant) for g in plan.groups]
