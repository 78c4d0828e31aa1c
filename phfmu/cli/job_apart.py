"""A run of members that are stepped apart and coupled."""

from __future__ import annotations

import argparse
from collections.abc import Iterable, Mapping, Sequence
from math import inf
from typing import TYPE_CHECKING

from phfmu.cli.engines import as_fmu, engine_of, instance_of
from phfmu.cli.job import Job, label
from phfmu.cli.options import scheme_of
from phfmu.cli.stepping import Stepping, engines_asked, parts_asked, threads_asked
from phfmu.network.couplings.coupling_table import NEWTON

if TYPE_CHECKING:
    from phfmu.declare.phdae import PHDAE
    from phfmu.fmu.unit_file import UnitFile
    from phfmu.network.couplings.held_signals import SignalExchange
    from phfmu.network.couplings.named import Named
    from phfmu.network.couplings.stepper import Stepper
    from phfmu.network.junctions.network import Network
    from phfmu.network.members.member import Member
    from phfmu.network.members.rollback import Rollback
    from phfmu.network.scene import Scene
    from phfmu.schemes.scheme import Scheme

#: of signals, for the head line
SAID: dict[SignalExchange, str] = {"extrapolated": "", "held": ", signals held", "agreed": ", signals iterated"}


def apart(
    args: argparse.Namespace, s: Scene, declared: Network, name: str, why: list[str], tried: Mapping[str, Rollback]
) -> Job:
    from phfmu.network.couplings.apart import Apart, held_wires
    from phfmu.network.couplings.gathered import composed_words
    from phfmu.network.couplings.held_signals import ORDER_OF_EVENTS, ORDERS
    from phfmu.network.couplings.named import named_coupling

    sequence = args.sequence and [name.strip() for name in args.sequence.split(",")]
    network = _gathered(args, declared)
    coupling = named_coupling(name, network, sequence, args.unconverged)
    schemes = {name: scheme_of(args, declaration, member=True) for name, declaration in network.declared.items()}

    own_engines = {member: engine_of(e) for member, e in engines_asked(args, declared).items()}
    stepping = Stepping(engine_of(args.engine), own_engines, parts_asked(args, declared))
    step = s.step if args.step is None else args.step
    threads, notes = threads_asked(args), [*why, *filter(None, [composed_words(network), _without_unit(s, declared)])]

    inside = [n for n, scheme in schemes.items() if stepping.engine_of(n) == "fmu" or stepping.parts_of(n) > 1
              or not scheme.node_values]  # fmt: skip
    some_fmu, whole = "fmu" in map(stepping.engine_of, schemes), Apart(network, inside)
    with_impulses = whole.kicked(args.project) if some_fmu and coupling.nodes else set()

    def at_nodes(name: str) -> bool:
        if name in whole.landing_alone:
            return False
        in_unit = stepping.engine_of(name) == "fmu"
        return coupling.nodes and (_node_inputs if in_unit else _node_values)(schemes[name])

    held = whole.holding(at_nodes)
    separate = network.separate(held)

    def member(name: str, declaration: PHDAE | UnitFile) -> Member:
        from phfmu.declare.phdae import PHDAE
        from phfmu.discretise.model import build_model
        from phfmu.network.members.engine_member import EngineMember

        if not isinstance(declaration, PHDAE):
            from phfmu.network.members.unit_member import unit_member

            made, lines = unit_member(name, declaration, step, tried.get(name))
            notes.extend(lines)
            return made
        own, parts = separate[name], stepping.parts_of(name)
        if stepping.engine_of(name) == "fmu":
            from phfmu.network.members.fmu_member import FMUMember

            alone, scheme = name in whole.landing_alone, schemes[name]
            extra = at_nodes(name) and _node_inputs(scheme), not alone and scheme.node_values and name in with_impulses
            return FMUMember(name, as_fmu(own, schemes[name], args.fmi, step / parts, *extra))
        model = build_model(own, schemes[name])
        return EngineMember(name, model, instance_of(model, stepping.engine_of(name)), parts)

    def build() -> Stepper:
        from phfmu.network.couplings.coupled import Coupled

        return Coupled(
            network,
            [member(name, d) for name, d in network.members.items()],
            coupling.make,
            threads=threads,
            signals=exchange,
        )

    holds = bool(network.wires) and (not coupling.nodes or bool(held_wires(network, held)))
    stuck = [n for n, found in tried.items() if not found.works]
    exchange: SignalExchange
    exchange, lines = _signals(args, network, stuck, holds)
    notes += lines
    of_signals = min(ORDERS[exchange] if holds else inf, ORDER_OF_EVENTS if whole.events_by_signals else inf)
    alone = [n for n in whole.held if n in network.declared] if coupling.nodes else []
    most = _most(coupling, schemes.values(), network.units.values(), of_signals, alone)
    words = coupling.held if most <= coupling.order else f"units of order {most:g}"
    said = coupling.words + _number(network) + SAID[exchange]
    head = label(list(schemes.values()), stepping.words, said, most, words)
    notes += _order_lost(args.order, coupling, most, [whole.why_held(n) for n in alone])
    order = None if network.units or not schemes else min(most, *(scheme.order for scheme in schemes.values()))
    return Job(s, head, False, build, notes, order)


