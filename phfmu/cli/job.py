"""The run that a command line asks for: of one composed model, of members stepped apart, or of an FMU; its head line."""

from __future__ import annotations

import argparse
import sys
from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass, field, replace
from functools import cached_property
from math import inf, pi
from typing import TYPE_CHECKING, Any

from phfmu.cli.options import lenient_of, scene_of, scheme_of
from phfmu.cli.sensitivity import names_of, require_equal_steps, sensitive, sensitive_members
from phfmu.cli.settings import settings, with_settings
from phfmu.cli.sound import require_sound_scene
from phfmu.cli.stepping import (
    SIGNAL_WORDS,
    KernelReport,
    Stepping,
    as_fmu,
    asked_apart,
    engine_of,
    engines_asked,
    instance_of,
    isolate_of,
    kernels_asked,
    parts_asked,
    signals_asked,
    threads_asked,
    tolerance_of,
    with_unit_options,
)
from phfmu.network.couplings.coupling_table import AUTO, COUPLINGS, MONOLITHIC, NEWTON, CouplingRow
from phfmu.target import is_fmu

if TYPE_CHECKING:
    from phfmu.declare.phdae import PHDAE
    from phfmu.fmu.importer.unit_file import UnitFile
    from phfmu.network.couplings.choice.coupling_choice import NamedCoupling
    from phfmu.network.couplings.choice.partitioned_network import PartitionedNetwork
    from phfmu.network.couplings.signals.sampled_signals import SignalExchange
    from phfmu.network.couplings.stepper import Stepper
    from phfmu.network.members.member import Member
    from phfmu.network.members.rollback import Rollback
    from phfmu.network.network import Network
    from phfmu.network.scene import Scene
    from phfmu.schemes.scheme import Scheme


@dataclass(frozen=True)
class Job:
    """Run that a command line asks for; `label`: for the run's head line; `whole`: one composed model, not units or members;
    `notes`: what is not as asked for, one line each, also of what `build` finds;  `order`: of the whole, None where units do
    not tell it.

    `build` makes the stepper, which may compile: what can be refused before should be.
    """

    scene: Scene
    label: str
    whole: bool
    build: Callable[[], Stepper]
    notes: list[str] = field(default_factory=list)
    order: float | None = None
    kernels: KernelReport = field(default_factory=KernelReport)


def label(schemes: Sequence[Any], engine: str, coupling: str, most: float = inf, held: str = "") -> str:
    """Schemes, the order of the whole (at most `most`, and why: `held`), engine and coupling."""
    if not schemes:
        return f"units, {coupling}"
    names = " and ".join(dict.fromkeys(s.name for s in schemes))
    gradient = "" if schemes[0].gradient in ("per-term", "nodal") else f", {schemes[0].gradient}"
    own = min(s.order for s in schemes)
    why = f" (members of order {own}, {held})" if own > most else ""
    return f"{names}, order {min(most, own)}{why}{gradient}, {engine}, {coupling}"


def whole(args: argparse.Namespace, s: Scene, declaration: PHDAE, why: list[str]) -> Job:
    scheme, engine, made = scheme_of(args, declaration), engine_of(args.engine), KernelReport()
    kernels = kernels_asked(args, {engine})
    if getattr(args, "audit_detail", False):
        declaration = _by_term(declaration, scheme, engine)

    def build() -> Stepper:
        from phfmu.discretise.model import build_model
        from phfmu.network.couplings.monolithic import Monolithic

        if engine == "fmu":
            from phfmu.network.couplings.unit import FMUStepper

            return FMUStepper(as_fmu(declaration, scheme, args.fmi, s.step if args.step is None else args.step))
        model = build_model(declaration, scheme)
        instance = made.of(instance_of(model, engine, kernels, _steps(args, s)))
        return sensitive(args, model, instance) if names_of(args) else Monolithic(model, instance)

    head = label([scheme], f"{engine} engine", MONOLITHIC.name)
    head += _derived(args, engine)
    return Job(s, head, engine != "fmu", build, why, scheme.order, made)


