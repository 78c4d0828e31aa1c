"""Scenes: networks with their step, stop time and events."""

from phfmu.components.scenes.bead import bead
from phfmu.components.scenes.bouncing_ball import bouncing_ball
from phfmu.components.scenes.breaker_opening import breaker_opening
from phfmu.components.scenes.buck import buck
from phfmu.components.scenes.clutch_engagement import clutch_engagement
from phfmu.components.scenes.drive import drive
from phfmu.components.scenes.engine import engine
from phfmu.components.scenes.island import island, smib_exciter
from phfmu.components.scenes.ladder import ladder
from phfmu.components.scenes.motor_start import motor_start
from phfmu.components.scenes.network_events import ferroresonance, inrush, short_circuit, weak_grid
from phfmu.components.scenes.oscillator import oscillator
from phfmu.components.scenes.rectifier import rectifier, six_pulse
from phfmu.components.scenes.robot_arm import robot_arm
from phfmu.components.scenes.single_machine import lossless, spin_down, stall_start
from phfmu.components.scenes.smib import smib, smib_breaker, smib_folded, smib_hydro
from phfmu.components.scenes.speed_control import speed_control
from phfmu.components.scenes.stops import buffer, hard_stop
from phfmu.components.scenes.two_machine import two_machine
from phfmu.components.scenes.two_point_control import two_point_control
from phfmu.components.scenes.wscc9 import wscc9, wscc9_steady, wscc9_trip

__all__ = [
    "bead",
    "bouncing_ball",
    "breaker_opening",
    "buck",
    "buffer",
    "clutch_engagement",
    "drive",
    "engine",
    "ferroresonance",
    "hard_stop",
    "inrush",
    "island",
    "ladder",
    "lossless",
    "motor_start",
    "oscillator",
    "rectifier",
    "robot_arm",
    "short_circuit",
    "six_pulse",
    "smib",
    "smib_breaker",
    "smib_exciter",
    "smib_folded",
    "smib_hydro",
    "speed_control",
    "spin_down",
    "stall_start",
    "two_machine",
    "two_point_control",
    "weak_grid",
    "wscc9",
    "wscc9_steady",
    "wscc9_trip",
]
