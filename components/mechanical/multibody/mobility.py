"""Degrees of freedom of a mechanism at its start, and the joints among whose equations some are too many."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from phfmu.components.mechanical.multibody.assembly import gear_rows, velocity_rows
from phfmu.components.mechanical.multibody.body import MechanismBody
from phfmu.components.mechanical.multibody.gear import Gear
from phfmu.components.mechanical.multibody.joint import KinematicJoint

#: singular values of rows of length 1 below this are zero
DEPENDENT = 1e-9


@dataclass(frozen=True)
class Mobility:
    """degrees of freedom [1];  equations of joints and gears, and their rank
    redundant: joints among whose equations some are too many
    """

    freedom: int
    equations: int
    rank: int
    redundant: tuple[str, ...]

    def report(self) -> str:
        """A sentence or two."""
        text = f"{self.freedom} degrees of freedom; {self.equations} equations of joints of rank {self.rank}"
        if not self.redundant:
            return text
        names = ", ".join(self.redundant)
        return f"{text}: {self.equations - self.rank} too many, among those of {names}; their forces are not unique"


def mobility(
    bodies: Sequence[MechanismBody], joints: Sequence[KinematicJoint], gears: Sequence[Gear], planar: bool
) -> Mobility:
    """From the velocities that joints and gears allow at the start, with lengths in units of the mechanism."""
    place = {id(b): 6 * i for i, b in enumerate(bodies)}
    n = 6 * len(bodies)
    parts = [(j.name, velocity_rows(j, place, n)) for j in joints] + [(g.name, gear_rows(g, place, n)) for g in gears]
    rows = np.vstack([np.zeros((0, n)), *(r for _, r in parts)])
    names = [name for name, r in parts for _ in r]
    rows = rows @ np.hstack(
        [np.zeros((rows.shape[1], 0)), *(_free(b, planar, 6 * k, rows.shape[1]) for k, b in enumerate(bodies))]
    )
    size = np.linalg.norm(rows, axis=1, keepdims=True)
    scaled = rows / np.where(size > 0, size, 1.0)
    left, s, _ = np.linalg.svd(scaled) if len(rows) else (np.zeros((0, 0)), np.zeros(0), None)
    rank = int(np.sum(s > DEPENDENT))
    shares = np.max(np.abs(left[:, rank:]), axis=1, initial=0.0) if len(rows) else np.zeros(0)
    redundant = dict.fromkeys(n for n, share in zip(names, shares, strict=True) if share > 1e-6)
    return Mobility(rows.shape[1] - rank, len(rows), rank, tuple(redundant))


def _free(body: MechanismBody, planar: bool, first: int, n: int) -> np.ndarray:
    """Directions among all velocities in which a body can move (n x its freedom); a rod does not turn about itself."""
    turning = {0: np.zeros((3, 0)), 1: (body.rotation @ body.axes)[:, 1:], 3: np.eye(3)}[body.directors]
    if planar:
        turning = np.eye(3)[:, 2:] if body.directors else turning
    moving = np.eye(3)[:, :2] if planar else np.eye(3)
    found = np.zeros((n, moving.shape[1] + turning.shape[1]))
    found[first : first + 3, : moving.shape[1]] = moving
    found[first + 3 : first + 6, moving.shape[1] :] = turning
    return found
