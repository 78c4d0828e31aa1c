"""The names of `phfmu.components.electrical.network` and where they are defined."""

from phfmu.components.electrical.network.inverter import grid_following_inverter as grid_following_inverter
from phfmu.components.electrical.network.lines import coupled_line as coupled_line
from phfmu.components.electrical.network.lines import line_per_unit as line_per_unit
from phfmu.components.electrical.network.lines import pi_line as pi_line
from phfmu.components.electrical.network.lines import series_compensated_line as series_compensated_line
from phfmu.components.electrical.network.loads import capacitor_bank as capacitor_bank
from phfmu.components.electrical.network.loads import load as load
from phfmu.components.electrical.network.loads import rlc_branch as rlc_branch
from phfmu.components.electrical.network.loads import shunt as shunt
from phfmu.components.electrical.network.saturation import MagnetisationCurve as MagnetisationCurve
from phfmu.components.electrical.network.saturation import saturating_reactor as saturating_reactor
from phfmu.components.electrical.network.shunts import constant_power_load as constant_power_load
from phfmu.components.electrical.network.shunts import fault as fault
from phfmu.components.electrical.network.shunts import fault_events as fault_events
from phfmu.components.electrical.network.shunts import surge_arrester as surge_arrester
from phfmu.components.electrical.network.thevenin import thevenin_source as thevenin_source
from phfmu.components.electrical.network.transformers import two_winding_transformer as two_winding_transformer

__all__: list[str]
