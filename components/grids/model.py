"""A grid as a network: machines, lines, transformers, loads and plants of the table, and what its operating point meets."""

from __future__ import annotations

from collections.abc import Collection, Sequence
from dataclasses import dataclass, field
from functools import cached_property
from math import cos, inf, pi, sqrt
from typing import Literal, get_args

import numpy as np

from phfmu import Network, meant
from phfmu.components.electrical.breaker import breaker
from phfmu.components.electrical.capacitors import capacitor_network
from phfmu.components.electrical.machines.synchronous_machine import synchronous_machine
from phfmu.components.electrical.network.inverter import grid_following_inverter
from phfmu.components.electrical.network.lines import coupled_line
from phfmu.components.electrical.network.transformers import two_winding_transformer
from phfmu.components.electrical.phases import ALPHA
from phfmu.components.electrical.rlc_load import rlc_load
from phfmu.components.electrical.sources import balanced_current_source
from phfmu.components.electrical.switch import fault_resistor
from phfmu.components.grids.angles import angles, apart
from phfmu.components.grids.branches import identifier, named, unsound, vector_group
from phfmu.components.grids.controls import KINDS, Controllers
from phfmu.components.grids.machines import MODELS, dropped, machine_of
from phfmu.components.grids.report import Report, Row
from phfmu.importers.grid import Dynamics, Generator, Grid, GridError, Line, Transformer
from phfmu.operating import PQ, PV, Load, NetworkPoint, Slack, Specification, operating_point

#: kinds of buses of the table
LOAD, VOLTAGE, SLACK, ISOLATED = 1, 2, 3, 4
Plants = Literal["refuse", "currents", "inverters"]
#: limit of the current of an inverter, of its rating or of what it begins with if that is more
SPARE = 1.1
#: what stands for a generator without data
WORDS = {"currents": "a constant balanced current", "inverters": "a grid-following inverter of constant power"}
#: zero sequence of lines, of which such files know nothing, as a part of the positive one
ZERO = 3.0
#: limits of reactive power that are none
FREE = (-inf, inf)


@dataclass(frozen=True)
class GridModel:
    """The network of a grid, the specifications of its operating point, and the account of the import.

    Junctions bus1 .. bear the numbers of the buses; members line1_2, transformer1_2, gen1, plant1, load1
    (with the charging of the lines at bus 1, shunt1 where there is no load), reactor1, fault1.  Circuits in parallel, and
    several units at a bus, have their identifiers at the end: gen1_A, line1_2_2.
    """

    grid: Grid
    network: Network
    specifications: tuple[Specification, ...]
    report: Report
    #: by port of a unit that holds a voltage [Mvar]
    q_limits: dict[str, tuple[float, float]] = field(default_factory=dict)
    #: by plant that is an inverter its rated voltage [V] and power [VA]; in the operating point it is the current that it injects
    inverters: dict[str, tuple[float, float]] = field(default_factory=dict)

    def beyond(self) -> list[str]:
        """Lines about units at their limits of reactive power, or beyond them where nothing keeps them within."""
        told = []
        for port, (low, high) in self.q_limits.items():
            q, name = -self.point.power(port).imag / 1e6, port.partition(".")[0]
            if port in self.point.limited:
                told.append(f"{name} delivers its limit of {q:.6g} Mvar and does not hold the voltage of its bus")
            elif not low - 1e-6 <= q <= high + 1e-6:
                told.append(f"{name} delivers {q:.6g} Mvar, beyond its limits of {low:g} and {high:g} Mvar")
        return told

    @cached_property
    def point(self) -> NetworkPoint:
        """The operating point: voltages and powers of the table; NoOperatingPoint says what stands out."""
        return operating_point(self.network, self.specifications, self.grid.frequency)

    def started(self) -> Network:
        """The network in its operating point, with inverters in the place of the currents that stand for them."""
        net = self.point.started()
        for name, (V, S) in self.inverters.items():
            port = f"{name}.terminal"
            bus, s = self.point.junction_of(port), -self.point.power(port)
            U, angle = self.point.magnitude(bus), self.point.angle(bus)
            most = SPARE * max(1.0, abs(s) / U * V / S)
            made = grid_following_inverter(s.real, s.imag, V=V, S=S, fn=self.grid.frequency, most=most, angle=angle)
            net.members[name] = made.with_starts({"U": U, "Id": s.real / U, "Iq": -s.imag / U})
        return net

    def voltages(self) -> dict[int, complex]:
        """Phasors of the voltages at the operating point in per unit, by bus."""
        kv = self.grid.bus
        out = {}
        for junction in self.point.voltages:
            if junction.startswith("bus"):
                n = int(junction[3:])
                out[n] = self.point.magnitude(junction) / (kv[n].kv * 1e3) * np.exp(1j * self.point.angle(junction))
        return out

    def branch(self, words: str) -> str:
        """The member of a line or transformer: line5_7 also of line5-7 and line7-5; GridError for one that is not there."""
        there = [r.members[0] for r in self.report.rows if r.kind in ("line", "transformer")]
        return named(self.grid.name, words, there)

    def fault_conductance(self, bus: int, R: float) -> float:
        """The conductance in S of a fault of R [pu] at a bus."""
        return self.grid.base / (R * self.grid.bus[bus].kv ** 2)


