"""Electrical components: machines, lines, loads, sources, switches; currents count into the component."""

from phfmu.components.electrical.branches import rc_node, rl_branch, rl_link
from phfmu.components.electrical.breaker import breaker, clearing_fault, ideal_diode
from phfmu.components.electrical.field_source import field_source
from phfmu.components.electrical.infinite_bus import infinite_bus
from phfmu.components.electrical.machines.dc_motor import dc_motor
from phfmu.components.electrical.machines.induction_machine import induction_machine
from phfmu.components.electrical.machines.machine_data import MachineData, MachineDataError, machine_names, machine_set
from phfmu.components.electrical.machines.machine_init import OperatingPoint, operating_point, steady_state
from phfmu.components.electrical.machines.machine_per_unit import from_inductances, from_per_unit, reactances
from phfmu.components.electrical.machines.main_flux import Saturation
from phfmu.components.electrical.machines.synchronous_machine import machine_at_bus, synchronous_machine
from phfmu.components.electrical.network.inverter import grid_following_inverter
from phfmu.components.electrical.network.lines import coupled_line, line_per_unit, pi_line, series_compensated_line
from phfmu.components.electrical.network.loads import capacitor_bank, load, rlc_branch, shunt
from phfmu.components.electrical.network.saturation import MagnetisationCurve, saturating_reactor
from phfmu.components.electrical.network.shunts import constant_power_load, fault, fault_events, surge_arrester
from phfmu.components.electrical.network.thevenin import thevenin_source
from phfmu.components.electrical.network.transformers import two_winding_transformer
from phfmu.components.electrical.rectifiers import rectifier_bridge, six_pulse_bridge
from phfmu.components.electrical.resistor import resistor, transformer
from phfmu.components.electrical.rl_line import rl_line
from phfmu.components.electrical.rlc_load import rlc_load
from phfmu.components.electrical.sources import current_source, voltage_source
from phfmu.components.electrical.switch import fault_resistor
from phfmu.components.electrical.switches import chopper, diode, ideal_switch, thyristor

__all__ = [
    "MachineData",
    "MachineDataError",
    "MagnetisationCurve",
    "OperatingPoint",
    "Saturation",
    "breaker",
    "capacitor_bank",
    "chopper",
    "clearing_fault",
    "constant_power_load",
    "coupled_line",
    "current_source",
    "dc_motor",
    "diode",
    "fault",
    "fault_events",
    "fault_resistor",
    "field_source",
    "from_inductances",
    "from_per_unit",
    "grid_following_inverter",
    "ideal_diode",
    "ideal_switch",
    "induction_machine",
    "infinite_bus",
    "line_per_unit",
    "load",
    "machine_at_bus",
    "machine_names",
    "machine_set",
    "operating_point",
    "pi_line",
    "rc_node",
    "reactances",
    "rectifier_bridge",
    "resistor",
    "rl_branch",
    "rl_line",
    "rl_link",
    "rlc_branch",
    "rlc_load",
    "saturating_reactor",
    "series_compensated_line",
    "shunt",
    "six_pulse_bridge",
    "steady_state",
    "surge_arrester",
    "synchronous_machine",
    "thevenin_source",
    "thyristor",
    "transformer",
    "two_winding_transformer",
    "voltage_source",
]
