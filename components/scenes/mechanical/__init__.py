"""Scenes of bodies that move, turn and meet."""

from phfmu.components.scenes.mechanical.bead import bead
from phfmu.components.scenes.mechanical.bouncing_ball import bouncing_ball
from phfmu.components.scenes.mechanical.clutch_engagement import clutch_engagement
from phfmu.components.scenes.mechanical.oscillator import oscillator
from phfmu.components.scenes.mechanical.panda import panda
from phfmu.components.scenes.mechanical.robot_arm import robot_arm
from phfmu.components.scenes.mechanical.speed_control import speed_control
from phfmu.components.scenes.mechanical.stops import buffer, hard_stop
from phfmu.components.scenes.mechanical.two_point_control import two_point_control

__all__ = [
    "bead",
    "bouncing_ball",
    "buffer",
    "clutch_engagement",
    "hard_stop",
    "oscillator",
    "panda",
    "robot_arm",
    "speed_control",
    "two_point_control",
]