def grid_model(
    grid: Grid,
    *,
    plants: Plants = "refuse",
    faults: Collection[int] = (),
    breakers: Collection[str] = (),
    controls: bool = True,
    q_limits: bool = False,
    saturation: bool = False,
) -> GridModel:
    """The network of a grid, begun flat at the voltages of the table, and what its operating point has to meet.

    plants: generators without data of a machine are refused, or constant balanced `currents`, or grid-following `inverters` of
      constant power; loads of negative power are as these
    faults: buses with a fault resistor, open;  breakers: lines (line1_2) whose poles can open
    controls: exciters, governors and stabilisers of the dynamic data; without them field voltages and torques are constant
    q_limits: a machine holds its voltage as far as its limits of q let it, else they are told where they are passed
    saturation: machines have the quadratic saturation of S(1.0) and S(1.2), else the account names what they leave out
    Raises GridError for devices without a part here, and for machines without data.
    """
    if plants not in get_args(Plants):
        raise ValueError(f"plants = '{plants}' is none of {', '.join(get_args(Plants))}")
    return _NetworkBuilder(grid, plants, faults, breakers, controls, q_limits, saturation).model()


@dataclass
class _Node:
    """A bus under construction: ends of members, powers in per unit, b [pu] of capacitors and of reactors, g of conductances."""

    ends: list[str] = field(default_factory=list)
    capacitance: float = 0.0
    reactance: float = 0.0
    conductance: float = 0.0
    demands: list[complex] = field(default_factory=list)


