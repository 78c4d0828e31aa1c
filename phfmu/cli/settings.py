"""--set NAME=VALUE: numbers of a component, or of the members of a network."""

from __future__ import annotations

import argparse
from dataclasses import replace
from typing import TYPE_CHECKING, Any

from phfmu.words import meant

if TYPE_CHECKING:
    from phfmu.network.junction import End
    from phfmu.network.network import Network


def add_settings(parser: argparse.ArgumentParser) -> None:
    """--set NAME=VALUE."""
    parser.add_argument("--set", action="append", default=[], metavar="NAME=VALUE",
                        help="parameter, start value of a state, or start of an input; @FILE: those of a file of phfmu fit; "
                        "may be repeated")  # fmt: skip


def settings(items: list[str]) -> dict[str, float]:
    """NAME=VALUE items; ValueError names the bad one, or two for one number."""
    out: dict[str, float] = {}
    for item in _read(items):
        name, sign, text = item.partition("=")
        try:
            value = float(text)
        except ValueError:
            value = float("nan")
        if not sign or value != value or value in (float("inf"), float("-inf")):
            raise ValueError(f"--set {item}: expected NAME=VALUE with a finite number")
        name = name.strip()
        bare = name.partition("[")[0]
        twice = [n for n in out if n == name or (n.partition("[")[0] == bare and bare in (n, name))]
        if twice:
            raise ValueError(f"--set {name} and --set {twice[0]} are for the same number; leave one of them out")
        out[name] = value
    return out


def _read(items: list[str]) -> list[str]:
    """The items, with those of files in the place of @FILE; ValueError for a file that has none."""
    found = list[str]()
    for item in items:
        if not item.startswith("@"):
            found.append(item)
            continue
        import json
        from pathlib import Path

        try:
            values = json.loads(Path(item[1:]).read_text())["values"]
            found += [f"{name}={float(value)!r}" for name, value in values.items()]
        except (ValueError, KeyError, TypeError, AttributeError):
            raise ValueError(
                f"--set {item}: expected a file of phfmu fit -o, whose `values` are names and numbers"
            ) from None
    return found


def with_settings(system: Any, values: dict[str, float]) -> Any:
    """`system` with these starts; KeyError for a name that it has not, or that a junction or signal feeds."""
    from phfmu.network.network import Network

    if not values:
        return system
    if not isinstance(system, Network):
        return system.with_starts(values)
    net = replace(system, members=dict(system.members))
    joined = {n: f"junction '{j.name}'" for j in net.junctions for e in j.ends for n in _inputs_of(net, e)}
    joined |= {f"{w.target}.{w.input}": f"signal {w.source}.{w.output}" for w in net.wires}
    for name, value in values.items():
        member, _, rest = name.partition(".")
        if name in joined:
            raise KeyError(f"'{name}' is fed by the {joined[name]}; it cannot be set")
        try:
            net.members[member] = net.members[member].with_starts({rest: value})
        except KeyError:
            raise KeyError(_unknown(net, name)) from None
    return net


def _inputs_of(net: Network, end: End) -> list[str]:
    """Names of the inputs of a port, of a unit those of its variables."""
    unit = net.units.get(end.member)
    maps = () if unit is None else (m for m in unit.port_maps if m.name == end.port)
    names = net.port_of(end).input_names() if unit is None else [n for m in maps for n in m.inputs]
    return [f"{end.member}.{n}" for n in names]


def _unknown(net: Network, name: str) -> str:
    """The message for a name that no member has, with close ones."""
    known = [f"{m}.{n}" for m, d in net.members.items() for n in d.settable_names()]
    members = f"members: {', '.join(net.members)}"
    return f"{net.name} has no parameter, state or input '{name}'; {meant(name, known, members)}"