def _derived(args: argparse.Namespace, engine: str) -> str:
    """Words of the head line about derivatives; raises ValueError for options that these do not go with."""
    names = names_of(args)
    if not names:
        return ""
    require_equal_steps(args, engine)
    return f", with derivatives by {', '.join(names)}"


def _steps(args: argparse.Namespace, s: Scene) -> float:
    """About how many steps the run takes."""
    stop, step = (getattr(s, n) if getattr(args, n) is None else getattr(args, n) for n in ("stop", "step"))
    return stop / step if step else 0.0


def _by_term(declaration: PHDAE, scheme: Scheme, engine: str) -> PHDAE:
    """The declaration with an account for each energy and resistor; ValueError where these are not told apart."""
    from phfmu.discretise.accounts import by_term

    if engine == "fmu":
        raise ValueError("--audit-detail: an FMU tells the sums of its energies only; take --engine native or python")
    if scheme.joint:
        raise ValueError("--audit-detail: a joint gradient makes one term of all energies; leave out one of the two")
    return by_term(declaration)


def unit(args: argparse.Namespace) -> Job:
    from phfmu.fmu.importer.reader import FMUInstance
    from phfmu.fmu.importer.unit_file import unit_file
    from phfmu.network.couplings.unit import FMUStepper
    from phfmu.network.scene import fmu_scene

    _refuse_compiled_in(args)
    file = unit_file(args.target).with_starts(settings(args.set))
    instance = FMUInstance(
        file.path, file.port_maps, starts=file.starts, isolate=isolate_of(args), tolerance=tolerance_of(args)
    )
    for line in (*file.left_out, *instance.lacking):
        print(f"phfmu: {args.target}: {line}", file=sys.stderr)
    words = ", ".join(w for w in (f"FMI {instance.interface.version}", instance.interface.scheme) if w)
    return Job(fmu_scene(instance), words, False, lambda: FMUStepper(instance))


def _refuse_compiled_in(args: argparse.Namespace) -> None:
    """Raise ValueError for options that an FMU has compiled in."""
    if asked_apart(args):
        raise ValueError(
            f"{args.target}: --member and --parts are for members of a network; an FMU has none to choose for"
        )
    whole = (row.name for row in COUPLINGS.values() if not row.apart)
    usual = {"order": (None, 2), "kernels": ("auto",), "scheme": ("auto",), "gradient": ("per-term",), "closure": (None,),
             "engine": ("auto", "fmu"), "coupling": (None, *whole)}  # fmt: skip
    for option, values in usual.items():
        asked = getattr(args, option, values[0])
        if asked not in values:
            raise ValueError(
                f"{args.target}: --{option} {asked} has no effect on an FMU, its method is compiled in; "
                "run the declaration, or export it with the options you want"
            )


