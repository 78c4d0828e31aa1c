"""Parts of three-phase networks: lines, transformers, loads, shunts, faults; currents count into the component."""

from phfmu.components.electrical.network.inverter import grid_following_inverter
from phfmu.components.electrical.network.lines import coupled_line, line_per_unit, pi_line, series_compensated_line
from phfmu.components.electrical.network.loads import capacitor_bank, load, rlc_branch, shunt
from phfmu.components.electrical.network.saturation import MagnetisationCurve, saturating_reactor
from phfmu.components.electrical.network.shunts import constant_power_load, fault, fault_events, surge_arrester
from phfmu.components.electrical.network.thevenin import thevenin_source
from phfmu.components.electrical.network.transformers import two_winding_transformer

__all__ = [
    "MagnetisationCurve",
    "capacitor_bank",
    "constant_power_load",
    "coupled_line",
    "fault",
    "fault_events",
    "grid_following_inverter",
    "line_per_unit",
    "load",
    "pi_line",
    "rlc_branch",
    "saturating_reactor",
    "series_compensated_line",
    "shunt",
    "surge_arrester",
    "thevenin_source",
    "two_winding_transformer",
]
