"""phfmu info: states, ports and parameters with units.

phfmu info of a network with many members: how many of which kind, and how they are joined.
"""

from __future__ import annotations

import argparse
from collections import Counter
from collections.abc import Sequence
from typing import TYPE_CHECKING, Any

from phfmu.words import counted

if TYPE_CHECKING:
    from phfmu.declare.entries.parameter_limits import ParameterLimit
    from phfmu.declare.event import StateEvent
    from phfmu.declare.phdae import PHDAE
    from phfmu.declare.variable import Variable
    from phfmu.network.network import Network
    from phfmu.network.scene import Scene


#: members of a network that are told one by one
FEW = 24
#: names that stand for all of a kind
SOME = 3


def print_many(network: Network) -> None:
    """Members by kind, junctions by what they join, the number of variables."""
    from phfmu.network.couplings.choice.gathered import composed_words, gathered, junction_words
    from phfmu.network.couplings.choice.partitioned_network import PartitionedNetwork

    kinds = _kinds(network)
    print(f"members: {len(network.members)} of {counted(len(kinds), 'kind')}")
    kind_of = {}
    for label, names in kinds.items():
        kind_of |= dict.fromkeys(names, label)
        member = network.members[names[0]]
        print(f"  {len(names)} x {label}: {getattr(member, 'description', '')} ({_some(names)})".replace(":  (", ": ("))
        for line in _parameters([network.declared[n] for n in names if n in network.declared]):
            print(f"    {line}")
    print(f"order: {PartitionedNetwork(network).order()}")
    if line := composed_words(gathered(network)):
        print(line)
    words = junction_words(network)
    groups: dict[tuple[str, str, str], list[str]] = {}
    for j in network.junctions:
        ends = Counter(f"{kind_of[e.member]}.{e.port}" for e in j.ends)
        joined = ", ".join(f"{n} x {end}" if n > 1 else end for end, n in ends.items())
        common = f"common {j.shared}"
        groups.setdefault((joined, common, words[j.name]), []).append(j.name)
    print(f"junctions: {len(network.junctions)} of {counted(len(groups), 'kind')}")
    for (joined, common, exchange), names in groups.items():
        print(f"  {len(names)} x {joined}; {common}; {exchange} ({_some(names)})")
    if network.wires:
        print(f"signals: {len(network.wires)}")
    for what in ("states", "algebraics", "parameters"):
        n = sum(v.n for d in network.declared.values() for v in getattr(d, what))
        print(f"{what.replace('algebraics', 'algebraic variables')}: {n}")


def _kinds(network: Network) -> dict[str, list[str]]:
    """Kind -> members: declarations with the same equations, FMUs of the same file."""
    from phfmu.declare.entries.alike import first_alike

    found: dict[object, list[str]] = {}
    for name, d in network.declared.items():
        found.setdefault(first_alike(d), []).append(name)
    for name, unit in network.units.items():
        found.setdefault(unit.found, []).append(name)
    labels: dict[str, list[str]] = {}
    for kind, names in found.items():
        label = kind if isinstance(kind, str) else network.members[names[0]].name
        number = sum(known.partition(" (")[0] == label for known in labels)
        labels[f"{label} ({number + 1})" if number else label] = names
    return labels


def _some(names: Sequence[str]) -> str:
    return ", ".join(names) if len(names) <= SOME else f"{', '.join(names[: SOME - 1])}, .. {names[-1]}"


def _parameters(members: Sequence[PHDAE]) -> list[str]:
    """Parameters of a kind with their range."""
    lines = []
    for i, v in enumerate(members[0].parameters if members else ()):
        starts = [s for d in members for s in d.parameters[i].start]
        low, high = min(starts), max(starts)
        size = f"[1..{v.size}]" if v.size else ""
        lines.append(f"{v.name + size} = {low:g}{'' if low == high else f' .. {high:g}'} {v.unit}")
    return lines