@dataclass(frozen=True)
class _Members:
    """Members of a network that is stepped apart: how each is made, and whether it takes values at nodes."""

    args: argparse.Namespace
    network: Network
    coupling: NamedCoupling
    schemes: Mapping[str, Scheme]
    stepping: Stepping
    step: float
    tried: Mapping[str, Rollback]
    kernels: str
    made: KernelReport
    steps: float

    @cached_property
    def whole(self) -> PartitionedNetwork:
        """The exchange of members; those that handle events in themselves land alone."""
        from phfmu.network.couplings.choice.partitioned_network import PartitionedNetwork

        engine, parts = self.stepping.engine_of, self.stepping.parts_of
        inside = [n for n, s in self.schemes.items() if engine(n) == "fmu" or parts(n) > 1 or not s.node_values]
        return PartitionedNetwork(self.network, inside)

    @cached_property
    def held(self) -> Any:
        """Junctions and wires at which members take held values."""
        return self.whole.holding(self.at_nodes)

    @cached_property
    def with_impulses(self) -> set[str]:
        """Units that have to take impulses."""
        some = "fmu" in map(self.stepping.engine_of, self.schemes)
        return self.whole.kicked(self.args.project) if some and self.coupling.nodes else set()

    @cached_property
    def separate(self) -> Mapping[str, PHDAE]:
        return self.network.separate(self.held)

    def at_nodes(self, name: str) -> bool:
        if name in self.whole.landing_alone:
            return False
        in_unit = self.stepping.engine_of(name) == "fmu"
        return self.coupling.nodes and (_node_inputs if in_unit else _node_values)(self.schemes[name])

    def all(self, notes: list[str]) -> list[Member]:
        """All members in their order; what is to be said of units goes to `notes`."""
        return [self._made(name, d, notes) for name, d in self.network.members.items()]

    def _made(self, name: str, declaration: PHDAE | UnitFile, notes: list[str]) -> Member:
        from phfmu.declare.phdae import PHDAE
        from phfmu.discretise.model import build_model
        from phfmu.network.members.engine_member import EngineMember

        if not isinstance(declaration, PHDAE):
            from phfmu.network.members.unit_member import unit_member

            made, lines = unit_member(name, declaration, self.step, self.tried.get(name))
            notes.extend(lines)
            return made
        own, scheme, parts = self.separate[name], self.schemes[name], self.stepping.parts_of(name)
        if self.stepping.engine_of(name) == "fmu":
            from phfmu.network.members.fmu_member import FMUMember

            pushed = scheme.node_values and name in self.with_impulses and name not in self.whole.landing_alone
            nodes = self.at_nodes(name) and _node_inputs(scheme)
            return FMUMember(name, as_fmu(own, scheme, self.args.fmi, self.step / parts, nodes, pushed))
        model = build_model(own, scheme)
        instance = instance_of(model, self.stepping.engine_of(name), self.kernels, self.steps * parts)
        return EngineMember(name, model, self.made.of(instance), parts)


def apart(
    args: argparse.Namespace, s: Scene, declared: Network, name: str, why: list[str], tried: Mapping[str, Rollback]
) -> Job:
    from phfmu.network.couplings.choice.coupling_choice import named_coupling
    from phfmu.network.couplings.choice.gathered import composed_words
    from phfmu.network.couplings.choice.partitioned_network import circling_units, held_wires

    sequence = args.sequence and [name.strip() for name in args.sequence.split(",")]
    network = _gathered(args, declared)
    coupling = named_coupling(name, network, sequence, args.unconverged)
    schemes = {name: scheme_of(args, declaration, member=True) for name, declaration in network.declared.items()}
    own_engines = {member: engine_of(e) for member, e in engines_asked(args, declared).items()}
    stepping = Stepping(engine_of(args.engine), own_engines, parts_asked(args, declared))
    step = s.step if args.step is None else args.step
    threads, notes = threads_asked(args), [*why, *filter(None, [composed_words(network), _without_unit(s, declared)])]
    engines, made = {stepping.engine_of(n) for n in network.declared}, KernelReport()
    kernels = kernels_asked(args, engines)
    members = _Members(args, network, coupling, schemes, stepping, step, tried, kernels, made, _steps(args, s))
    wires = held_wires(network, members.held) if coupling.nodes else network.wires
    circling = circling_units(network, wires) if name == NEWTON.name else []
    holds, stuck = bool(wires), [n for n, found in tried.items() if not found.works]
    exchange, lines = signals_asked(args, network, stuck, holds, circling)
    notes += lines

    def build() -> Stepper:
        from phfmu.network.couplings.coupled import Coupled

        found = Coupled(network, members.all(notes), coupling.make, threads=threads, signals=exchange)
        return sensitive_members(args, found) if names_of(args) else found

    most, alone = _kept(members, exchange if holds else None)
    words = coupling.held if most <= coupling.order else f"units of order {most:g}"
    said = coupling.words + _number(network) + SIGNAL_WORDS[exchange]
    head = label(list(schemes.values()), stepping.words, said, most, words)
    head += _derived(args, stepping.words)
    notes += _order_lost(args.order, coupling, most, [members.whole.why_held(n) for n in alone])
    order = None if network.units or not schemes else min(most, *(scheme.order for scheme in schemes.values()))
    return Job(s, head, False, build, notes, order, made)


