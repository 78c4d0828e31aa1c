"""Systems whose constraints repeat each other, or lose rank for an instant, for tests."""

from __future__ import annotations

from collections.abc import Sequence

import casadi as ca
import numpy as np

from phfmu import PHDAE
from phfmu.components.mechanical.multibody import Multibody
from phfmu.studies.stress.mechanisms import G


def hung(scales: Sequence[float]) -> PHDAE:
    """A load that swings on one bar, declared once for each scale of the constraint."""
    body = Multibody("hung", 2)
    body.gravity((0.0, -G))
    load = body.particle(3.0, (1.0, 0.0))
    for i, scale in enumerate(scales):
        body.constraint(lambda at, s=scale: 0.5 * s * (ca.sumsqr(at(load)) - 1.0), f"bar {i + 1}")
    return body.build()


def windows(n: int, angle: float = 0.0, pull: float = 0.0) -> PHDAE:
    """n + 1 parallel cranks of 1 m with 1 kg at their ends, joined by bars: flat, with a loss of rank, twice a turn.

    `pull`: a spring on the first crank [N/m].
    """
    body = Multibody("windows", 2)
    body.gravity((0.0, -G))
    arm, speed = (np.sin(angle), np.cos(angle)), (np.cos(angle), -np.sin(angle))
    ends = [body.particle(1.0, (i + arm[0], arm[1]), speed) for i in range(n + 1)]
    for i, end in enumerate(ends):
        body.bar(body.support((float(i), 0.0)), end)
        if i:
            body.bar(ends[i - 1], end)
    if pull:
        body.linear_spring(body.support((0.0, 2.0)), ends[0], pull, 1.0)
    return body.build()


def crossing(slope: float) -> PHDAE:
    """A load of 2 kg on two rails, x = 0 and x + slope y = 0; for the slope 0 they are one and it falls."""
    body = Multibody("crossing", 2)
    body.gravity((0.0, -G))
    load = body.particle(2.0, (0.0, 0.0))
    p = body.parameter("slope", slope, unit="1")
    body.constraint(lambda at: at(load)[0], "rail")
    body.constraint(lambda at: at(load)[0] + p * at(load)[1], "crossing rail")
    return body.build()
