"""Rigid bodies: mass, centre of mass and inertia in any frame; their principal directors with the length of gyration.

    T = m |c'|^2/2 + sum e_i |d_i'|^2/2,     e = eigenvalues of tr(J)/2 - J

with the centre of mass c and unit directors d_i along the principal axes: a diagonal mass matrix.  A director is kept with the
gyration length rho = sqrt(max(e)/m), so that its mass e_i/rho^2 is at most m and all coordinates are metres.
"""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import Any

import numpy as np

#: Euler moments below this part of the largest are zero; negative ones below minus this part break the triangle inequality
NOTHING = 1e-9

Vector = Any  # numbers of a point or direction


@dataclass(eq=False)
class MechanismBody:
    """A rigid body; made by `Mechanism.body`, `rod` or `point_mass`.

    mass [kg];  com [m]: centre of mass in the frame of the body
    tensor [kg.m2]: about the centre of mass, in that frame
    position [m], rotation: of the frame of the body at the start;  velocity [m/s]: of the centre of mass
    angular_velocity [rad/s]: in the axes of the world
    directors: principal axes that are kept, 3, for a thin rod 1, for a point mass 0
    planar: its motion is in the plane, where the first director gives the second
    """

    name: str
    mass: float
    com: np.ndarray
    tensor: np.ndarray
    position: np.ndarray
    rotation: np.ndarray
    velocity: np.ndarray
    angular_velocity: np.ndarray
    directors: int = 3
    planar: bool = False
    #: principal axes (columns) in the frame of the body, their Euler moments [kg.m2], and the gyration length [m]
    axes: np.ndarray = field(init=False, repr=False)
    moments: np.ndarray = field(init=False, repr=False)
    rho: float = field(init=False)

    def __post_init__(self) -> None:
        if not self.mass >= 0 or not np.isfinite(self.mass):
            raise ValueError(f"body '{self.name}': mass {self.mass} kg must be zero or positive")
        if self.planar:
            moment = float(self.tensor[2, 2])
            self.moments, self.axes = np.array((moment, 0.0, 0.0)), np.eye(3)
            self.rho = float(np.sqrt(moment / self.mass)) if self.mass > 0 and moment > 0 else 1.0
            return
        moments, axes = np.linalg.eigh(0.5 * np.trace(self.tensor) * np.eye(3) - self.tensor)
        moments, axes = moments[::-1], axes[:, ::-1]
        if np.linalg.det(axes) < 0:
            axes = axes * (1.0, 1.0, -1.0)
        least = NOTHING * max(float(moments[0]), 0.0)
        if moments[-1] < -least or moments[0] < 0:
            a, b, c = sorted(np.linalg.eigvalsh(self.tensor))
            raise ValueError(
                f"body '{self.name}': the principal moments {a:.6g}, {b:.6g}, {c:.6g} kg.m2 break the triangle inequality: "
                f"{c:.6g} > {a:.6g} + {b:.6g}; no mass distribution has them: check units, the point and the axes of the tensor"
            )
        self.moments, self.axes = np.where(moments <= least, 0.0, moments), axes
        self.rho = float(np.sqrt(moments[0] / self.mass)) if self.mass > 0 and moments[0] > 0 else 1.0

    @property
    def centre(self) -> np.ndarray:
        """The centre of mass at the start [m], in the world."""
        return self.position + self.rotation @ self.com

    def at(self, local: np.ndarray) -> np.ndarray:
        """A point of the frame of the body at the start, in the world [m]."""
        return self.position + self.rotation @ local

    def local(self, world: np.ndarray) -> np.ndarray:
        """A point of the world in the frame of the body at the start [m]."""
        return self.rotation.T @ (world - self.position)

    def principal(self, local: np.ndarray) -> np.ndarray:
        """A point of the frame of the body, from the centre of mass along the principal axes [m]."""
        return self.axes.T @ (local - self.com)


def tensor(name: str, inertia: Any, mass: float, offset: np.ndarray, axes: Any) -> np.ndarray:
    """The tensor about the centre of mass in the frame of the body [kg.m2].

    inertia:  3 moments or a symmetric 3 x 3 tensor, in `axes` (columns in the frame of the body), about a point `offset` [m] away
              from the centre of mass
    Errors:   ValueError if it is neither
    """
    given = np.asarray(inertia, float)
    j = np.diag(given) if given.shape == (3,) else given
    if j.shape != (3, 3) or not np.all(np.isfinite(j)):
        raise ValueError(f"body '{name}': the inertia {inertia!r} is neither 3 moments nor a 3 x 3 tensor in kg.m2")
    skew = float(np.max(np.abs(j - j.T)))
    if skew > 1e-9 * max(float(np.max(np.abs(j))), 1e-300):
        raise ValueError(f"body '{name}': the inertia tensor is not symmetric, by {skew:.3g} kg.m2")
    r = np.asarray(axes, float)
    j = r @ (0.5 * (j + j.T)) @ r.T
    return j - mass * (offset @ offset * np.eye(3) - np.outer(offset, offset))


def rotation_about(axis: Vector, angle: float) -> np.ndarray:
    """The rotation matrix about an axis through an angle [rad]."""
    x, y, z = np.asarray(axis, float) / np.linalg.norm(axis)
    k = np.array([[0.0, -z, y], [z, 0.0, -x], [-y, x, 0.0]])
    return np.eye(3) + np.sin(angle) * k + (1.0 - np.cos(angle)) * (k @ k)


def frame_along(axis: Vector, x: Vector | None = None) -> np.ndarray:
    """A frame with its z along `axis`, and its x as near to `x` as can be (default: the world axis farthest from z)."""
    z = np.asarray(axis, float) / np.linalg.norm(axis)
    near = np.eye(3)[int(np.argmin(np.abs(z)))] if x is None else np.asarray(x, float)
    first = near - (near @ z) * z
    first = first / np.linalg.norm(first)
    return np.column_stack((first, np.cross(z, first), z))


@dataclass(frozen=True)
class Spring:
    """A spring [N/m] with a damper [N.s/m] along it, between points (body or the ground, place in its frame [m])."""

    name: str
    a: tuple[MechanismBody | None, np.ndarray]
    b: tuple[MechanismBody | None, np.ndarray]
    stiffness: float
    length: float
    damping: float