def _gathered(args: argparse.Namespace, network: Network) -> Network:
    """Beside units, declared members that meet are one composed member, but those that are asked for apart."""
    from phfmu.network.couplings.gathered import gathered

    if args.sequence or args.engine == "fmu":
        return network
    return gathered(network, [item.partition("=")[0].strip() for item in (*args.member, *args.parts)])


def _without_unit(s: Scene, network: Network) -> str:
    """A line about signals whose unit of measurement is not known; packages of other tools have rules of their own."""
    from phfmu.network.junctions.wires import without_unit

    return without_unit(network.members, network.wires) if s.kept is None else ""


def _number(network: Network) -> str:
    """How many members are composed to one, for the head line."""
    from phfmu.network.couplings.gathered import composed_members

    n = len(composed_members(network))
    return f" ({n} members composed)" if n else ""


def _node_values(scheme: Scheme) -> bool:
    return scheme.node_values


def _node_inputs(scheme: Scheme) -> bool:
    """Whether the unit of a member is exported with inputs at nodes: where steps have more than one."""
    return scheme.node_values and scheme.order > 2


def _signals(
    args: argparse.Namespace, network: Network, stuck: Sequence[str], held: bool
) -> tuple[SignalExchange, list[str]]:
    """What signals are over a step if some are `held`, and lines about what they are not: `stuck` units cannot take steps back.

    ValueError where they are to be held and there are none.
    """
    if args.signals_held and not held:
        raise ValueError(
            f"{args.target}: --signals-held is for signals that members hold over steps, and there are none"
        )
    if args.signals_held:
        return "held", []
    ends = {end for w in network.wires for end in (w.source, w.target)}
    if args.coupling != NEWTON.name or not held or not ends & set(network.units):
        return "extrapolated", []
    if stuck:
        return "extrapolated", [f"signals are not iterated: {', '.join(stuck)} cannot take steps back"]
    return "agreed", []


def _most(
    coupling: Named, schemes: Iterable[Scheme], units: Iterable[UnitFile], signals: float, held: Sequence[str]
) -> float:
    """The order that members stepped apart keep together at most; `signals`: that of what is held between them.

    held: declared members that take held inputs, since they land alone
    """
    nodes = [u.k for u in units]
    at_nodes = coupling.nodes and all(s.node_values for s in schemes) and all(nodes) and not held
    if at_nodes and signals == inf:
        return 2 * min(nodes, default=inf)
    return min(coupling.order, signals)


def _order_lost(asked: int | None, coupling: Named, most: float, why: list[str]) -> list[str]:
    """A line if the coupling does not keep the order that was asked for, and lines that say why."""
    if asked is None or asked <= most:
        return []
    values = "one value per step, held" if most <= coupling.order else "as many values per step as its units take"
    return [
        f"--order {asked} is that of the members: {coupling.words} joins them by {values}, so the run is of order {most:g}",
        *why,
    ]
