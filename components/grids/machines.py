"""Synchronous machines of a grid from their dynamic data."""

from __future__ import annotations

from collections.abc import Mapping

from phfmu.components.electrical.machines.machine_data import MachineData, MachineDataError
from phfmu.components.electrical.machines.machine_per_unit import NEEDED, from_per_unit
from phfmu.importers.grid import Dynamics, Generator, GridError

#: models of machines, and what of their data the network has no place for, where it is not 0
MODELS = ("GENROU", "GENSAL", "GENCLS")
DROPPED: Mapping[str, str] = {
    "D": "damping by the speed's deviation",
    "S1": "saturation at 1.0",
    "S12": "saturation at 1.2",
}


def machine_of(name: str, unit: Generator, data: Dynamics, kv: float, frequency: float) -> MachineData:
    """The machine set of a unit; GridError names bus, unit and what contradicts itself."""
    values = {
        k: v for k, v in data.values.items() if k in (*NEEDED[data.model], "H", "xl", "ra", "x0") and k not in DROPPED
    }
    values.setdefault("ra", unit.r)
    if data.model == "GENCLS":
        values["xd1"] = unit.x
    H = values.pop("H", None)
    try:
        return from_per_unit(
            name, data.model, Sn=unit.base * 1e6, Vn_rms_ll=kv * 1e3, fn=frequency, H=H, **values
        )  # fmt: skip
    except MachineDataError as error:
        where = f"bus {unit.bus}, machine '{unit.id}' ({data.where})"
        raise GridError(where, str(error).splitlines()) from None


def dropped(data: Dynamics) -> str:
    """The data that are not 0 and have no place in the network, in words."""
    return ", ".join(f"{k} = {data.values[k]:g} ({what})" for k, what in DROPPED.items() if data.values.get(k))