def add_parser(verbs: Any) -> None:
    from phfmu.cli.codes import TARGET
    from phfmu.cli.options import add_grid, add_lenient

    parser = verbs.add_parser("info", help="states, ports, parameters with units")
    parser.add_argument("target", help=TARGET)
    parser.add_argument("--all", action="store_true",
                        help=f"every member, junction and variable of a network of more than {FEW} members")  # fmt: skip
    add_lenient(parser)
    add_grid(parser)
    parser.set_defaults(call=call)


def call(args: argparse.Namespace) -> int:
    from phfmu.cli.options import lenient_of, scene_of
    from phfmu.network.network import Network
    from phfmu.target import is_fmu

    lenient_of(args)
    if is_fmu(args.target):
        from phfmu.fmu.importer.inspect import fmu_info

        print(fmu_info(args.target), end="")
        return 0
    s = scene_of(args)
    told = _arguments(args.target)
    if isinstance(s.system, Network) and len(s.system.members) > FEW and not args.all:
        _print_run(s, s.name, s.description, told)
        print_many(s.system)
        print(f"all names: phfmu info {args.target} --all")
        return 0
    if s.units and isinstance(s.system, Network):
        _print_apart(s, s.system, told)
        return 0
    d = s.declaration()
    _print_run(s, d.name, s.description or d.description, told)
    if d.members != ("",):
        print(f"members: {', '.join(d.members)}")
    words = {}
    if isinstance(s.system, Network):
        from phfmu.network.couplings.choice.partitioned_network import PartitionedNetwork

        apart = PartitionedNetwork(s.system)
        print(f"order: {apart.order()}")
        words = apart.exchanged()
        for wire in s.system.wires:
            print(f"signal {wire}")
    if d.junctions:
        from phfmu.network.nodes import node_kinds

        kinds = node_kinds(d)
    for name, ends in d.junctions:
        newton = f"; newton: {words[name]}" if name in words else ""
        print(f"junction {name}: {', '.join(ends)}; {kinds[name]}{newton}")
    _print_declaration(d, args.target)
    return 0


def _print_run(s: Scene, name: str, description: str, arguments: list[str]) -> None:
    print(f"{name}: {description}".rstrip(": "))
    print(f"run: stop {s.stop:g} s, step {s.step:g} s, {len(s.events)} event{'s' if len(s.events) != 1 else ''}")
    for e in s.events:
        print(f"  t = {e.t:g} s: {e.name} = {e.value:g}")
    for line in arguments:
        print(line)


def _arguments(target: str) -> list[str]:
    """The arguments of the function that builds the target, and how to give them; none for other targets."""
    from functools import partial

    from phfmu.arguments import arguments, parsed
    from phfmu.components.library import EXAMPLES, TABLE, build, builder
    from phfmu.target import function_name, is_ssp

    name = function_name(target)
    if is_ssp(target) or name not in TABLE or ".py" in target:
        return []
    given = EXAMPLES.get(name, {}) | parsed(target, target).of(builder(name), target)
    found = arguments(builder(name), partial(build, name), given)
    family = TABLE[name][1].rpartition(".")[0]
    rows = [f"  {a.name:<28} {a.unit:<12} {a.value:<40} {a.about}".rstrip() for a in found]
    shell = f"phfmu run '{name}({found[0].name}=..)'; " if found else "none; "
    return [f"arguments ({shell}in Python: from {family} import {name}):", *rows]


def _print_apart(s: Scene, network: Network, arguments: list[str]) -> None:
    """A network with units, which is no one model."""
    from phfmu.fmu.importer.inspect import limit_lines, port_lines
    from phfmu.network.couplings.choice.gathered import composed_words, gathered, junction_words
    from phfmu.network.couplings.choice.partitioned_network import PartitionedNetwork
    from phfmu.network.wires import without_unit

    _print_run(s, s.name, s.description or network.description, arguments)
    print(f"members: {', '.join(network.members)}")
    if words := composed_words(gathered(network)):
        print(words)
    print(f"order: {PartitionedNetwork(network).order()}")
    exchanged = junction_words(network)
    for wire in network.wires:
        print(f"signal {wire}")
    for j in network.junctions:
        common = f"common {'effort' if j.kind == '0' else 'flow'}"
        print(f"junction {j.name}: {', '.join(map(str, j.ends))}; {common}; {exchanged[j.name]}")
    for name, file in network.units.items():
        print(f"\n{name}: {file.found}, FMI {file.interface.version}, {file.description}".rstrip(", "))
        print("\n".join([*port_lines(file.port_maps), *limit_lines(file.interface), *file.left_out]))
        if file.starts:
            print(f"set: {', '.join(f'{n} = {v:g}' for n, v in file.starts.items())}")
    for name, declaration in network.declared.items():
        print(f"\n{name}: {declaration.description}")
        _print_declaration(declaration, name)
    untold = without_unit(network.members, network.wires) if s.kept is None else ""
    for note in filter(None, (*s.notes, untold)):
        print(f"note: {note}")


