"""Networks: members joined at junctions; every connection is checked when it is made.

A junction shares one variable c of the pair among its ports and sums the other to zero:
0-junction: common effort, sum of flows = 0 (Kirchhoff);  1-junction: common flow, sum of efforts = 0 (rigid joint).
With power positive into every component the powers of the joined ports add to zero.
"""

from __future__ import annotations

from collections.abc import Collection, Iterable, Mapping
from dataclasses import dataclass, field, replace
from functools import partial
from operator import is_
from os import PathLike
from typing import TYPE_CHECKING, Any

from phfmu.declare.expressions.units import parse_unit
from phfmu.declare.phdae import PHDAE
from phfmu.declare.port import Port
from phfmu.html import grid
from phfmu.network.compose import compose
from phfmu.network.junction import KIND, SHARED, ConnectionError, End, Junction, Kind
from phfmu.network.signal_ports import following, separate
from phfmu.network.wires import Wire, at_junction, in_order, wires_between
from phfmu.words import counted, meant

if TYPE_CHECKING:
    from phfmu.fmu.importer.unit_file import UnitFile


@dataclass(repr=False)
class Network:
    """Members and junctions under construction; `compose()` turns them into one PHDAE.

    A member is a PHDAE, or an FMU: a `UnitFile`, or a PHDAE that has its ports only.
    """

    name: str
    members: dict[str, PHDAE | UnitFile] = field(default_factory=dict)
    junctions: list[Junction] = field(default_factory=list)
    description: str = ""
    #: signals between members, each after those it depends on at once
    wires: list[Wire] = field(default_factory=list)
    #: the network as it was declared, where members of it are composed to one here (`gathered`)
    gathered_from: Network | None = field(default=None, compare=False)
    #: number of junctions that the ends were noted of, and these ends
    _counted: tuple[int, dict[End, str]] = field(default_factory=lambda: (0, {}), init=False, compare=False)

    def __repr__(self) -> str:
        sizes = ((len(self.members), "member"), (len(self.junctions), "junction"), (len(self.wires), "signal"))
        return f"<Network {self.name}: {', '.join(counted(n, noun) for n, noun in sizes if n) or 'empty'}>"

    def _repr_html_(self) -> str:
        """For notebooks: members and what joins them."""
        rows = [("member", name, getattr(m, "description", "") or m.name) for name, m in self.members.items()]
        rows += [("junction", j.name, ", ".join(map(str, j.ends))) for j in self.junctions]
        rows += [("signal", "", str(w)) for w in self.wires]
        return grid(repr(self)[1:-1], ("", "name", ""), rows, self.description)

    def add(
        self, name: str, member: PHDAE | UnitFile | str | PathLike[str], ports: Mapping[str, Any] | None = None
    ) -> None:
        """Add a member; its variables get the prefix `name.`.

        A member may be the path of an FMU; `ports` says which of its variables are conjugate pairs, see
        `phfmu.fmu.importer.ports.port_tables`, where neither it nor a file beside it does.
        Errors: ConnectionError if the name or object is taken; FMUError for a unit that cannot be read, or other ports than its.
        """
        if name in self.members:
            raise ConnectionError(self.name, f"there is a member '{name}' already", "give the new one another name")
        if any(map(partial(is_, member), self.members.values())):
            raise ConnectionError(self.name, f"'{name}' is the same object as another member", "build a second one")
        self._check_name("member", name)
        if isinstance(member, str | PathLike):
            from phfmu.fmu.importer.unit_file import unit_file

            member = unit_file(member, ports)
        elif ports is not None:
            raise ConnectionError(
                self.name, f"'{name}' has ports of its own", "leave out `ports`, which is for the path of an FMU"
            )
        self.members[name] = member

    def connect(self, a: str, b: str, *, name: str = "", signs: tuple[int, int] | None = None) -> Junction:
        """Plain bond between `member.port` and `member.port`: one side gives the effort, the other the flow.

        signs = (s_a, s_b) states u_a = s_a y_b and u_b = s_b y_a; they must be opposite.  Default: what the domain's
        ports share where they meet (electrical: same voltage; mechanical: same velocity).
        """
        ends = (self._end(a), self._end(b))
        pa, pb = (self._port(e) for e in ends)
        if ends[0] == ends[1]:
            raise ConnectionError(a, "is joined to itself", "name the port of another element as the other end")
        self._check_fit(ends)
        if pa.given == pb.given:
            other = f"{KIND[pa.given]}-junction"
            raise ConnectionError(
                f"{a} - {b}",
                f"both take the {pa.given} as input, so neither can give it to the other on a plain bond",
                f"join them at a junction: network.junction('name', ['{a}', '{b}'], kind='0' or '1') "
                f"({other} with the common {pa.given} as unknown)",
            )
        kind = self._default_kind(pa)
        if signs is not None:
            if signs[0] not in (1, -1) or signs[1] not in (1, -1) or signs[0] + signs[1] != 0:
                raise ConnectionError(
                    f"{a} - {b}",
                    f"u_a = {signs[0]:+d} y_b and u_b = {signs[1]:+d} y_a create power (C + C^T has entries "
                    f"{signs[0] + signs[1]})",
                    "give opposite signs: power is positive into both sides",
                )
            effort_sign = signs[0] if pa.given == "effort" else signs[1]
            kind = "0" if effort_sign == 1 else "1"
        return self._join(Junction(name or self._free_name(ends), kind, ends))

    def junction(self, name: str, ports: list[str] | tuple[str, ...], kind: Kind | None = None) -> Junction:
        """Join any number of ports; kind "0" common effort, "1" common flow, default by the domain."""
        ends = tuple(self._end(p) for p in ports)
        if len(ends) < 2:
            raise ConnectionError(
                f"junction '{name}'", f"joins {len(ends)} port; it needs at least two", "name another"
            )
        self._check_fit(ends)
        return self._join(Junction(name, kind or self._default_kind(self._port(ends[0])), ends))

    def signal(self, source: str, target: str, *, factor: float = 1.0, offset: float = 0.0) -> None:
        """Feed the signal input `member.name` from an observable, state or port output `member.name`: a value, no power.

        input = factor output + offset, both in one unit; vectors of equal size entry by entry.
        An input of a free port (`gen.field.v`) can be fed as well: its port becomes a source that follows the signal, with
        its work booked there.  A source `junction.name` is the common variable of a junction that a port there has as output.
        Composed, the input is the output at every instant. Members stepped apart exchange it at the nodes of their steps,
        which is the same (`separate`), or hold it over a step, at its value in the middle as the two steps before foretell
        it (order 2).
        Errors: ConnectionError for names and units that do not fit, an input that is fed already or that H depends on, and
        loops of outputs that depend on each other at once.
        """
        self._feed([(source, target)], factor, offset)

    def signals(self, pairs: Iterable[tuple[str, str]]) -> None:
        """Feed many signal inputs, (source, target) each, as `signal` does one: the order of all is found once."""
        self._feed(pairs, 1.0, 0.0)

    def _feed(self, pairs: Iterable[tuple[str, str]], factor: float, offset: float) -> None:
        members, wires = dict(self.members), list(self.wires)
        fed = {(w.target, w.input): w for w in wires}
        for source, target in pairs:
            source = at_junction(source, members, self.junctions)
            members |= self._following(members, target)
            for wire in wires_between(members, source, target):
                if first := fed.get((wire.target, wire.input)):
                    end = f"{wire.target}.{wire.input}"
                    raise ConnectionError(
                        f"signal input {end}",
                        f"{end} is fed by {first.source}.{first.output} already",
                        "connect one of the two",
                    )
                fed[wire.target, wire.input] = wire
                wires.append(replace(wire, factor=factor, offset=offset))
        self.wires = in_order(members, wires)
        self.members |= members

    def _following(self, members: Mapping[str, PHDAE | UnitFile], target: str) -> dict[str, PHDAE]:
        """The member with a source in the place of its free port whose input is the target; {} where it is none."""
        name, _, wanted = target.partition(".")
        model = members.get(name)
        if not isinstance(model, PHDAE):
            return {}
        for port in model.ports:
            names = port.input_names()
            if not port.external or wanted not in (names[0].partition("[")[0], *names):
                continue
            at = self._taken().get(End(name, port.name))
            if at is not None:
                reason = f"its port {name}.{port.name} is joined at '{at}', which gives it"
                raise ConnectionError(f"signal input {target}", reason, "feed an input of a free port")
            return {name: following(model, port)}
        return {}

    def compose(self) -> PHDAE:
        """The network as one PHDAE: the class is closed under interconnection.  ConnectionError names units in it."""
        if self.units:
            what = "is an FMU" if len(self.units) == 1 else "are FMUs"
            raise ConnectionError(
                self.name,
                f"{', '.join(self.units)} {what}, which cannot be composed into one model",
                "step the members apart (--coupling newton)",
            )
        return compose(self.name, self.declared, self.junctions, self.description, self.wires)

    def separate(self, held: Collection[str] = ()) -> dict[str, PHDAE]:
        """Declared members as they are stepped apart: named, and with ports for the signals that they exchange at nodes.

        Signals from and to units without values at nodes, and members that are `held`, which take none, stay parameters, which
        are held over a step.
        """
        there = {n: u.interface for n, u in self.units.items() if u.k}
        at_nodes = {*self.declared, *there} - set(held)
        wires = [
            w
            for w in self.wires
            if {w.source, w.target} <= at_nodes
            and (w.source not in there or w.output in there[w.source].sent)
            and (w.target not in there or w.input in there[w.target].taken)
        ]
        left = [w for w in self.wires if w not in wires]
        return {n: replace(d, name=n or d.name) for n, d in separate(self.declared, wires, left).items()}

    @property
    def declared(self) -> dict[str, PHDAE]:
        """Members that are declarations."""
        return {n: m for n, m in self.members.items() if isinstance(m, PHDAE)}

    @property
    def units(self) -> dict[str, UnitFile]:
        """Members that are FMUs."""
        return {n: m for n, m in self.members.items() if not isinstance(m, PHDAE)}

    @property
    def composable(self) -> bool:
        """Whether all members are declared."""
        return not self.units and all(
            m.states or m.algebraics or m.structure or m.dissipation for m in self.declared.values()
        )

    @property
    def to_compose(self) -> str:
        """Remedy that leads to one composed model, in words."""
        if self.units:
            return f"put declarations in the place of {', '.join(self.units)}: an FMU cannot be composed"
        return "leave out --coupling, --member and --parts, which step them apart"

    def port_of(self, end: End) -> Port:
        """The port an end of a junction refers to."""
        return self._port(end)

    # -- checks -----------------------------------------------------------------------------------------------------

    def _join(self, junction: Junction) -> Junction:
        self._check_name("junction", junction.name)
        taken = self._taken()
        for e in junction.ends:
            if e in taken:
                raise ConnectionError(
                    str(e),
                    f"is joined at '{taken[e]}' already",
                    "add it there as one more port of a single junction",
                )
        twice = [str(e) for e in junction.ends if junction.ends.count(e) > 1]
        if twice:
            alone = len(set(junction.ends)) == 1
            raise ConnectionError(
                f"junction '{junction.name}'",
                f"joins {twice[0]} to itself: it is listed {twice.count(twice[0])} times",
                "name the port of another element beside it" if alone else "list each port once",
            )
        if junction.name in self.members or any(j.name == junction.name for j in self.junctions):
            raise ConnectionError(
                self.name, f"the name '{junction.name}' is taken by another junction or member", "choose another"
            )
        self.junctions.append(junction)
        return junction

    def _taken(self) -> dict[End, str]:
        """End -> junction; goes on from where it was the last time, so that many junctions take linear time."""
        counted, taken = self._counted
        if counted > len(self.junctions):
            counted, taken = 0, {}
        taken.update({e: j.name for j in self.junctions[counted:] for e in j.ends})
        self._counted = len(self.junctions), taken
        return taken

    def _check_name(self, what: str, name: str) -> None:
        if not (name.isidentifier() and name.isascii()):
            raise ConnectionError(
                self.name,
                f"'{name}' is no name of a {what}",
                "a name is a letter followed by letters a-z, A-Z, digits, _",
            )

    def _end(self, text: str) -> End:
        member, _, port = text.partition(".")
        if member not in self.members:
            raise ConnectionError(self.name, f"has no member '{member}'", meant(member, self.members))
        names = [p.name for p in self.members[member].ports if p.external]
        if port not in names:
            raise ConnectionError(f"member '{member}'", f"has no free port '{port}'", meant(port, names))
        return End(member, port)

    def _port(self, end: End) -> Port:
        return self.members[end.member].port(end.port)

    def _default_kind(self, port: Port) -> Kind:
        return KIND[port.domain.common]

    def _check_fit(self, ends: tuple[End, ...]) -> None:
        first = self._port(ends[0])
        for end in ends[1:]:
            port = self._port(end)
            if port.n != first.n:
                raise ConnectionError(
                    f"{ends[0]} - {end}",
                    f"{ends[0]} has {first.n} scalar pairs, {end} has {port.n}",
                    "join ports of equal size",
                )
            for what in SHARED.values():
                mine, other = first.domain.unit(what), port.domain.unit(what)
                a, b = parse_unit(mine), parse_unit(other)
                if a.without_angle() != b.without_angle() or abs(a.factor / b.factor - 1) > 1e-12:
                    raise ConnectionError(
                        f"{ends[0]} - {end}",
                        f"unit mismatch: the {what} of {ends[0]} ({first.domain.name}) is in {mine}, of {end} "
                        f"({port.domain.name}) in {other}",
                        "connect ports of one domain and unit, or put a transformer or gyrator between them",
                    )

    def _free_name(self, ends: tuple[End, ...]) -> str:
        return "_".join(f"{e.member}_{e.port}" for e in ends).replace(".", "_")