class _NetworkBuilder:
    """The network of a grid under construction: its nodes, members, rows of the account and specifications."""

    def __init__(
        self,
        grid: Grid,
        plants: Plants,
        faults: Collection[int],
        breakers: Collection[str],
        controls: bool,
        q_limits: bool,
        saturation: bool,
    ):
        self.grid, self.plants, self.limited, self.saturation = grid, plants, q_limits, saturation
        self.omega = 2.0 * pi * grid.frequency
        self.bus = grid.bus
        self.net = Network(identifier(grid.name) or "grid", description=f"{grid.name}: {len(grid.buses)} buses")
        self.controls = Controllers(self.net, grid.dynamics, grid.frequency) if controls else None
        self.rows: list[Row] = []
        self.notes: list[str] = [f"not represented: {line}" for line in grid.unused]
        self.specifications: list[Specification] = []
        self.q_limits: dict[str, tuple[float, float]] = {}
        self.inverters: dict[str, tuple[float, float]] = {}
        self.nodes = {b.number: _Node() for b in grid.buses if b.kind != ISOLATED}
        self.branches = self._named_branches()
        self.problems = [why for branch in self.branches.values() if (why := unsound(branch))]
        if self.problems:
            raise GridError(grid.name, self.problems)
        if lost := apart(grid, self.nodes, self.branches.values()):
            raise GridError(grid.name, [f"bus {n}: no branch in service joins it to the slack bus {grid.slack.number}; "
                                        "take it out (type 4)" for n in lost[:5]])  # fmt: skip
        self.angle = angles(grid, self.nodes, self.branches.values())
        #: bus -> the set of buses that series capacitors join it to
        self.joined = self._joined_buses()
        self.breakers = {named(grid.name, name, self.branches) for name in breakers}
        self.faults = [self._known(b) for b in faults]

    def model(self) -> GridModel:
        """All parts in the order in which a step's equations are read best: branches, buses, units."""
        for name, branch in self.branches.items():
            if isinstance(branch, Line):
                self._line(name, branch)
            else:
                self._transformer(name, branch)
        for shunt in self.grid.shunts:
            if shunt.on and shunt.bus in self.nodes:
                self._admittance(shunt.bus, shunt.g / self.grid.base, shunt.b / self.grid.base)
                self.rows.append(Row("shunt", f"shunt '{shunt.id}' at bus {shunt.bus}", (), "g, b"))
        self._units()
        self._demands()
        for number, node in self.nodes.items():
            self._at_bus(number, node)
        for group in {id(g): g for g in self.joined.values()}.values():
            self._capacitors(sorted(group))
        for number in self.faults:
            self.net.add(f"fault{number}", fault_resistor(nominal=self._peak(number)))
            self.nodes[number].ends.append(f"fault{number}.terminal")
        for number, node in self.nodes.items():
            if len(node.ends) > 1:
                self.net.junction(f"bus{number}", node.ends)
            else:
                self.problems.append(
                    f"bus {number} has {len(node.ends)} part; give its voltage something to act on (a load, the "
                    "charging of a line), or take it out (type 4)"
                )
        if self.problems:
            raise GridError(self.grid.name, self.problems)
        if self.controls:
            self.net.signals(self.controls.wires)
        self._account_of_dynamics()
        return GridModel(self.grid, self.net, tuple(self.specifications), Report(tuple(self.rows), tuple(self.notes)),
                         self.q_limits, self.inverters)  # fmt: skip

    # -- bases and names ---------------------------------------------------------------------------------------------

    def _peak(self, bus: int) -> float:
        return self.bus[bus].kv * 1e3 * sqrt(2.0 / 3.0)

    def _impedance(self, bus: int) -> float:
        return self.bus[bus].kv ** 2 / self.grid.base

    def _current(self, bus: int) -> float:
        """Peak of the current that carries the base power."""
        return sqrt(2.0 / 3.0) * self.grid.base * 1e3 / self.bus[bus].kv

    def _flat(self, bus: int) -> list[float]:
        """The voltages that a bus begins with: the magnitude of the table at the angle of the linear power flow."""
        v, angle = self._peak(bus) * self.bus[bus].vm, self.angle[bus]
        return [v * cos(angle - alpha) for alpha in ALPHA]

    def _known(self, number: int) -> int:
        if number not in self.nodes:
            words = [str(n) for n in self.nodes]
            raise GridError(self.grid.name, [f"no bus {number} in service for a fault; {meant(str(number), words)}"])
        return number

    def _named_branches(self) -> dict[str, Line | Transformer]:
        rows = [b for b in (*self.grid.lines, *self.grid.transformers) if b.on]
        off = len(self.grid.lines) + len(self.grid.transformers) - len(rows)
        if off:
            self.notes.append(f"out of service: {off} branches")
        out: dict[str, Line | Transformer] = {}
        labels = [f"{'line' if isinstance(b, Line) else 'transformer'}{b.i}_{b.j}" for b in rows]
        several = {n for n in labels if labels.count(n) > 1} if len(set(labels)) < len(labels) else set()
        for label, b in zip(labels, rows, strict=True):
            dead = [n for n in (b.i, b.j) if n not in self.nodes]
            if dead:
                self.notes.append(f"not represented: {label}, whose bus {dead[0]} is isolated")
                continue
            out[f"{label}_{identifier(b.circuit)}" if label in several else label] = b
        return out

    # -- branches ----------------------------------------------------------------------------------------------------

    def _begun(self, a: int, b: int) -> dict[str, float]:
        """Voltages that the ends of a branch begin with."""
        return {f"{end}.v[{k + 1}]": x for end, bus in (("a", a), ("b", b)) for k, x in enumerate(self._flat(bus))}

    def _line(self, name: str, line: Line) -> None:
        device = f"line {line.i}-{line.j} '{line.circuit}'"
        for bus, k in ((line.i, 0), (line.j, 2)):
            self._admittance(bus, line.ends[k], line.b / 2 + line.ends[k + 1])
        if line.x < 0:
            unused = f"r = {line.r:g} pu" if line.r else ""
            self.rows.append(Row("series capacitor", device, (self._group_name(self.joined[line.i]),), "x, b", unused))
            if name in self.breakers:
                self.problems.append(f"{device}: a series capacitor cannot be tripped; trip the line beside it")
            return
        Z, v, rated = self._impedance(line.j), self._peak(line.j), self._current(line.j)
        R, L = line.r * Z, line.x * Z / self.omega
        if name in self.breakers:
            part = breaker(R, L, i=rated, v=v)
            assumed = "zero sequence as the positive one; its charging stays at the buses when its poles open"
        else:
            part = coupled_line(R, L, R0=ZERO * R, L0=ZERO * L, v=v, rated=rated)
            assumed = f"r0 = {ZERO:g} r, x0 = {ZERO:g} x, b0 = b"
        self.net.add(name, part.with_starts(self._begun(line.i, line.j)))
        for bus, end in ((line.i, "a"), (line.j, "b")):
            self.nodes[bus].ends.append(f"{name}.{end}")
        self.rows.append(Row("line", device, (name,), "r, x, b", "ratings", assumed))

    def _transformer(self, name: str, t: Transformer) -> None:
        device = f"transformer {t.i}-{t.j} '{t.circuit}'"
        if name in self.breakers:
            self.problems.append(f"{device}: a transformer cannot be tripped; trip the lines beside it")
            return
        Va, Vb = (self.bus[n].kv * 1e3 for n in (t.i, t.j))
        group = vector_group(t, Va > Vb)
        part = two_winding_transformer(
            self.grid.base * 1e6, Va, Vb, f=self.grid.frequency, r=t.r, x=t.x, group=group, tap=t.tap
        )
        self.net.add(name, part.with_starts(self._begun(t.i, t.j)))
        for bus, end in ((t.i, "a"), (t.j, "b")):
            self.nodes[bus].ends.append(f"{name}.{end}")
        self._admittance(t.i, t.g, t.b)
        unused = f"vector group {t.group}, whose hour is not the angle" if t.group and t.group != group else ""
        assumed = "" if t.group == group else f"vector group {group}"
        self.rows.append(Row("transformer", device, (name,), "r, x, ratio, angle", unused, assumed))

    def _joined_buses(self) -> dict[int, set[int]]:
        """Bus -> buses that series capacitors join to it, itself among them."""
        joined: dict[int, set[int]] = {}
        for line in self._series_capacitors():
            both = joined.get(line.i, {line.i}) | joined.get(line.j, {line.j})
            joined |= dict.fromkeys(both, both)
        return joined

    def _series_capacitors(self) -> list[Line]:
        return [b for b in self.branches.values() if isinstance(b, Line) and b.x < 0]

    def _group_name(self, group: Collection[int]) -> str:
        return f"capacitors{min(group)}"

    def _capacitors(self, buses: list[int]) -> None:
        """The capacitors of buses that series capacitors join, in one member: their loops have no charge of their own."""
        place = {b: k for k, b in enumerate(buses)}
        C = np.diag([self.nodes[b].capacitance / self._impedance(b) / self.omega for b in buses])
        for line in self._series_capacitors():
            if line.i in place:
                k, l = place[line.i], place[line.j]
                own = 1.0 / (-line.x * self._impedance(line.j) * self.omega)
                C += np.array([[own * (int(r == k) - int(r == l)) * (int(c == k) - int(c == l)) for c in range(len(buses))]
                               for r in range(len(buses))])  # fmt: skip
        name, v = self._group_name(buses), [self._flat(b) for b in buses]
        try:
            member = capacitor_network(C.tolist(), v=v, nominal=self._peak(buses[0]), rated=self._current(buses[0]))
        except ValueError:
            self.problems.append(
                f"series capacitors between buses {', '.join(map(str, buses))}: none of these has the charging of a line, so "
                "that their voltages to ground are not determined; give one of them b"
            )
            return
        self.net.add(name, member)
        for b, k in place.items():
            self.nodes[b].ends.append(f"{name}.terminal{k + 1}")

    # -- buses -------------------------------------------------------------------------------------------------------

    def _admittance(self, bus: int, g: float, b: float) -> None:
        node = self.nodes[bus]
        node.conductance += g
        node.capacitance += max(b, 0.0)
        node.reactance += max(-b, 0.0)

    def _demands(self) -> None:
        """Loads in per unit at the voltage of the table, those of a bus together."""
        base = self.grid.base
        for d in self.grid.demands:
            if not d.on or d.bus not in self.nodes:
                continue
            v = self.bus[d.bus].vm
            s = complex(d.p + d.ip * v + d.yp * v**2, d.q + d.iq * v - d.yq * v**2) / base
            device = f"load '{d.id}' at bus {d.bus}"
            if s.real < 0:
                self._current_plant(f"feed{d.bus}_{identifier(d.id)}", d.bus, -s * base, abs(s) * base, None)
                self.rows.append(Row("load", device, (f"feed{d.bus}_{identifier(d.id)}",), "p, q", "",
                                     "negative power: a constant current"))  # fmt: skip
                continue
            self.nodes[d.bus].demands.append(s)
            self.rows.append(
                Row("load", device, (f"load{d.bus}",), "p, q", "", "constant impedance, R parallel to L or C")
            )

    def _at_bus(self, number: int, node: _Node) -> None:
        """R, L, C at a bus in one member: its load with the charging of lines; reactors stand beside it."""
        Z, s = self._impedance(number), sum(node.demands, 0j)
        flat = self._flat(number)
        charging = node.capacitance / Z / self.omega
        R = Z / s.real if s.real > 0 else None
        L = Z / s.imag / self.omega if s.imag > 0 else None
        C = (node.capacitance + max(-s.imag, 0.0)) / Z / self.omega or None
        if number in self.joined:
            C = None
            if s.imag < 0:
                self.problems.append(f"bus {number}: its load delivers {-s.imag * self.grid.base:g} Mvar beside a series "
                                     "capacitor, which has no part; give it as a shunt")  # fmt: skip
        name = f"load{number}" if s else f"shunt{number}"
        if R or L or C:
            self._load(name, number, R, L, C, flat)
            P, Q = s.real * self.grid.base * 1e6, s.imag * self.grid.base * 1e6
            if P or Q:
                self.specifications.append(Load(f"{name}.terminal", P=P, Q=Q, beside=charging))
        if node.reactance:
            self._load(f"reactor{number}", number, None, Z / node.reactance / self.omega, None, flat)
        if node.conductance > 0:
            self._load(f"conductance{number}", number, Z / node.conductance, None, None, flat)
        elif node.conductance < 0:
            self.problems.append(
                f"bus {number}: its shunts have g = {node.conductance:g} pu, which would feed the grid"
            )

    def _load(
        self, name: str, number: int, R: float | None, L: float | None, C: float | None, flat: Sequence[float]
    ) -> None:
        """A member of R, L, C that begins with the voltages `flat`, and currents of L a quarter turn behind."""
        i = [0.0] * 3 if L is None else [(flat[k - 2] - flat[k - 1]) / sqrt(3.0) / self.omega / L for k in range(3)]
        self.net.add(name, rlc_load(R, L, C, v=flat, i=i, nominal=self._peak(number)))
        self.nodes[number].ends.append(f"{name}.terminal")

    # -- machines and plants -----------------------------------------------------------------------------------------

    def _units(self) -> None:
        """The machines and plants; the largest machine of a bus whose voltage is known holds it, the others deliver P and Q."""
        data = {(d.bus, d.id): d for d in self.grid.dynamics if d.model in MODELS}
        units = [g for g in self.grid.generators if g.on and g.bus in self.nodes]
        at: dict[int, list[Generator]] = {}
        for g in units:
            at.setdefault(g.bus, []).append(g)
        if self.grid.slack.number not in at:
            self.problems.append(f"slack bus {self.grid.slack.number}: no generator in service")
        missing = [g for g in units if (g.bus, g.id) not in data]
        if missing and self.plants == "refuse":
            self.problems += [
                f"bus {g.bus}, machine '{g.id}': no dynamic data ({', '.join(MODELS)}); give them, or take plants without "
                "data as constant currents or inverters (--plants currents, plants='inverters')" for g in missing
            ]  # fmt: skip
            return
        for number, there in at.items():
            first = min(there, key=lambda g: ((g.bus, g.id) not in data, -g.base))
            for g in there:
                name = f"{'gen' if (g.bus, g.id) in data else 'plant'}{number}"
                name = f"{name}_{identifier(g.id)}" if len(there) > 1 else name
                holds = self.bus[number].kind in (VOLTAGE, SLACK) and g is first
                self._unit(name, g, data.get((g.bus, g.id)), holds)

    def _unit(self, name: str, g: Generator, data: Dynamics | None, holds: bool) -> None:
        device, kind = f"generator '{g.id}' at bus {g.bus}", "machine" if data else "plant"
        used = ("p, voltage, limits of q" if self.limited else "p, voltage") if holds else "p, q"
        remote = f"voltage held at bus {g.holds}" if g.holds != g.bus else ""
        if data is None:
            if self._current_plant(name, g.bus, complex(g.p, g.q), g.base, holds, g.q_limits):
                self.rows.append(Row(kind, device, (name,), used, remote, f"no machine data: {WORDS[self.plants]}"))
            else:
                self.rows.append(Row(kind, device, (), "nothing: p = q = 0"))
            return
        try:
            machine = machine_of(name, g, data, self.bus[g.bus].kv, self.grid.frequency, saturation=self.saturation)
        except GridError as error:
            self.problems += [str(error)]
            return
        model = synchronous_machine(machine)
        theta = next(v for v in model.states if v.name == "theta").start[0] + self.angle[g.bus]
        self.net.add(name, model.with_starts({"theta": theta}))
        self.nodes[g.bus].ends.append(f"{name}.terminal")
        unused, assumed, free = [remote, dropped(data, saturation=self.saturation)], ["field and torque constant"], None
        if self.controls:
            try:
                found = self.controls.add(name, g.id, machine, self.bus[g.bus], self.angle[g.bus], g.p / g.base)
            except (GridError, ValueError) as error:
                self.problems += str(error).splitlines()
                return
            constant = [w for w, n in zip(("field", "torque"), found.free, strict=True) if n.startswith(f"{name}.")]
            free, used = (found.free[0], found.free[1]), ", ".join([used, data.model, *found.used])
            assumed = [*([f"{' and '.join(constant)} constant"] if constant else []), *found.assumed]
            unused += found.unused
            meter = f"meter{g.bus}.a"
            if "meter" + str(g.bus) in self.net.members and meter not in self.nodes[g.bus].ends:
                self.nodes[g.bus].ends.append(meter)
        else:
            used = f"{used}, {data.model}"
        if machine.saturation is not None:
            used += ", S(1.0), S(1.2)"
        self._specify(f"{name}.terminal", g.bus, complex(g.p, g.q), holds, free, g.q_limits)
        self.rows.append(Row(kind, device, (name,), used, "; ".join(filter(None, unused)), "; ".join(assumed)))

    def _current_plant(
        self, name: str, bus: int, s: complex, size: float, holds: bool | None, q_limits: tuple[float, float] = FREE
    ) -> bool:
        """A balanced current that meets P and Q (or the voltage); False where it would be no current at all."""
        if not s and not holds:
            return False
        v, i = self._peak(bus), sqrt(2.0 / 3.0) * size * 1e3 / self.bus[bus].kv
        z = (s * 1e6 / (1.5 * v)).conjugate()
        self.net.add(name, balanced_current_source(z, self.grid.frequency, v=v, i=i))
        self.nodes[bus].ends.append(f"{name}.terminal")
        if self.plants == "inverters":
            self.inverters[name] = self.bus[bus].kv * 1e3, size * 1e6
        free = (f"{name}.phasor[1]", f"{name}.phasor[2]")
        self._specify(f"{name}.terminal", bus, s, bool(holds), free, q_limits)
        return True

    def _specify(
        self, port: str, bus: int, s: complex, holds: bool, free: tuple[str, str] | None, q_limits: tuple[float, float]
    ) -> None:
        V = self.bus[bus].vm * self.bus[bus].kv * 1e3
        if holds and self.bus[bus].kind != SLACK:
            self.q_limits[port] = q_limits
        if holds and self.bus[bus].kind == SLACK:
            self.specifications.append(Slack(port, free, V=V, angle=self.bus[bus].va))
        elif holds:
            Q = (q_limits[0] * 1e6, q_limits[1] * 1e6) if self.limited else FREE
            self.specifications.append(PV(port, free, P=s.real * 1e6, V=V, Q=Q))
        else:
            self.specifications.append(PQ(port, free, P=s.real * 1e6, Q=s.imag * 1e6))

    def _known_models(self) -> set[str]:
        return {*MODELS, *(m for models in KINDS.values() for m in models if self.controls)}

    def _account_of_dynamics(self) -> None:
        """Dynamic data that no part takes, by model."""
        count: dict[str, int] = {}
        for d in self.grid.dynamics:
            if d.model not in self._known_models():
                count[d.model] = count.get(d.model, 0) + 1
        self.notes += [f"not represented: {n} {model}" for model, n in count.items()]
