"""Scenes of machines, lines and grids."""

from phfmu.components.scenes.electrical.breaker_opening import breaker_opening
from phfmu.components.scenes.electrical.buck import buck
from phfmu.components.scenes.electrical.island import island, smib_exciter
from phfmu.components.scenes.electrical.ladder import ladder
from phfmu.components.scenes.electrical.motor_start import motor_start
from phfmu.components.scenes.electrical.network_events import ferroresonance, inrush, short_circuit, weak_grid
from phfmu.components.scenes.electrical.rectifier import rectifier, six_pulse
from phfmu.components.scenes.electrical.single_machine import lossless, spin_down, stall_start
from phfmu.components.scenes.electrical.smib import smib, smib_breaker, smib_folded, smib_hydro
from phfmu.components.scenes.electrical.two_machine import two_machine
from phfmu.components.scenes.electrical.wscc9 import wscc9, wscc9_steady, wscc9_trip

__all__ = [
    "breaker_opening",
    "buck",
    "ferroresonance",
    "inrush",
    "island",
    "ladder",
    "lossless",
    "motor_start",
    "rectifier",
    "short_circuit",
    "six_pulse",
    "smib",
    "smib_breaker",
    "smib_exciter",
    "smib_folded",
    "smib_hydro",
    "spin_down",
    "stall_start",
    "two_machine",
    "weak_grid",
    "wscc9",
    "wscc9_steady",
    "wscc9_trip",
]