def _kept(members: _Members, exchange: SignalExchange | None) -> tuple[float, list[str]]:
    """The order that the members keep together at most, and which of them take held inputs; `exchange`: of held signals."""
    from phfmu.network.couplings.signals.sampled_signals import ORDER_OF_EVENTS, ORDERS

    network, coupling, whole = members.network, members.coupling, members.whole
    of_signals = min(inf if exchange is None else ORDERS[exchange], ORDER_OF_EVENTS if whole.events_by_signals else inf)
    alone = [n for n in whole.held if n in network.declared] if coupling.nodes else []
    return _most(coupling, members.schemes.values(), network.units.values(), of_signals, alone), alone


def _gathered(args: argparse.Namespace, network: Network) -> Network:
    """Beside units, declared members that meet are one composed member, but those that are asked for apart."""
    from phfmu.network.couplings.choice.gathered import gathered

    if args.sequence or args.engine == "fmu":
        return network
    return gathered(network, [item.partition("=")[0].strip() for item in (*args.member, *args.parts)])


def _without_unit(s: Scene, network: Network) -> str:
    """A line about signals whose unit of measurement is not known; packages of other tools have rules of their own."""
    from phfmu.network.wires import without_unit

    return without_unit(network.members, network.wires) if s.kept is None else ""


def _number(network: Network) -> str:
    """Number of members that are composed to one, for the head line."""
    from phfmu.network.couplings.choice.gathered import composed_members

    n = len(composed_members(network))
    return f" ({n} members composed)" if n else ""


def _node_values(scheme: Scheme) -> bool:
    return scheme.node_values


def _node_inputs(scheme: Scheme) -> bool:
    """Whether the unit of a member is exported with inputs at nodes: where steps have more than one."""
    return scheme.node_values and scheme.order > 2


def _most(
    coupling: NamedCoupling, schemes: Iterable[Scheme], units: Iterable[UnitFile], signals: float, held: Sequence[str]
) -> float:
    """The order that members stepped apart keep together at most; `signals`: that of what is held between them.

    held: declared members that take held inputs, since they land alone
    """
    nodes = [u.k for u in units]
    at_nodes = coupling.nodes and all(s.node_values for s in schemes) and all(nodes) and not held
    if at_nodes and signals == inf:
        return 2 * min(nodes, default=inf)
    return min(coupling.order, signals)


def _order_lost(asked: int | None, coupling: NamedCoupling, most: float, why: list[str]) -> list[str]:
    """A line if the coupling does not keep the order that was asked for, and lines that say why."""
    if asked is None or asked <= most:
        return []
    values = "one value per step, held" if most <= coupling.order else "as many values per step as its units take"
    return [
        f"--order {asked} is that of the members: {coupling.words} joins them by {values}, so the run is of order {most:g}",
        *why,
    ]


