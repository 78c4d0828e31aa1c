"""Electrical machines: their data, their operating points, their models."""

from phfmu.components.electrical.machines.dc_motor import dc_motor
from phfmu.components.electrical.machines.induction_machine import induction_machine
from phfmu.components.electrical.machines.synchronous_machine import machine_at_bus, synchronous_machine

__all__ = ["dc_motor", "induction_machine", "machine_at_bus", "synchronous_machine"]
