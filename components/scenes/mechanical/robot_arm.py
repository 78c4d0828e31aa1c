"""A robot arm that its motors carry, move and stop."""

from __future__ import annotations

from collections.abc import Mapping

from phfmu import PHDAE, Event, Scene
from phfmu.components.mechanical.mechanisms.ur5 import ur5

#: torques beside those that carry the arm at its start [N.m]
PUSHES = {"shoulder_pan": 25.0, "elbow": -18.0, "wrist_2": 6.0}
#: friction of each joint with its gear [N.m.s/rad]
FRICTION = 5.0


def robot_arm(*, t_go: float = 0.1, t_back: float = 0.35, t_rest: float = 0.6, stop: float = 1.0) -> Scene:
    """A UR5 whose motors first carry it in its pose, then push three of its joints, then brake them.

    Arguments: t_go [s], when PUSHES are added to the torques;  t_back [s], when they are turned round;  t_rest [s], when they
               end;  stop [s]

    Torques are given and not controlled: those that carry the arm fit the pose of its start, so that it sinks from where it was
    moved to.  The ledger has the work of each motor, which is its torque times the angle that its joint turns by, and what the
    friction of the joints takes.
    """
    arm = ur5(damping=FRICTION, carried=True)
    return Scene(
        "robot_arm",
        arm,
        stop=stop,
        step=2e-3,
        events=pushed(arm, PUSHES, (t_go, t_back, t_rest)),
        description="robot arm, carried, moved and stopped",
        shown=("shoulder_pan.angle", "elbow.angle", "wrist_2.angle", "flange", "elbow.torque"),
    )


def pushed(arm: PHDAE, pushes: Mapping[str, float], times: tuple[float, float, float]) -> tuple[Event, ...]:
    """Torques [N.m] of motors beside those that they begin with: at three times [s] they come, turn round and go."""
    held = {p.name: float(p.start[0]) for p in arm.ports}  # type: ignore[index]
    return tuple(
        Event(t, f"{name}.torque", held[name] + sign * push)
        for t, sign in zip(times, (1.0, -1.0, 0.0), strict=True)
        for name, push in pushes.items()
    )
