"""The names of `phfmu.components.scenes.electrical` and where they are defined."""

from phfmu.components.scenes.electrical.breaker_opening import breaker_opening as breaker_opening
from phfmu.components.scenes.electrical.buck import buck as buck
from phfmu.components.scenes.electrical.island import island as island
from phfmu.components.scenes.electrical.island import smib_exciter as smib_exciter
from phfmu.components.scenes.electrical.ladder import ladder as ladder
from phfmu.components.scenes.electrical.motor_start import motor_start as motor_start
from phfmu.components.scenes.electrical.network_events import ferroresonance as ferroresonance
from phfmu.components.scenes.electrical.network_events import inrush as inrush
from phfmu.components.scenes.electrical.network_events import short_circuit as short_circuit
from phfmu.components.scenes.electrical.network_events import weak_grid as weak_grid
from phfmu.components.scenes.electrical.rectifier import rectifier as rectifier
from phfmu.components.scenes.electrical.rectifier import six_pulse as six_pulse
from phfmu.components.scenes.electrical.single_machine import lossless as lossless
from phfmu.components.scenes.electrical.single_machine import spin_down as spin_down
from phfmu.components.scenes.electrical.single_machine import stall_start as stall_start
from phfmu.components.scenes.electrical.smib import smib as smib
from phfmu.components.scenes.electrical.smib import smib_breaker as smib_breaker
from phfmu.components.scenes.electrical.smib import smib_folded as smib_folded
from phfmu.components.scenes.electrical.smib import smib_hydro as smib_hydro
from phfmu.components.scenes.electrical.two_machine import two_machine as two_machine
from phfmu.components.scenes.electrical.wscc9 import wscc9 as wscc9
from phfmu.components.scenes.electrical.wscc9 import wscc9_steady as wscc9_steady
from phfmu.components.scenes.electrical.wscc9 import wscc9_trip as wscc9_trip

__all__: list[str]
