"""Sensitivity of the outputs of a step to its inputs at the nodes and its impulses, for the Newton method of a master."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from phfmu.plan.plan import Plan

Array = NDArray[np.float64]


@dataclass(frozen=True)
class NodeSensitivity:
    """Derivatives of the last step, a column each: of the chosen inputs at node 1, at node 2, ..., then of the impulses.

    nodes: dY, of the outputs at the nodes (k x nu x columns), exact for any number of internal steps and substeps
    x:     of the states at the end of the step (nx x columns)
    end:   of the outputs at the end (nu x columns), None unless asked for
    """

    nodes: Array
    x: Array
    end: Array | None = None


def chosen(plan: Plan, inputs: Sequence[int] | None) -> list[int]:
    """The inputs asked for, all by default; IndexError names those that do not exist."""
    found = list(range(plan.nu)) if inputs is None else [int(j) for j in inputs]
    if bad := [j for j in found if not 0 <= j < plan.nu]:
        raise IndexError(f"inputs {bad} of a model with {plan.nu}, numbered from 0")
    return found


def directions(plan: Plan, inputs: Sequence[int], impulses: int = 0) -> tuple[Array, Array]:
    """Unit directions of the chosen inputs at each node (m x k x nu), then of impulses at start and end (m x 2 x n)."""
    k, rows = plan.k, plan.k * len(inputs)
    du, ds = np.zeros((rows + 2 * impulses, k, plan.nu)), np.zeros((rows + 2 * impulses, 2, impulses))
    ds[rows:] = np.eye(2 * impulses).reshape(2 * impulses, 2, impulses)
    for node in range(k):
        for place, j in enumerate(inputs):
            du[node * len(inputs) + place, node, j] = 1.0
    return du, ds


def columns(plan: Plan, dy: Array, dx: Array, end: Array | None) -> NodeSensitivity:
    """The sensitivity whose columns are rows of directions."""
    return NodeSensitivity(np.moveaxis(dy, 0, -1), dx[:, : plan.nx].T, None if end is None else end.T)
