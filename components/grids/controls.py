"""Exciters, governors and stabilisers of the machines of a grid, from their dynamic data."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field

from phfmu import PHDAE, Network
from phfmu.components.control import bases, gast, hygov, ieeest, meter, sexs, tgov1
from phfmu.components.control.bases import Bases
from phfmu.components.electrical.machines.machine_data import MachineData
from phfmu.importers.grid import Bus, Dynamics, GridError

#: kinds of controllers: their models
KINDS: Mapping[str, tuple[str, ...]] = {
    "exciter": ("SEXS",),
    "governor": ("TGOV1", "HYGOV", "GAST"),
    "stabiliser": ("IEEEST",),
}
#: more room [1] than the power of the solved case, where a turbine's limit lies below that
ROOM = 1.05
Numbers = Mapping[str, float]


@dataclass
class MachineSetpoints:
    """The set points of a machine whose controllers are there, by what they set; models used, and lines about the data."""

    free: list[str]
    used: list[str] = field(default_factory=list)
    assumed: list[str] = field(default_factory=list)
    unused: list[str] = field(default_factory=list)


@dataclass(frozen=True)
class ControlledMachine:
    """The machine `name` at a bus with its voltage at an angle, which delivers `power` [1] of its rating."""

    name: str
    base: Bases
    bus: Bus
    angle: float
    power: float

    @property
    def label(self) -> str:
        """The end of its name, which its controllers have too."""
        return self.name.removeprefix("gen")


class Controllers:
    """Adds to a network the controllers that the dynamic data name: one meter for each bus whose voltage they read."""

    def __init__(self, net: Network, dynamics: Sequence[Dynamics], frequency: float):
        self.net, self.frequency = net, frequency
        #: signals, which the network is given all at once
        self.wires: list[tuple[str, str]] = []
        self.data: dict[tuple[int, str], list[Dynamics]] = {}
        for d in dynamics:
            self.data.setdefault((d.bus, d.id), []).append(d)

    def add(self, name: str, unit: str, machine: MachineData, bus: Bus, angle: float, power: float) -> MachineSetpoints:
        """Controllers of the machine `name`, which delivers `power` [1] of its rating; GridError for two of a kind.

        Members avr30, gov30, pss30 beside gen30, and meter30 at its bus.
        """
        found = {d.model: d for d in self.data.get((bus.number, unit), ())}
        out = MachineSetpoints([f"{name}.field.v", f"{name}.shaft.torque"])
        m = ControlledMachine(name, bases(machine), bus, angle, power)
        for kind, models in KINDS.items():
            there = [model for model in models if model in found]
            if len(there) > 1:
                where = f"bus {bus.number}, machine '{unit}'"
                raise GridError(where, [f"{' and '.join(there)} are both a {kind}; leave one of them out"])
            if there:
                make = {"exciter": self._exciter, "governor": self._governor, "stabiliser": self._stabiliser}[kind]
                make(m, found[there[0]], out)
        return out

    def _exciter(self, m: ControlledMachine, d: Dynamics, out: MachineSetpoints) -> None:
        v = d.values
        avr = f"avr{m.label}"
        self.net.add(avr, sexs(TA=v["TA_TB"] * v["TB"], TB=v["TB"], K=v["K"], TE=v["TE"], EMIN=v["Emin"], EMAX=v["Emax"],
                               base=m.base))  # fmt: skip
        measured = f"meter{m.bus.number}"
        if measured not in self.net.members:
            self.net.add(measured, meter(m.bus.kv * 1e3, m.base.Sn, self.frequency, frequency=False, angle=m.angle))
        self.wires.append((f"{measured}.voltage", f"{avr}.V"))
        self.wires.append((f"{avr}.field", f"{m.name}.field.v"))
        out.free[0] = f"{avr}.Vref"
        out.used.append(d.model)
        out.assumed.append("voltage measured at its bus with a lag of 0.02 s")

    def _governor(self, m: ControlledMachine, d: Dynamics, out: MachineSetpoints) -> None:
        gov, values = f"gov{m.label}", dict(d.values)
        for limit, least in _least(d.model, values, m.power).items():
            if values[limit] < least:
                out.assumed.append(f"{d.model}: {limit} raised to what the solved case needs")
                values[limit] = ROOM * least
        self.net.add(gov, GOVERNORS[d.model](values, m.base))
        self.wires.append((f"{m.name}.shaft.speed", f"{gov}.w"))
        self.wires.append((f"{gov}.torque", f"{m.name}.shaft.torque"))
        out.free[1] = f"{gov}.{'nref' if d.model == 'HYGOV' else 'Pref'}"
        out.used.append(d.model)

    def _stabiliser(self, m: ControlledMachine, d: Dynamics, out: MachineSetpoints) -> None:
        if not out.free[0].startswith("avr"):
            out.unused.append(f"{d.model}: there is no exciter for its signal")
            return
        values = {k: x for k, x in d.values.items() if k not in ("VCU", "VCL", "LSmax", "LSmin")}
        pss = f"pss{m.label}"
        self.net.add(pss, ieeest(**values, LSMAX=d.values["LSmax"], LSMIN=d.values["LSmin"], rest=1.0, u_base=m.base.speed,
                                 unit="rad/s"))  # fmt: skip
        self.wires.append((f"{m.name}.shaft.speed", f"{pss}.u"))
        self.wires.append((f"{pss}.Vs", f"avr{m.label}.Vs"))
        out.used.append(d.model)
        out.assumed.append("stabiliser of the speed")
        if d.values["VCU"] or d.values["VCL"]:
            out.unused.append(f"{d.model}: VCU, VCL")


def _least(model: str, v: Numbers, power: float) -> Numbers:
    """Limits that a turbine needs at least for its power [1] at rated speed."""
    if model == "HYGOV":
        return {"Gmax": power / v["At"] + v["qNL"]}
    return {"Vmax": power, "AT": power} if model == "GAST" else {"Vmax": power}


#: model -> its governor from the data by their names in files
GOVERNORS: Mapping[str, Callable[[Numbers, Bases], PHDAE]] = {
    "TGOV1": lambda v, b: tgov1(
        R=v["R"], T1=v["T1"], VMAX=v["Vmax"], VMIN=v["Vmin"], T2=v["T2"], T3=v["T3"], Dt=v["Dt"], base=b
    ),
    "HYGOV": lambda v, b: hygov(
        R=v["R"], r=v["r"], Tr=v["Tr"], Tf=v["Tf"], Tg=v["Tg"], VELM=v["VELM"], GMAX=v["Gmax"], GMIN=v["Gmin"],
        TW=v["TW"], At=v["At"], Dturb=v["Dturb"], qNL=v["qNL"], base=b,
    ),
    "GAST": lambda v, b: gast(
        R=v["R"], T1=v["T1"], T2=v["T2"], T3=v["T3"], AT=v["AT"], KT=v["KT"], VMAX=v["Vmax"], VMIN=v["Vmin"],
        Dturb=v["Dturb"], base=b,
    ),
}  # fmt: skip
