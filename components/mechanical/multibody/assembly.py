"""The consistent start of a mechanism: bodies placed by joint coordinates, loops closed, velocities in the mass metric."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np

from phfmu.components.mechanical.multibody.body import MechanismBody
from phfmu.components.mechanical.multibody.gear import Gear
from phfmu.components.mechanical.multibody.joint import SIZES, KinematicJoint, coordinates, directions, finite, motion

#: a joint is open by more than this [m, rad]: it does not assemble
OPEN = 1e-9
#: rates that constraints do not allow by more than this [m/s, rad/s]
MOVING = 1e-9


class Assembly:
    """A spanning tree of the joints, from the ground and from bodies that float; the other joints close loops."""

    def __init__(
        self,
        bodies: Sequence[MechanismBody],
        joints: Sequence[KinematicJoint],
        given: Mapping[str, Any],
        gears: Sequence[Gear] = (),
    ):
        self.bodies, self.joints, self.gears = bodies, joints, gears
        self.tree, self.loops = _spanned(bodies, joints, given)
        self.value = {j.name: coordinates(j) for j, _ in self.tree}

    def set(self, values: Mapping[str, Any]) -> None:
        """Coordinates of joints of the tree."""
        for name, value in values.items():
            if name not in self.value:
                raise ValueError(
                    f"joint '{name}' closes a loop: it has no coordinates to give; give those of {', '.join(self.value)}"
                )
            self.value[name] = finite(f"the coordinates of joint '{name}'", np.atleast_1d(value), len(self.value[name]))

    def place(self) -> None:
        """Poses of all bodies from the coordinates, along the tree."""
        for j, forward in self.tree:
            shift, turn = motion(j, self.value[j.name])
            if forward:
                assert j.b is not None
                at, frame = j.world(j.a, j.at_a, j.frame_a)
                j.b.rotation = frame @ turn @ j.frame_b.T
                j.b.position = at + frame @ shift - j.b.rotation @ j.at_b
            else:
                assert j.a is not None
                at, frame = j.world(j.b, j.at_b, j.frame_b)
                j.a.rotation = frame @ turn.T @ j.frame_a.T
                j.a.position = at - j.a.rotation @ (j.at_a + j.frame_a @ shift)

    def close(self, held: Sequence[str]) -> None:
        """Close the loops by the coordinates of joints that are not held; ValueError names the joint that stays open."""
        from scipy.optimize import least_squares

        free = [(name, i) for name, value in self.value.items() if name not in held for i in range(len(value))]
        self.place()
        if free and self.loops:

            def gaps(x: np.ndarray) -> np.ndarray:
                for (name, i), number in zip(free, x, strict=True):
                    self.value[name][i] = number
                self.place()
                return np.concatenate([j.gap() for j in self.loops])

            start = np.array([self.value[name][i] for name, i in free])
            x = np.asarray(least_squares(gaps, start, xtol=1e-15, ftol=1e-15, gtol=1e-15).x)
            for _ in range(3):  # to rounding, also where the least squares have stopped early
                steps = 1e-6 * np.eye(len(x))
                slope = np.column_stack([(gaps(x + s) - gaps(x - s)) / 2e-6 for s in steps])
                x = x - np.linalg.pinv(slope, rcond=1e-8) @ gaps(x)
            gaps(x)
        require_closed(self.joints, " with these coordinates held" if held else "")

    def move(self, speeds: Mapping[str, Any]) -> None:
        """Velocities along the tree for rates of joints, the others at rest, then those nearest in the mass metric that all
        joints allow; ValueError names the joint that they do not suit.
        """
        names = {j.name: j for j in self.joints}
        rate = {name: np.zeros(len(v)) for name, v in self.value.items()}
        for name, value in speeds.items():
            n = SIZES.get(names[name].kind, 0)
            found = finite(f"the rates of joint '{name}'", np.atleast_1d(value), n)
            if name in rate:
                rate[name] = found
        for j, forward in self.tree:
            move, turn = (m @ rate[j.name] for m in directions(j))
            _, _, at, _ = j.sides()
            if forward:
                assert j.b is not None
                _set_velocity(j.b, at, _velocity(j.a, at) + move, _turning(j.a) + turn)
            else:
                assert j.a is not None
                _set_velocity(j.a, at, _velocity(j.b, at) - move, _turning(j.b) - turn)
        if self.loops or self.gears:
            project(self.bodies, self.joints, speeds, self.gears)


def require_closed(joints: Sequence[KinematicJoint], how: str = "") -> None:
    """ValueError for the joint that is open the most."""
    gaps = [(float(np.max(np.abs(j.gap()), initial=0.0)), j) for j in joints]
    worst, joint = max(gaps, key=lambda g: g[0], default=(0.0, None))
    if joint is not None and worst > OPEN:
        raise ValueError(
            f"the mechanism does not assemble{how}: joint '{joint.name}' between {joint.ends} is open by {worst:.6g} (m or rad); "
            "hold fewer joints, begin from other coordinates, or check lengths and axes"
        )


def project(
    bodies: Sequence[MechanismBody],
    joints: Sequence[KinematicJoint],
    speeds: Mapping[str, Any],
    gears: Sequence[Gear] = (),
) -> None:
    """Change velocities by the least in the mass metric so that joints and gears allow them and joints have the given rates."""
    place = {id(b): 6 * i for i, b in enumerate(bodies)}
    n = 6 * len(bodies)
    rows, right, names = [], [], []
    for j in joints:
        rows.append(velocity_rows(j, place, n))
        right.append(np.zeros(len(rows[-1])))
        names += [f"joint '{j.name}'"] * len(rows[-1])
        if j.name in speeds:
            rows.append(_rate_rows(j, place, n))
            right.append(np.atleast_1d(np.asarray(speeds[j.name], float)))
            names += [f"joint '{j.name}'"] * len(rows[-1])
    for g in gears:
        rows.append(gear_rows(g, place, n))
        right.append(np.zeros(1))
        names.append(f"gear '{g.name}'")
    a, b = np.vstack(rows), np.concatenate(right)
    m = np.zeros((n, n))
    for body in bodies:
        i, r = place[id(body)], body.rotation
        m[i : i + 3, i : i + 3] = body.mass * np.eye(3)
        m[i + 3 : i + 6, i + 3 : i + 6] = r @ body.tensor @ r.T
    v = np.concatenate([[*body.velocity, *body.angular_velocity] for body in bodies])
    kkt = np.block([[m, a.T], [a, np.zeros((len(a), len(a)))]])
    for _ in range(2):  # once more for rounding
        v = v + np.linalg.lstsq(kkt, np.concatenate([np.zeros(n), b - a @ v]), rcond=1e-13)[0][:n]
    missed = np.abs(a @ v - b)
    if np.max(missed, initial=0.0) > MOVING * (1.0 + float(np.max(np.abs(v), initial=0.0))):
        worst = int(np.argmax(missed))
        raise ValueError(
            f"the given rates of joints do not suit each other: {names[worst]} misses {missed[worst]:.6g} "
            "(m/s or rad/s); give fewer of them"
        )
    for body in bodies:
        i = place[id(body)]
        body.velocity, body.angular_velocity = v[i : i + 3].copy(), v[i + 3 : i + 6].copy()


def unallowed(joints: Sequence[KinematicJoint], gears: Sequence[Gear] = ()) -> tuple[float, str]:
    """The largest rate at which a joint would open, or a gear slip [m/s, rad/s], and its name."""
    worst = max(((abs(g.slip()), f"gear '{g.name}'") for g in gears), default=(0.0, ""))
    for j in joints:
        rates = sum(
            (
                rows[:, :3] @ body.velocity + rows[:, 3:] @ body.angular_velocity
                for body, rows in zip((j.a, j.b), _sided_rows(j), strict=True)
                if body is not None
            ),
            np.zeros(len(j.gap())),
        )
        worst = max(worst, (float(np.max(np.abs(rates), initial=0.0)), f"joint '{j.name}'"))
    return worst


def _spanned(
    bodies: Sequence[MechanismBody], joints: Sequence[KinematicJoint], given: Mapping[str, Any]
) -> tuple[list[tuple[KinematicJoint, bool]], list[KinematicJoint]]:
    """Joints of a spanning tree from its roots on, with whether b is placed by a, and the others.

    Joints whose coordinates are given are of the tree where they can be.
    """
    group = {id(b): i + 1 for i, b in enumerate(bodies)} | {id(None): 0}
    chosen: list[KinematicJoint] = []
    for j in sorted(joints, key=lambda j: j.name not in given):
        one, other = group[id(j.a)], group[id(j.b)]
        if j.equations.tree and one != other:
            chosen.append(j)
            group = {k: one if g == other else g for k, g in group.items()}
    placed, tree = {id(None)}, []
    left = [j for j in joints if j in chosen]
    while left:
        ready = [j for j in left if id(j.a) in placed or id(j.b) in placed]
        if not ready:  # a part that floats: its first body stays where it is
            placed.add(id(left[0].a))
            continue
        for j in ready:
            forward = id(j.a) in placed
            placed.add(id(j.b if forward else j.a))
            tree.append((j, forward))
        left = [j for j in left if j not in ready]
    return tree, [j for j in joints if j not in chosen]


def _velocity(body: MechanismBody | None, at: np.ndarray) -> np.ndarray:
    """Velocity of the point of a body that is now at a point of the world."""
    return np.zeros(3) if body is None else body.velocity + np.cross(body.angular_velocity, at - body.centre)


def _turning(body: MechanismBody | None) -> np.ndarray:
    return np.zeros(3) if body is None else body.angular_velocity


def _set_velocity(body: MechanismBody, at: np.ndarray, velocity: np.ndarray, turning: np.ndarray) -> None:
    body.angular_velocity = turning
    body.velocity = velocity + np.cross(turning, body.centre - at)


def _cross(r: np.ndarray) -> np.ndarray:
    """[r]x: r x w = [r]x w."""
    return np.array([[0.0, -r[2], r[1]], [r[2], 0.0, -r[0]], [-r[1], r[0], 0.0]])


def _sided_rows(j: KinematicJoint) -> list[np.ndarray]:
    """Rates of the equations of a joint per velocity and angular velocity of a, and of b (rows x 6 each)."""
    pa, frame_a, pb, frame_b = j.sides()
    slopes = j.slopes()
    out = []
    for body, p, frame, (by_p, by_axes) in (
        (j.a, pa, frame_a, slopes[:2]),
        (j.b, pb, frame_b, slopes[2:]),
    ):
        centre = p if body is None else body.centre
        turn = -by_p @ _cross(p - centre)
        for i in range(3):
            turn = turn - by_axes[:, 3 * i : 3 * i + 3] @ _cross(frame[:, i])
        out.append(np.hstack([by_p, turn]))
    return out


def velocity_rows(j: KinematicJoint, place: Mapping[int, int], n: int) -> np.ndarray:
    """Rates of the equations of a joint per velocities of all bodies."""
    sided = _sided_rows(j)
    rows = np.zeros((len(sided[0]), n))
    for body, part in zip((j.a, j.b), sided, strict=True):
        if body is not None:
            rows[:, place[id(body)] : place[id(body)] + 6] += part
    return rows


def gear_rows(g: Gear, place: Mapping[int, int], n: int) -> np.ndarray:
    """The slip of a gear per velocities of all bodies."""
    return _rate_rows(g.b, place, n) - g.ratio * _rate_rows(g.a, place, n)


def _rate_rows(j: KinematicJoint, place: Mapping[int, int], n: int) -> np.ndarray:
    """Rates of the coordinates of a joint per velocities of all bodies, where its equations hold."""
    move, turn = directions(j)
    _, _, at, _ = j.sides()
    rows = np.zeros((move.shape[1], n))
    back = np.linalg.pinv(np.vstack([move, turn]))  # velocities seen from a -> rates
    for body, sign in ((j.a, -1.0), (j.b, 1.0)):
        if body is not None:
            i = place[id(body)]
            rows[:, i : i + 3] += sign * back[:, :3]
            rows[:, i + 3 : i + 6] += sign * (back[:, 3:] - back[:, :3] @ _cross(at - body.centre))
    return rows
