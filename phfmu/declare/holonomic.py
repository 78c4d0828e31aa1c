"""Holonomic constraints."""

from __future__ import annotations

from dataclasses import dataclass, replace

import casadi as ca

from phfmu.declare.port import Port, drive
from phfmu.declare.variable import Variable, time


@dataclass(frozen=True, eq=False)
class Holonomic:
    """Constraints g(q, t) = 0 with multiplier lambda: 0 = Dg z_v + g_t, and -Dg^T lambda on the rows of v (q' = z_v).

    drive: port at which the work lambda^T g_t of constraints that depend on `time` is booked (one may serve several);
           None = `<multiplier>_drive` if it is needed
    label: what it is, for reports (`bar particle 1-particle 2`)
    kept:  of constraints that depend on each other those without this flag rest; it is for the constraints inside a body
    """

    multiplier: Variable
    g: ca.SX
    owner: str = ""
    drive: Port | None = None
    label: str = ""
    kept: bool = False

    def with_drive(self) -> Holonomic:
        """Itself, or a copy with a drive if it moves and has none."""
        if self.drive is not None or not ca.depends_on(ca.SX(self.g), time):
            return self
        return replace(self, drive=drive(f"{self.multiplier.name}_drive", owner=self.owner))
