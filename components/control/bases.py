"""Per-unit bases of controllers, from the data of the machine that they control."""

from __future__ import annotations

from dataclasses import dataclass
from math import sqrt

from phfmu.components.electrical.machines.machine_data import MachineData


@dataclass(frozen=True)
class Bases:
    """Units of what a controller measures and sets; all 1 where nothing else is said: signals in per unit.

    Vn [V]: rms, line to line;  Sn [VA];  speed [rad/s] and torque [N.m]: of the shaft, torque = Sn/speed;  Ebase [V] and Ibase
    [A]: voltage and current of the field that give the rated voltage at rated speed without load on the air-gap line
    (Efd = 1: non-reciprocal per unit of IEEE Std 421.5).
    """

    Vn: float = 1.0
    Sn: float = 1.0
    speed: float = 1.0
    torque: float = 1.0
    Ebase: float = 1.0
    Ibase: float = 1.0


#: signals in per unit
PER_UNIT = Bases()


def bases(data: MachineData, Sn: float | None = None) -> Bases:
    """The bases of a machine; `Sn` [VA]: of the turbine where it differs from the machine's."""
    speed = data.omega / data.pole_pairs
    Ibase = sqrt(2.0 / 3.0) * data.Vn_rms_ll / (data.omega * abs(data.M_stator_rotor[0]))
    power = data.Sn if Sn is None else Sn
    return Bases(data.Vn_rms_ll, power, speed, power / speed, data.R_rotor[0] * Ibase, Ibase)
