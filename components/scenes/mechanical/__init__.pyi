"""The names of `phfmu.components.scenes.mechanical` and where they are defined."""

from phfmu.components.scenes.mechanical.bead import bead as bead
from phfmu.components.scenes.mechanical.bouncing_ball import bouncing_ball as bouncing_ball
from phfmu.components.scenes.mechanical.clutch_engagement import clutch_engagement as clutch_engagement
from phfmu.components.scenes.mechanical.oscillator import oscillator as oscillator
from phfmu.components.scenes.mechanical.panda import panda as panda
from phfmu.components.scenes.mechanical.robot_arm import robot_arm as robot_arm
from phfmu.components.scenes.mechanical.speed_control import speed_control as speed_control
from phfmu.components.scenes.mechanical.stops import buffer as buffer
from phfmu.components.scenes.mechanical.stops import hard_stop as hard_stop
from phfmu.components.scenes.mechanical.two_point_control import two_point_control as two_point_control

__all__: list[str]
