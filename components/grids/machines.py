"""Synchronous machines of a grid from their dynamic data."""

from __future__ import annotations

from collections.abc import Mapping
from math import pi
from typing import Any, Literal

from phfmu.components.electrical.machines.machine_data import MachineData, MachineDataError
from phfmu.components.electrical.machines.machine_per_unit import from_per_unit
from phfmu.components.electrical.machines.main_flux import Saturation
from phfmu.importers.grid import Dynamics, Generator, GridError

#: models of machines, and what of their data the network has no place for, where it is not 0
MODELS = ("GENROU", "GENSAL", "GENCLS", "TWOAXIS")
DROPPED: Mapping[str, str] = {
    "D": "damping by the speed's deviation",
}
#: saturation of the main flux, of both axes or of d, where it is asked for
SATURATION: Mapping[str, str] = {"S1": "saturation at 1.0", "S12": "saturation at 1.2"}
SATURATED: Mapping[str, Literal["dq", "d"]] = {"GENROU": "dq", "GENSAL": "d"}


def machine_of(
    name: str, unit: Generator, data: Dynamics, kv: float, frequency: float, *, saturation: bool = False
) -> MachineData:
    """The machine set of a unit, with its quadratic saturation or not; GridError names bus, unit and what contradicts itself."""
    where = f"bus {unit.bus}, machine '{unit.id}' ({data.where})"
    given: dict[str, Any] = {k: v for k, v in data.values.items() if k not in DROPPED and k not in SATURATION}
    given.setdefault("ra", unit.r)
    if data.model == "GENCLS":
        given["xd1"] = unit.x
    model = data.model
    if model == "TWOAXIS":
        model, given = None, _two_axes(where, given, 2.0 * pi * frequency)
    try:
        iron = (
            Saturation(data.values["S1"], data.values["S12"], axes=SATURATED[data.model])
            if saturation and saturates(data)
            else None
        )
        return from_per_unit(
            name, model, Sn=unit.base * 1e6, Vn_rms_ll=kv * 1e3, fn=frequency, saturation=iron, **given
        )
    except MachineDataError as error:
        raise GridError(where, str(error).splitlines()) from None


def _two_axes(where: str, v: Mapping[str, float], omega: float) -> dict[str, Any]:
    """The circuit of a machine with one winding on each axis, model 1.1; 1.0 where Tq0' = 0 says that there is none on q."""
    if wrong := [
        f"{b} = {v[b]:g} is not above {a} = {v[a]:g}" for a, b in (("xl", "xd1"), ("xd1", "xd")) if v[b] <= v[a]
    ]:
        raise GridError(where, wrong)
    rotor = {}
    for axis in "dq":
        x, lower, T, xl = (v[k] for k in (f"x{axis}", f"x{axis}1", f"T{axis}10", "xl"))
        if not T:
            rotor[axis] = []
            continue
        if not xl < lower < x:
            raise GridError(where, [f"x{axis}1 = {lower:g} must be between xl = {xl:g} and x{axis} = {x:g}"])
        leakage = (x - xl) * (lower - xl) / (x - lower)
        rotor[axis] = [((x - xl + leakage) / (omega * T), leakage)]
    return {
        "H": v["H"], "xl": v["xl"], "ra": v["ra"], "xad": v["xd"] - v["xl"], "xaq": v["xq"] - v["xl"],
        "rotor_d": rotor["d"], "rotor_q": rotor["q"],
    }  # fmt: skip


def saturates(data: Dynamics) -> bool:
    """Whether the data have a saturation that is not 0."""
    return data.model in SATURATED and any(data.values.get(k) for k in SATURATION)


def dropped(data: Dynamics, *, saturation: bool = False) -> str:
    """The data that are not 0 and have no place in the network, in words; saturation where it was not asked for."""
    names = {**DROPPED, **({} if saturation else SATURATION)}
    return ", ".join(f"{k} = {data.values[k]:g} ({what})" for k, what in names.items() if data.values.get(k))