def _print_declaration(d: PHDAE, target: str) -> None:
    """States, parameters, ports, constraints and observables."""
    from phfmu.declare.entries.parameter_limits import limits

    limit = limits(d)
    signals = tuple(v for v in d.parameters if v.signal)
    fixed = tuple(v for v in d.parameters if not v.signal)
    for title, variables in (("states", d.states), ("algebraic variables", d.algebraics), ("parameters", fixed),
                             ("signal inputs", signals)):  # fmt: skip
        if variables:
            print(f"{title}:")
        for v in variables:
            text = f"{v.description} {_limit(limit, v)}".strip()
            start = ", ".join(f"{x:g}" for x in v.start)
            size = f"[1..{v.size}]" if v.size else ""
            print(f"  {v.name + size:<28} {v.unit:<12} {start:<40} {text}".rstrip())
    if d.state_events:
        print("state events:")
    for e in d.state_events:
        print(f"  {_event(e)}")
    if d.switches:
        print("switches:")
    for s in d.switches:
        on = ", ".join(v.name for v in s.on)
        print(f"  {s.name:<28} {s.law}, {s.mode_name} = {s.mode.start[0]:g}, {s.multiplier.names()[0]} on {on}")
    if d.ports:
        print("ports (power positive into the component):")
    for p in d.ports:
        how = "given" if p.external else "from inside" if p.source is not None else "joined"
        size = f"[1..{p.size}]" if p.size else ""
        names = f"{p.name}.{p.domain.word(p.given)}{size}"
        print(f"  {p.name:<28} {p.domain.name:<14} input {names} [{p.input_unit}] ({how}), output [{p.output_unit}]")
    if d.constraints:
        print(_rank(d, target))
    if d.observables:
        print("observables:")
    for o in d.observables:
        size = f"[1..{o.expr.numel()}]" if o.expr.numel() > 1 else ""
        print(f"  {o.name + size:<28} {o.unit:<12} {o.description}".rstrip())


def _rank(declaration: PHDAE, target: str) -> str:
    """Rank of the constraints, which of them are redundant, and whose forces are unique."""
    from phfmu.declare.error import DeclarationError
    from phfmu.terms.rank import constraint_rank

    try:
        return constraint_rank(declaration).report()
    except DeclarationError:
        return f"constraints: their rank is not known, the declaration has problems (phfmu check {target})"


def _limit(limits: dict[str, ParameterLimit], v: Variable) -> str:
    """The limits of a parameter in brackets; entries of a vector share them as a rule."""
    found = dict.fromkeys(str(limits[n]) for n in v.names() if n in limits)
    return f"({'; '.join(found)})" if found else ""


def _event(e: StateEvent) -> str:
    """Guard, when it is armed, what it does."""
    which = {-1: "falls through zero", 0: "is zero", 1: "rises through zero"}[e.guard.direction]
    armed = "".join(f", {n} = {v:g}" for n, v in e.when.items())
    does = [f"{n} = {v:g}" for n, v in e.sets.items()]
    does += [f"{', '.join(v.name for v in e.jump.on)} jumps"] if e.jump is not None else []
    does += ["comes to rest: " + ", ".join(f"{n} = {v:g}" for n, v in e.rest.items())] if e.rest else []
    return f"{e.guard.name:<28} {which}{' with' + armed[1:] if armed else ''}: {'; '.join(does) or 'a step ends'}"