def job_of(args: argparse.Namespace) -> Job:
    """The scene, with its settings checked, and how it is stepped."""
    from phfmu.network.network import Network

    if args.fmi is not None and args.engine != "fmu" and not any(m.endswith("=fmu") for m in args.member):
        raise ValueError(f"--fmi {args.fmi} says what --engine fmu exports; add --engine fmu, or leave out --fmi")
    lenient_of(args)
    if is_fmu(args.target):
        _require_whole(args)
        if names_of(args):
            raise ValueError(
                f"{args.target}: --sensitivity is for declared models, composed or stepped apart; an FMU does not tell how its "
                "states follow its parameters: run the declaration, or leave it out"
            )
        return unit(args)
    s = scene_of(args)
    s, steady = _in_steady_steps(args, with_given(args, s))
    s = replace(s, system=with_unit_options(args, s.system))
    require_sound_scene(args, s)
    tried = _tried(args, s)
    row, why = _coupling(args, s, {n: found.words for n, found in tried.items() if not found.works})
    if asked_apart(args) and (not row.apart or not isinstance(s.system, Network)):
        raise ValueError(f"{args.target}: --member and --parts are for members of a network that are stepped apart")
    if not row.apart and args.threads is not None:
        raise ValueError(
            f"--threads {args.threads} is for members that are stepped apart (--coupling newton); this is one model"
        )
    if not row.apart and args.signals_held:
        raise ValueError(
            f"{args.target}: --signals-held is for members that are stepped apart (--coupling newton); in one model signals "
            "are exact at every instant"
        )
    if not row.apart:
        return whole(args, s, s.declaration(), [*s.notes, *steady, *why])
    _require_whole(args)
    if not isinstance(s.system, Network):
        raise ValueError(f"{args.target} is a single component; --coupling {row.name} needs a network of members")
    return apart(args, s, s.system, row.name, [*s.notes, *steady, *why], tried if row.kind.repeats else {})


def _require_whole(args: argparse.Namespace) -> None:
    """Raise ValueError for details that only one composed model has."""
    if getattr(args, "audit_detail", False):
        raise ValueError(
            f"{args.target}: --audit-detail tells energies and resistors of one composed model by themselves; members that are "
            "stepped apart, and FMUs, tell their sums: take --coupling monolithic, or leave it out"
        )


def with_given(args: argparse.Namespace, s: Scene) -> Scene:
    """The scene with the values of --set."""
    return replace(s, system=with_settings(s.system, settings(args.set)))


def _in_steady_steps(args: argparse.Namespace, s: Scene) -> tuple[Scene, list[str]]:
    """The scene from where the steps of its scheme stay, if it says so and no --set moves it; a line that tells it."""
    if s.steady is None or args.set:
        return s, []
    from phfmu.derivatives.steady_steps import steady_steps
    from phfmu.operating import NetworkPoint

    assert isinstance(s.steady, NetworkPoint)
    step, scheme = s.step if args.step is None else args.step, scheme_of(args, s.declaration())
    try:
        found = steady_steps(s.steady, scheme, step)
    except ValueError as failure:
        return s, [f"begins in the operating point of the equations: {failure}"]
    line = f"begins in the steady state of steps of {step:g} s, at {found.omega / (2.0 * pi):.9g} Hz"
    return replace(s, system=replace(found.started(), description=s.system.description)), [line]


def _tried(args: argparse.Namespace, s: Scene) -> dict[str, Rollback]:
    """Whether units can take steps back, where the coupling may ask it of them."""
    if not s.units:
        return {}
    from phfmu.network.couplings.choice.coupling_choice import repeats

    if not repeats(args.coupling):
        return {}
    from phfmu.network.members.unit_member import tried

    return tried(s.units, s.step if args.step is None else args.step)


def _coupling(args: argparse.Namespace, s: Scene, stuck: Mapping[str, str]) -> tuple[CouplingRow, list[str]]:
    """The coupling asked for, or the one that fits and the line that says why; one model without a word if nobody asked."""
    from phfmu.network.couplings.choice.coupling_choice import choose
    from phfmu.network.network import Network

    if args.coupling not in (None, AUTO.name):
        return COUPLINGS[args.coupling], []
    if not isinstance(s.system, Network):
        return MONOLITHIC, []
    found = choose(s.system, asked_apart(args), stuck)
    silent = args.coupling is None and found.row is MONOLITHIC
    return found.row, [] if silent else [f"coupling {found.row.name}: {found.why}"]
