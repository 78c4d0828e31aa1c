"""The names of `phfmu.components.electrical.machines` and where they are defined."""

from phfmu.components.electrical.machines.dc_motor import dc_motor as dc_motor
from phfmu.components.electrical.machines.induction_machine import induction_machine as induction_machine
from phfmu.components.electrical.machines.synchronous_machine import machine_at_bus as machine_at_bus
from phfmu.components.electrical.machines.synchronous_machine import synchronous_machine as synchronous_machine

__all__: list[str]
