"""The names of `phfmu.components.scenes` and where they are defined."""

from phfmu.components.scenes.drive import drive as drive
from phfmu.components.scenes.electrical import breaker_opening as breaker_opening
from phfmu.components.scenes.electrical import buck as buck
from phfmu.components.scenes.electrical import ferroresonance as ferroresonance
from phfmu.components.scenes.electrical import inrush as inrush
from phfmu.components.scenes.electrical import island as island
from phfmu.components.scenes.electrical import ladder as ladder
from phfmu.components.scenes.electrical import lossless as lossless
from phfmu.components.scenes.electrical import motor_start as motor_start
from phfmu.components.scenes.electrical import rectifier as rectifier
from phfmu.components.scenes.electrical import short_circuit as short_circuit
from phfmu.components.scenes.electrical import six_pulse as six_pulse
from phfmu.components.scenes.electrical import smib as smib
from phfmu.components.scenes.electrical import smib_breaker as smib_breaker
from phfmu.components.scenes.electrical import smib_exciter as smib_exciter
from phfmu.components.scenes.electrical import smib_folded as smib_folded
from phfmu.components.scenes.electrical import smib_hydro as smib_hydro
from phfmu.components.scenes.electrical import spin_down as spin_down
from phfmu.components.scenes.electrical import stall_start as stall_start
from phfmu.components.scenes.electrical import two_machine as two_machine
from phfmu.components.scenes.electrical import weak_grid as weak_grid
from phfmu.components.scenes.electrical import wscc9 as wscc9
from phfmu.components.scenes.electrical import wscc9_steady as wscc9_steady
from phfmu.components.scenes.electrical import wscc9_trip as wscc9_trip
from phfmu.components.scenes.engine import engine as engine
from phfmu.components.scenes.mechanical import bead as bead
from phfmu.components.scenes.mechanical import bouncing_ball as bouncing_ball
from phfmu.components.scenes.mechanical import buffer as buffer
from phfmu.components.scenes.mechanical import clutch_engagement as clutch_engagement
from phfmu.components.scenes.mechanical import hard_stop as hard_stop
from phfmu.components.scenes.mechanical import oscillator as oscillator
from phfmu.components.scenes.mechanical import panda as panda
from phfmu.components.scenes.mechanical import robot_arm as robot_arm
from phfmu.components.scenes.mechanical import speed_control as speed_control
from phfmu.components.scenes.mechanical import two_point_control as two_point_control

__all__: list[str]
