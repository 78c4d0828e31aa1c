"""Mechanisms of rigid bodies, joints, loops and drives, in space or in the plane.

    q' = v,   M v' = -DV(q) - R(q) v - Dg(q)^T lambda + J(q)^T u,   0 = g(q),   y = J(q) v

with q the centres of mass and the principal directors of the bodies: M is constant and diagonal, g of degree two.
Source: P. Betsch, P. Steinmann, Int. J. Numer. Meth. Engng. 50 (2001), for rigid bodies in directors.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from itertools import product
from typing import Any, Literal

import numpy as np

from phfmu import PHDAE
from phfmu.components.mechanical.multibody.assembly import Assembly, require_closed, unallowed
from phfmu.components.mechanical.multibody.body import MechanismBody, Spring, frame_along, rotation_about, tensor
from phfmu.components.mechanical.multibody.bushing import Bushing
from phfmu.components.mechanical.multibody.contact import Compliance, ContactPair, Limits
from phfmu.components.mechanical.multibody.equations import MechanismEquations, MechanismParts, ObservedQuantity
from phfmu.components.mechanical.multibody.gear import Gear
from phfmu.components.mechanical.multibody.joint import KinematicJoint, finite, known_kind
from phfmu.components.mechanical.multibody.mobility import Mobility, mobility


class Mechanism:
    """Bodies and joints; `assemble` places them, `build` gives the declaration.

    planar:   all motion is in the x-y plane: points have 2 entries, inertias are one moment about z, and no loop has
              equations twice
    gravity:  [m/s2], 3 entries or 2; default: 9.81 m/s2 against z, in the plane against y

    States:       q, v: positions and velocities of centres of mass and directors; `NAME.turned` of joints that count turns
    Multipliers:  `NAME.lambda` of joints [N], `NAME.lambda_axes` [N.m], `NAME.rigid` of bodies [N/m]
    Observables:  of a body NAME.position [m] (centre of mass), rotation (3 x 3, by columns; in the plane NAME.angle),
                  angular_velocity [rad/s], momentum, energy;  of a joint NAME.force [N] and NAME.torque [N.m] on its second
                  body in the axes of the world, and NAME.angle or .length with .rate;  where a motor's port has
                  the name NAME.torque, or of a slider NAME.force, that of the joint is NAME.reaction
    Errors:       ValueError names the body or joint and the numbers
    """

    def __init__(
        self, name: str, *, planar: bool = False, gravity: Sequence[float] | None = None, description: str = ""
    ):
        default = (0.0, -9.81, 0.0) if planar else (0.0, 0.0, -9.81)
        self.parts = MechanismParts(name, planar, np.array(default), description)
        #: sentences on what the reader of a file took otherwise than the file says
        self.assumed: tuple[str, ...] = ()
        if gravity is not None:
            self.parts.gravity = self._point("gravity", gravity)

    @property
    def name(self) -> str:
        return self.parts.name

    @property
    def planar(self) -> bool:
        return self.parts.planar

    @property
    def bodies(self) -> list[MechanismBody]:
        return self.parts.bodies

    @property
    def joints(self) -> list[KinematicJoint]:
        return self.parts.joints

    # -- bodies -----------------------------------------------------------------------------------------------------

    def body(
        self,
        name: str,
        mass: float,
        inertia: Any,
        *,
        com: Sequence[float] | None = None,
        axes: Any = None,
        about: Sequence[float] | None = None,
        position: Sequence[float] | None = None,
        rotation: Any = None,
        velocity: Sequence[float] | None = None,
        angular_velocity: Any = None,
    ) -> MechanismBody:
        """A rigid body.

        mass [kg];  com [m]: centre of mass in the frame of the body (default: its origin)
        inertia [kg.m2]: in space 3 moments or a symmetric 3 x 3 tensor, in the directions `axes` (columns, in the frame of the
        body; default: that frame), about the point `about` (default: com); in the plane one moment about z
        position [m], rotation (matrix; in the plane an angle [rad]) of the frame, velocity [m/s] of the centre of mass,
        angular_velocity [rad/s] in the axes of the world (in the plane a number): at the start; `assemble` gives others
        """
        centre = self._point(f"com of body '{name}'", com)
        if self.planar:
            moment = float(np.ravel(inertia)[0]) if np.size(inertia) == 1 else float("nan")
            if not moment >= 0:
                raise ValueError(
                    f"body '{name}': in the plane its inertia is one moment about z [kg.m2], got {inertia!r}"
                )
            offset = np.zeros(3) if about is None else self._point(f"about of body '{name}'", about) - centre
            moment -= mass * float(offset @ offset)
            own = np.diag((moment / 2, moment / 2, moment))
        else:
            offset = np.zeros(3) if about is None else self._point(f"about of body '{name}'", about) - centre
            own = tensor(name, inertia, mass, offset, np.eye(3) if axes is None else axes)
        return self._add(name, mass, centre, own, 3, position, rotation, velocity, angular_velocity)

    def rod(self, name: str, mass: float, length: float, **start: Any) -> MechanismBody:
        """A uniform thin rod along the x axis of its frame, from -length/2 to length/2 [m].

        In space it has no moment about its axis and no direction across it: joints hold points on it.  `start`: as for `body`.
        """
        if not length > 0:
            raise ValueError(f"rod '{name}': length {length} m must be positive")
        moment = mass * length**2 / 12
        if self.planar:
            return self.body(name, mass, moment, **start)
        given = {k: start.pop(k, None) for k in ("position", "rotation", "velocity", "angular_velocity")}
        if start:
            raise ValueError(f"rod '{name}': no argument {', '.join(start)}")
        return self._add(name, mass, np.zeros(3), np.diag((0.0, moment, moment)), 1, **given)

    def point_mass(
        self, name: str, mass: float, position: Sequence[float] | None = None, velocity: Sequence[float] | None = None
    ) -> MechanismBody:
        """A point mass [kg] at a position [m], with a velocity [m/s]."""
        return self._add(name, mass, np.zeros(3), np.zeros((3, 3)), 0, position, None, velocity, None)

    # -- joints -----------------------------------------------------------------------------------------------------

    def joint(
        self,
        kind: str,
        name: str,
        a: MechanismBody | None,
        b: MechanismBody | None,
        *,
        at: Sequence[float] | None = None,
        at_a: Sequence[float] | None = None,
        at_b: Sequence[float] | None = None,
        axis: Sequence[float] | None = None,
        axis_b: Sequence[float] | None = None,
        x_axis: Sequence[float] | None = None,
        length: float | None = None,
        damping: float = 0.0,
        stiffness: float = 0.0,
        neutral: float = 0.0,
        armature: float = 0.0,
        motor: Literal["", "effort", "flow"] | bool = "",
        turns: bool = False,
        limits: tuple[float, float] | Limits | None = None,
        restitution: float = 0.0,
    ) -> KinematicJoint:
        """A joint between the bodies a and b; None is the ground.

        kind:       in space fixed, revolute, prismatic, cylindrical, spherical, universal, planar, point_on_line, distance; in
                    the plane fixed, revolute, prismatic, point_on_line, distance
        at_a, at_b: where it is [m], in the frame of each body (default: the origins), or `at`: in the world, at the poses that
                    the bodies have now
        axis:       of rotation or sliding, with at_a in the frame of a and axis_b in that of b (default: the same), with `at` in
                    the world; default z, in the plane x;  x_axis: the direction of a that angles count from
        length [m]: of a distance; default: as the bodies are now
        damping:    N.m.s/rad or N.s/m on the rate;  stiffness, neutral: of a spring on the coordinate, N.m/rad or N/m
        armature:   inertia of a rotor [kg.m2], or mass [kg], that moves with the coordinate and with nothing else
        motor:      a port NAME: "effort" (or True): torque or force given, speed found; "flow": the reverse
        turns:      NAME.angle counts turns beyond pi, by a state
        limits:     (lower, upper) [rad, m], infinite where there is none: hard ends that throw back with `restitution`, as state
                    events NAME.lower and NAME.upper; or `Limits(lower, upper, compliance=Compliance(..))`, which give way
        """
        found = known_kind(kind, self.planar)
        self._require_new(name)
        for body in (a, b):
            if body is not None and body not in self.bodies:
                raise ValueError(f"joint '{name}': its body is no body of {self.name}")
        if a is b:
            raise ValueError(f"joint '{name}' joins {'the ground' if a is None else repr(a.name)} with itself")
        if (damping or stiffness or motor or turns or armature) and len(found.coordinates) == 0:
            raise ValueError(f"joint '{name}': a {kind} joint has no coordinate for a damper, spring or motor")
        if (stiffness or motor or turns or armature or limits is not None) and len(found.coordinates) != 1:
            raise ValueError(
                f"joint '{name}': a {kind} joint has {len(found.coordinates)} coordinates; use joints with one each"
            )
        ends = Limits(*limits, restitution) if isinstance(limits, tuple) else limits
        wide = ends is not None and (ends.compliance is not None or not ends.upper - ends.lower < 2 * np.pi)
        joint = KinematicJoint(
            kind, name, a, b, *self._placed(name, a, b, at, at_a, at_b, axis, axis_b, x_axis), self.planar,
            0.0, damping, stiffness, neutral, "effort" if motor is True else motor or "", turns or bool(stiffness) or wide,
            armature, ends,
        )  # fmt: skip
        if ends is not None:
            ends.require(f"joint '{name}'")
        self._require_directions(joint)
        if kind == "distance":
            pa, _, pb, _ = joint.sides()
            joint.length = float(np.linalg.norm(pb - pa)) if length is None else float(length)
            if not joint.length > 0:
                raise ValueError(f"joint '{name}': a distance of {joint.length:g} m; it needs a positive one")
        self.joints.append(joint)
        return joint

    def gear(self, name: str, a: KinematicJoint, b: KinematicJoint, ratio: float) -> Gear:
        """A fixed ratio between the rates of two joints with one coordinate each: rate of b = ratio times rate of a.

        ratio:  of wheels in mesh -r_a/r_b, of a belt r_a/r_b [1];  of a rack, b a slider, the radius [m/rad]
        Kept of the coordinates themselves, with all turns, so that nothing slips at the end of any step; no power is lost.
        `assemble` and `mobility` know gears.  Observable: NAME.torque [N.m], or NAME.force [N], on b
        """
        self._require_new(name)
        for joint in (a, b):
            if joint not in self.joints:
                raise ValueError(f"gear '{name}': joint '{joint.name}' is no joint of {self.name}")
        self.parts.gears.append(Gear(name, a, b, float(ratio)))
        return self.parts.gears[-1]

    def spring(
        self,
        name: str,
        a: tuple[MechanismBody | None, Sequence[float]],
        b: tuple[MechanismBody | None, Sequence[float]],
        stiffness: float,
        length: float,
        damping: float = 0.0,
    ) -> None:
        """A spring 1/2 k (|b - a| - length)^2 and a damper along it between points (body, place in its frame [m]).

        stiffness [N/m], length [m], damping [N.s/m]; None as a body: a fixed point
        """
        ends = [(body, self._point(f"spring '{name}'", place)) for body, place in (a, b)]
        self.parts.springs.append(Spring(name, ends[0], ends[1], float(stiffness), float(length), float(damping)))

    def bushing(
        self,
        name: str,
        a: MechanismBody | None,
        b: MechanismBody | None,
        *,
        stiffness: Sequence[float],
        damping: Sequence[float] = (),
        hardening: Sequence[float] = (),
        neutral: Sequence[float] = (),
        at: Sequence[float] | None = None,
        at_a: Sequence[float] | None = None,
        at_b: Sequence[float] | None = None,
        axis: Sequence[float] | None = None,
        axis_b: Sequence[float] | None = None,
        x_axis: Sequence[float] | None = None,
    ) -> Bushing:
        """Springs and dampers along and about the axes of a frame between a and b (None: the ground), without equations.

        stiffness: 6 numbers k, along x, y, z [N/m] and about x, y, z [N.m/rad] of the frame on a; in the plane 3: along x, y and
                   about z;  force k s, torque k phi;  entries of 0 leave a direction free
        damping:   as many, on the rates [N.s/m, N.m.s/rad];  hardening: as many c, of a part c s^3 more [N/m3, N.m/rad3]
        neutral:   displacement of b and its rotation vector [m, rad] seen from a where it is not loaded, 6 numbers, in the plane
                   3;  a preload F is neutral = -F/k
        places and axes: as of `joint`;  with `at` it is not loaded where the bodies are now
        phi is the angle about an axis alone: the torque is k phi to 2e-6 up to 90 and 5e-4 up to 120 degrees, and falls to zero
        at half a turn; what turns further is a joint with a `stiffness`.
        Observables: NAME.displacement [m], NAME.rotation [rad] in the axes of a, NAME.force [N], NAME.torque [N.m] on b in
                   the axes of the world, NAME.energy [J]
        Errors:    ValueError names the bushing and the numbers
        """
        what = f"bushing '{name}'"
        self._require_new(name)
        if a is b or not all(body is None or body in self.bodies for body in (a, b)):
            raise ValueError(f"{what}: it is between two bodies of {self.name}, or the ground and one")
        k, d, c = (
            self._along_and_about(f"{label} of {what}", given)
            for label, given in (("stiffness", stiffness), ("damping", damping), ("hardening", hardening))
        )
        shift = self._along_and_about(f"neutral of {what}", neutral)
        pa, pb, frame, other = self._placed(name, a, b, at, at_a, at_b, axis, axis_b, x_axis)
        if angle := float(np.linalg.norm(shift[3:])):
            other = other @ rotation_about(shift[3:], angle).T
        self.parts.bushings.append(Bushing(name, a, b, pa, pb, frame, other, self.planar, k, d, c, shift[:3]))
        return self.parts.bushings[-1]

    def contact(
        self,
        name: str,
        a: MechanismBody | None,
        b: MechanismBody,
        *,
        at_a: Sequence[float] | None = None,
        at_b: Sequence[float] | None = None,
        normal: Sequence[float] | None = None,
        radius: float = 0.0,
        radius_a: float = 0.0,
        restitution: float = 0.0,
        compliance: Compliance | None = None,
    ) -> ContactPair:
        """A contact without friction of a ball, or a point, of b with a plane or a ball of a (None: the ground).

        normal:    of the plane through at_a [m], towards b, in the frame of a; None: a has a ball about at_a of `radius_a` [m]
        at_b:      centre of the ball of b, of `radius` [m]; 0: a point
        restitution: of a hard contact, which throws back: a state event NAME whose loss is booked
        compliance:  a contact that gives way and may hold (see `Compliance`)
        Observable:  NAME.gap [m];  errors: ValueError names the contact that overlaps at the start, in `build`
        """
        what = f"contact '{name}'"
        self._require_new(name)
        if a is b or b not in self.bodies or not (a is None or a in self.bodies):
            raise ValueError(f"{what}: it is between two bodies of {self.name}, or the ground and one")
        across = None if normal is None else self._point(what, normal)
        places = self._point(what, at_a), self._point(what, at_b)
        pair = ContactPair(name, a, b, *places, across, radius, radius_a, restitution, compliance)
        self.parts.contacts.append(pair)
        return pair

    def box_contact(
        self,
        name: str,
        a: MechanismBody | None,
        b: MechanismBody,
        size: Sequence[float],
        *,
        at_a: Sequence[float] | None = None,
        normal: Sequence[float] | None = None,
        restitution: float = 0.0,
        compliance: Compliance | None = None,
    ) -> list[ContactPair]:
        """Contacts NAME1, NAME2, .. of the corners of a box of b with a plane of a: edges `size` [m], about the frame of b.

        normal: default against gravity's usual direction, z in space and y in the plane;  all else as of `contact`
        """
        n = 2 if self.planar else 3
        half = 0.5 * finite(f"size of the box of contact '{name}'", size, n)
        up = [0.0] * (n - 1) + [1.0] if normal is None else normal
        corners = [half * signs for signs in product((-1.0, 1.0), repeat=n)]
        return [
            self.contact(
                f"{name}{i}",
                a,
                b,
                at_a=at_a,
                at_b=corner.tolist(),
                normal=up,
                restitution=restitution,
                compliance=compliance,
            )
            for i, corner in enumerate(corners, 1)
        ]

    def observe(
        self, name: str, of: MechanismBody | KinematicJoint, place: Sequence[float] | None = None, description: str = ""
    ) -> None:
        """An observable of its own: a point of a body at a place in its frame [m], or the coordinate of a joint."""
        if isinstance(of, KinematicJoint) and len(of.equations.coordinates) != 1:
            raise ValueError(
                f"observable '{name}': joint '{of.name}' has {len(of.equations.coordinates)} coordinates, not one"
            )
        at = self._point(f"observable '{name}'", place)
        self.parts.observed.append(ObservedQuantity(name, of, at, description or f"{name} of {of.name}"))

    # -- start and declaration --------------------------------------------------------------------------------------

    def assemble(
        self,
        coordinates: Mapping[str, Any] | None = None,
        *,
        speeds: Mapping[str, Any] | None = None,
        near: Mapping[str, Any] | None = None,
    ) -> dict[str, np.ndarray]:
        """Place the bodies and give them velocities that all joints allow; returns the coordinates found.

        coordinates:  joint -> angle [rad] or displacement [m], or several, which are held: revolute, prismatic 1, cylindrical
                      (angle, length), planar (x, y, angle), universal 2 angles, spherical a rotation vector
        near:         where the search for the others begins (default: as the bodies are now)
        speeds:       joint -> rates; the others follow, nearest to rest in the mass metric
        Errors:       ValueError names the joint that stays open and its gap; the bodies stay where they were
        """
        held, moving = coordinates or {}, speeds or {}
        known = {j.name for j in self.joints}
        for name in (*held, *moving, *(near or {})):
            if name not in known:
                raise ValueError(f"{self.name}: no joint '{name}'; there are: {', '.join(sorted(known))}")
        before = [(b.position, b.rotation, b.velocity, b.angular_velocity) for b in self.bodies]
        work = Assembly(self.bodies, self.joints, {**(near or {}), **held}, self.parts.gears)
        try:
            work.set({**(near or {}), **held})
            work.close(list(held))
            work.move(moving)
        except ValueError:
            for body, start in zip(self.bodies, before, strict=True):
                body.position, body.rotation, body.velocity, body.angular_velocity = start
            raise
        for joint in self.joints:
            found = work.value.get(joint.name, np.zeros(0))
            joint.start = float(found[0]) if len(found) == 1 else None
        return work.value

    def build(self, *, observe: bool = True) -> PHDAE:
        """The declaration; `observe=False` leaves observables out.

        Errors: ValueError names a joint that is open at the start, or that velocities at the start would open
        """
        if not self.bodies:
            raise ValueError(f"{self.name}: no bodies")
        require_closed(self.joints)
        rate, name = unallowed(self.joints, self.parts.gears)
        if rate > 1e-8 * (1.0 + max(float(np.linalg.norm(b.velocity)) for b in self.bodies)):
            raise ValueError(
                f"{self.name}: the velocities at the start open {name} at {rate:.6g} (m/s or rad/s); "
                "call assemble(speeds=..)"
            )
        for part in (*self.parts.contacts, *self.joints):
            part.require_apart(self.name)
        return MechanismEquations(self.parts, observe).phdae()

    def mobility(self) -> Mobility:
        """Degrees of freedom, equations, and the joints among whose equations some are too many, at the start."""
        return mobility(self.bodies, self.joints, self.parts.gears, self.planar)

    # -- parts of arguments -----------------------------------------------------------------------------------------

    def _require_new(self, name: str) -> None:
        """ValueError for a name that another part has."""
        p = self.parts
        if any(x.name == name for x in (*p.joints, *p.bodies, *p.bushings, *p.contacts, *p.gears)):
            raise ValueError(f"{self.name}: there are two parts called '{name}'")

    def _point(self, what: str, values: Sequence[float] | None) -> np.ndarray:
        """Three entries."""
        if values is None:
            return np.zeros(3)
        n = 2 if self.planar and np.size(values) == 2 else 3
        return np.append(finite(what, values, n), np.zeros(3 - n))

    def _along_and_about(self, what: str, values: Sequence[float]) -> np.ndarray:
        """Six numbers along and about x, y, z, of 6 or, in the plane, of 3; none are zeros."""
        if not np.size(values):
            return np.zeros(6)
        found = finite(what, values, 3 if self.planar else 6)
        return np.array((*found[:2], 0.0, 0.0, 0.0, found[2])) if self.planar else found

    def _add(
        self, name: str, mass: float, com: np.ndarray, own: np.ndarray, directors: int, position: Any, rotation: Any,
        velocity: Any, angular_velocity: Any,
    ) -> MechanismBody:  # fmt: skip
        if any(b.name == name for b in self.bodies):
            raise ValueError(f"{self.name}: there are two bodies called '{name}'")
        turn = np.eye(3)
        if rotation is not None:
            turn = frame_angle(float(rotation)) if self.planar else np.asarray(rotation, float)
            if turn.shape != (3, 3) or np.max(np.abs(turn @ turn.T - np.eye(3))) > 1e-9 or np.linalg.det(turn) < 0:
                raise ValueError(f"body '{name}': rotation is no rotation matrix: {np.asarray(rotation).tolist()}")
        spin = np.zeros(3)
        if angular_velocity is not None:
            spin = finite(
                f"angular_velocity of body '{name}'", np.atleast_1d(angular_velocity), 1 if self.planar else 3
            )
            spin = np.array((0.0, 0.0, spin[0])) if self.planar else spin
        place, speed = (
            self._point(f"{what} of body '{name}'", x) for what, x in (("position", position), ("velocity", velocity))
        )
        self.bodies.append(MechanismBody(name, float(mass), com, own, place, turn, speed, spin, directors, self.planar))
        return self.bodies[-1]

    def _placed(
        self, name: str, a: MechanismBody | None, b: MechanismBody | None, at: Any, at_a: Any, at_b: Any, axis: Any, axis_b: Any,
        x_axis: Any,
    ) -> tuple[np.ndarray, np.ndarray, np.ndarray, np.ndarray]:  # fmt: skip
        """Places and axes in the frames of both bodies."""
        what = f"joint '{name}'"
        along = self._point(what, axis) if axis is not None else np.array((1.0, 0, 0) if self.planar else (0, 0, 1.0))
        if not np.linalg.norm(along) > 0:
            raise ValueError(f"{what}: its axis is zero")
        first = None if x_axis is None else self._point(what, x_axis)
        frame = _in_plane(along) if self.planar else frame_along(along, first)
        if at is None:
            other = frame
            if axis_b is not None:
                turned = self._point(what, axis_b)
                other = _in_plane(turned) if self.planar else frame_along(turned)
            return self._point(what, at_a), self._point(what, at_b), frame, other
        if at_a is not None or at_b is not None or axis_b is not None:
            raise ValueError(
                f"{what}: give its place by `at` in the world, or by at_a and at_b in its bodies, not both"
            )
        world = self._point(what, at)
        places = [world if body is None else body.local(world) for body in (a, b)]
        frames = [frame if body is None else body.rotation.T @ frame for body in (a, b)]
        return places[0], places[1], frames[0], frames[1]

    def _require_directions(self, joint: KinematicJoint) -> None:
        """ValueError for a joint that needs directions a rod or a point mass does not have."""
        uses = {"spherical": (), "distance": (), "point_on_line": ("a",)}.get(joint.kind, ("a", "b"))
        if self.planar and joint.kind == "revolute":
            uses = ()
        for side in ("a", "b"):
            body, at = getattr(joint, side), getattr(joint, f"at_{side}")
            if body is None or body.directors == 3:
                continue
            off = at if body.directors == 0 else at[1:]
            if side in uses or np.max(np.abs(off), initial=0.0) > 1e-12:
                what = "point mass" if body.directors == 0 else "rod"
                raise ValueError(
                    f"joint '{joint.name}': body '{body.name}' is a {what}, which has no directions for a {joint.kind} joint "
                    f"at {at.tolist()}; make it a body"
                )


def frame_angle(angle: float) -> np.ndarray:
    """The rotation about z through an angle [rad]."""
    c, s = np.cos(angle), np.sin(angle)
    return np.array([[c, -s, 0.0], [s, c, 0.0], [0.0, 0.0, 1.0]])


def _in_plane(x: np.ndarray) -> np.ndarray:
    """The frame with its x along a direction of the plane."""
    return frame_angle(float(np.arctan2(x[1], x[0])))
