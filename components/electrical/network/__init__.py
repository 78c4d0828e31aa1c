"""Parts of three-phase networks: lines, transformers, loads, shunts, faults; currents count into the component."""

from phfmu.components.electrical.network.lines import coupled_line, line_per_unit, pi_line, series_compensated_line
from phfmu.components.electrical.network.loads import capacitor_bank, load, rlc_branch, shunt
from phfmu.components.electrical.network.transformers import two_winding_transformer

__all__ = [
    "capacitor_bank",
    "coupled_line",
    "line_per_unit",
    "load",
    "pi_line",
    "rlc_branch",
    "series_compensated_line",
    "shunt",
    "two_winding_transformer",
]
