"""Junction unknowns at one instant: what the present states of members make of them.

    P^T y(P xi + U_free) + C xi = 0,     y: outputs at the time that each member has come to.

Members without feedthrough need no iteration: their outputs do not follow xi.  `couplings/runtime/instant.c` is the twin.
"""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from phfmu.network.interface.coupled_members import CoupledMembers
from phfmu.network.interface.hidden import hidden_part
from phfmu.network.interface.matrices import update
from phfmu.outcome.limits import defined
from phfmu.outcome.status import Status, StepFailure

Array = NDArray[np.float64]

_NUMBERS = defined(Path(__file__).parent.parent / "couplings" / "runtime" / "in_turn.h")

SOLVED, STALLED, SHRINKING = (_NUMBERS[f"INSTANT_{n}"] for n in ("SOLVED", "STALLED", "SHRINKING"))
ITERATIONS = int(_NUMBERS["INSTANT_ITERATIONS"])


class InstantSolver:
    """Solves these equations again and again; the matrix is kept while it contracts."""

    def __init__(self) -> None:
        self._matrix: Any = None

    def solve(self, joined: CoupledMembers, xi: Array, t: float) -> Array:
        """xi at the present states, which the members have as inputs then.

        ValueError names the unknowns that no output determines; StepFailure where the iteration does not converge.
        """
        worst = [np.inf]
        for _ in range(ITERATIONS):
            joined.apply(xi)
            y = joined.end_outputs()
            r, size = joined.rows(xi, y), joined.row_sizes(xi, y)
            worst.append(float(np.max(np.abs(r) / size, initial=0.0)))
            stays = worst[-1] > SHRINKING * worst[-2]
            if worst[-1] <= SOLVED or (stays and worst[-1] <= STALLED):
                return xi
            if self._matrix is None or stays:
                self._matrix = regular(joined, joined.instant_matrix(xi))
            xi = xi + update(self._matrix, r)
        raise StepFailure(
            Status.NO_CONVERGENCE, joined.network.name, t, 0.0, residual=worst[-1], iterations=ITERATIONS, joined=True,
            history=worst, composable=joined.network.composable, tried="the junctions at one instant",
        )  # fmt: skip


def regular(joined: CoupledMembers, matrix: Any) -> Any:
    """The matrix of the unknowns at an instant; ValueError names those that no output determines."""
    free = abs(hidden_part(matrix.T, 1.0 / joined.face.nominal)).max(axis=1).toarray().ravel()
    names = [n for n, f in zip(joined.face.names, free, strict=True) if f > 1e-6]
    if names:
        raise ValueError(
            f"{joined.network.name}: no output gives {', '.join(names)} at an instant, so members cannot be stepped one "
            "after the other; take --coupling newton, or join an element that gives it (a capacitor at a node, a spring at "
            "a rigid joint)"
        )
    return matrix
