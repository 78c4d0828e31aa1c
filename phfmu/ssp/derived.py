"""Ports of units that tell none, derived from the ports they are connected with.

A unit of another tool whose variables are connected both ways with a port of known domain has a port of that domain there,
given the other way round.  The factors f_1, f_2 of the connections say which way its flow counts, because a connection creates no
power: f_1 f_2 s_known s = -1, with s = 1 for a flow into the unit and -1 for one out of it.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence

from phfmu.declare.port import conjugate
from phfmu.fmu.manifest import PortMap
from phfmu.ssp.flat import Link

Maps = dict[str, tuple[PortMap, ...]]


def derived_ports(links: Sequence[Link], maps: Mapping[str, tuple[PortMap, ...]]) -> tuple[Maps, list[str]]:
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


def _port(known: PortMap, there: Sequence[Link], back: Sequence[Link], taken: Sequence[str]) -> PortMap | None:
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
