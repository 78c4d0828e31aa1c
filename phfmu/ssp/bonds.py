"""Power ports among links: two ports whose variables are connected both ways are joined by a bond.

A unit says which of its variables are conjugate pairs and which way their flow counts (manifest, or a file beside it); the
factors of the connections say how the ports meet.  With g_e and g_f the factors on effort and flow, both counted into the
units, the bond creates no power if g_e g_f = -1: equal efforts (kind "0") or equal flows (kind "1").

Ports of units that tell none, derived from the ports they are connected with.

A unit of another tool whose variables are connected both ways with a port of known domain has a port of that domain there,
given the other way round.  The factors f_1, f_2 of the connections say which way its flow counts, because a connection creates no
power: f_1 f_2 s_known s = -1, with s = 1 for a flow into the unit and -1 for one out of it.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from math import isclose

from phfmu.declare.port import Given, conjugate
from phfmu.fmu.export.manifest import PortMap
from phfmu.ssp.flat import VariableLink
from phfmu.ssp.structure import SSPError

#: (member, port)
End = tuple[str, str]


@dataclass(frozen=True)
class Bond:
    """Two ports that are connected both ways; `kind`: of the junction that this makes."""

    a: End
    b: End
    kind: str


@dataclass(frozen=True)
class _Pin:
    """A scalar of a port: its end, entry and map."""

    end: End
    entry: int
    port: PortMap


def joins_plainly(given: Sequence[Given]) -> bool:
    """Whether connections of variables can say what a junction does: of two ports each gives what the other takes."""
    return len(given) == 2 and given[0] != given[1]


class PortVariables:
    """Ports of all units: which scalar of which port a variable is."""

    def __init__(self, ports: Mapping[str, Sequence[PortMap]]):
        self.maps = {(m, p.name): p for m, own in ports.items() for p in own}
        self._inputs: dict[tuple[str, str], _Pin] = {}
        self._outputs: dict[tuple[str, str], _Pin] = {}
        for end, p in self.maps.items():
            for names, table in ((p.inputs, self._inputs), (p.outputs, self._outputs), (p.step_outputs, self._outputs)):
                table.update({(end[0], n): _Pin(end, i, p) for i, n in enumerate(names)})

    def input(self, link: VariableLink) -> _Pin | None:
        return self._inputs.get((link.target, link.input))

    def output(self, link: VariableLink) -> _Pin | None:
        return self._outputs.get((link.source, link.output))


def bonds(links: Sequence[VariableLink], ports: PortVariables) -> tuple[list[Bond], list[VariableLink]]:
    """The bonds, and the links that are none.  SSPError for bonds that create power or leave pairs of a port open."""
    ways: dict[tuple[End, End], list[tuple[VariableLink, _Pin, _Pin]]] = {}
    rest = []
    for link in links:
        source, target = ports.output(link), ports.input(link)
        if source is None or target is None:
            rest.append(link)
        else:
            ways.setdefault((source.end, target.end), []).append((link, source, target))
    found = []
    for (a, b), there in ways.items():
        back = ways.get((b, a))
        if back is None or a == b:
            rest += [link for link, _, _ in there]
        elif a < b:
            found.append(_bond(a, b, there, back, ports))
    return found, rest


def _bond(
    a: End,
    b: End,
    there: list[tuple[VariableLink, _Pin, _Pin]],
    back: list[tuple[VariableLink, _Pin, _Pin]],
    ports: PortVariables,
) -> Bond:
    """The two ways between a and b as one bond."""
    pa, pb = ports.maps[a], ports.maps[b]
    for way, target in ((there, pb), (back, pa)):
        entries = sorted(t.entry for _, _, t in way)
        straight = all(s.entry == t.entry for _, s, t in way)
        if entries != list(range(len(target.inputs))) or not straight or len(pa.inputs) != len(pb.inputs):
            raise SSPError(
                f"{_name(a)} and {_name(b)} are joined by {', '.join(str(w[0]) for w in (*there, *back))}: connect each entry of "
                f"a port ({len(pa.inputs)} and {len(pb.inputs)} pairs) with the same entry of the other, both ways"
            )
    factors = [_factor(way, a, b) for way in (there, back)]
    # counted into both units, in units of the domain
    into = [factors[0] * pb.input_sign / pa.output_sign, factors[1] * pa.input_sign / pb.output_sign]
    if all(link.terminal for link, _, _ in (*there, *back)) and all(isclose(abs(g), 1.0, rel_tol=1e-9) for g in into):
        return Bond(a, b, "0" if pa.domain.common == "effort" else "1")  # by FMI 3.0: what flows in sums to zero
    if not isclose(into[0] * into[1], -1.0, rel_tol=1e-9) or not isclose(abs(into[0]), 1.0, rel_tol=1e-9):
        raise SSPError(_powered(a, b, there[0][0], back[0][0], pa, pb, into))
    effort = into[0] if pa.given == "flow" else into[1]
    return Bond(a, b, "0" if effort > 0 else "1")


def _factor(way: list[tuple[VariableLink, _Pin, _Pin]], a: End, b: End) -> float:
    found = {link.linear.factor for link, _, _ in way}
    if len(found) > 1 or any(link.linear.offset for link, _, _ in way):
        raise SSPError(f"{_name(a)} - {_name(b)}: one factor for all entries and no offset can join ports, not "
                       f"{', '.join(str(link) for link, _, _ in way)}")  # fmt: skip
    return found.pop()


def _powered(
    a: End, b: End, there: VariableLink, back: VariableLink, pa: PortMap, pb: PortMap, into: list[float]
) -> str:
    """Power is created, or a ratio would be needed that no junction has."""
    if not all(isclose(abs(g), 1.0, rel_tol=1e-9) for g in into):
        return (
            f"{there} and {back}: ports are joined with the factors 1 and -1; for a ratio put a transformer or a gear "
            "between them, or convert units by their definitions"
        )
    counts = ["out of it" if p.sign < 0 else "into it" for p in (pa, pb)]
    turns = -1 if counts[0] == counts[1] else 1
    flow, common = (back, there) if pa.given == pa.domain.summed else (there, back)
    return (
        f"{there} and {back} create power: the flow of {_name(a)} counts {counts[0]}, that of {_name(b)} {counts[1]}. "
        f"{flow.output} -> {flow.input} needs the factor {turns} (LinearTransformation), "
        f"{common.output} -> {common.input} the factor 1"
    )


def _name(end: End) -> str:
    return ".".join(end)


Maps = dict[str, tuple[PortMap, ...]]


def derived_ports(links: Sequence[VariableLink], maps: Mapping[str, tuple[PortMap, ...]]) -> tuple[Maps, list[str]]:
    """The ports of all units, and a line for each that was derived; only units without any get some."""
    told: Maps = dict(maps)
    lines = []
    for member, ports in maps.items():
        for known in ports:
            there = [
                k for n in known.outputs for k in links if (k.source, k.output) == (member, n) and not maps[k.target]
            ]
            back = [k for n in known.inputs for k in links if (k.target, k.input) == (member, n) and not maps[k.source]]
            names = {k.target for k in there} | {k.source for k in back}
            if len(names) != 1 or not len(there) == len(back) == len(known.inputs):
                continue
            (name,) = names
            port = _port(known, there, back, [p.name for p in told[name]])
            if port is not None:
                told[name] = (*told[name], port)
                way, pairs = "into" if port.sign > 0 else "out of", ", ".join((*port.inputs, *port.outputs))
                lines.append(
                    f"{pairs} of {name}: taken for a port like {member}.{known.name}, whose flow counts {way} {name}"
                )
    return told, lines


def _port(
    known: PortMap, there: Sequence[VariableLink], back: Sequence[VariableLink], taken: Sequence[str]
) -> PortMap | None:
    """The other side of a port; None where the factors are no signs."""
    factors = {(a.linear.factor, b.linear.factor) for a, b in zip(there, back, strict=True)}
    if len(factors) > 1 or any(k.linear.offset for k in (*there, *back)):
        return None
    f1, f2 = factors.pop()
    if abs(f1) != 1.0 or abs(f2) != 1.0 or abs(known.input_sign) != 1.0 or abs(known.output_sign) != 1.0:
        return None
    name = known.name if known.name not in taken else f"{known.name}_{len(taken)}"
    inputs, outputs = tuple(k.input for k in there), tuple(k.output for k in back)
    given, sign = conjugate(known.given), -1.0 / (f1 * f2 * known.sign)
    return PortMap(name, known.domain, given, inputs, outputs, sign=sign, vector=known.vector)
