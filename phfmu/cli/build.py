"""Build the stepper that a command line asks for."""

from __future__ import annotations

import argparse
import sys
from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass, field, replace
from math import inf
from typing import TYPE_CHECKING, Any

from phfmu.cli.options import require_sound, scheme_of, settings
from phfmu.cli.stepping import Stepping, asked_apart, engines_asked, parts_asked
from phfmu.network.couplings.coupling_names import EXPLICIT
from phfmu.target import is_fmu, scene
from phfmu.words import meant

if TYPE_CHECKING:
    from phfmu.declare.phdae import PHDAE
    from phfmu.fmu.unit_file import UnitFile
    from phfmu.network.couplings.named import Named
    from phfmu.network.couplings.stepper import Stepper
    from phfmu.network.junctions.junction import End
    from phfmu.network.junctions.network import Network
    from phfmu.network.members.member import Member
    from phfmu.network.members.rollback import Rollback
    from phfmu.network.scene import Event, Scene
    from phfmu.schemes.scheme import Scheme


#: s that a call into a unit in a process of its own may take, unless told
ISOLATE = 60.0


@dataclass(frozen=True)
class Job:
    """What a command line asks to run; `label`: for the run's head line; `whole`: one composed model, not units or members;
    `notes`: what is not as asked for, one line each, also of what `build` finds.

    `build` makes the stepper, which may compile: what can be refused before should be.
    """

    scene: Scene
    label: str
    whole: bool
    build: Callable[[], Stepper]
    notes: list[str] = field(default_factory=list)


def job_of(args: argparse.Namespace) -> Job:
    """The scene, with its settings checked, and how it is stepped."""
    from phfmu.network.junctions.network import Network

    if args.fmi is not None and args.engine != "fmu" and not any(m.endswith("=fmu") for m in args.member):
        raise ValueError(f"--fmi {args.fmi} says what --engine fmu exports; add --engine fmu, or leave out --fmi")
    if is_fmu(args.target):
        return _fmu_run(args)
    s = scene(args.target)
    s = replace(s, system=_with_settings(s.system, settings(args.set)))
    s = replace(s, system=_isolated(args, s.system))
    require_sound_scene(args, s)
    tried = _tried(args, s)
    name, why = _coupling(args, s, {n: found.words for n, found in tried.items() if not found.works})
    if asked_apart(args) and (name == "monolithic" or not isinstance(s.system, Network)):
        raise ValueError(f"{args.target}: --member and --parts are for members of a network that are stepped apart")
    if name == "monolithic":
        return _monolithic(args, s, s.declaration(), why)
    if not isinstance(s.system, Network):
        raise ValueError(f"{args.target} is a single component; --coupling {name} needs a network of members")
    return _coupled(args, s, s.system, name, [*s.notes, *why], {} if name in EXPLICIT else tried)


def composed(args: argparse.Namespace) -> Scene:
    """The scene of a verb that takes one composed model, with its settings; ValueError if there are units in it."""
    if is_fmu(args.target):
        raise ValueError(
            f"{args.target} is a unit; phfmu {args.verb} takes what is declared: a name of the library or file.py:function"
        )
    s = scene(args.target)
    if s.units:
        raise ValueError(
            f"{args.target} has units in it ({', '.join(s.units)}); phfmu {args.verb} takes what is declared"
        )
    return replace(s, system=_with_settings(s.system, settings(args.set)))


def _isolated(args: argparse.Namespace, system: Any) -> Any:
    """The system with its units in processes of their own, if that is asked for."""
    from phfmu.network.junctions.network import Network

    seconds = isolate_of(args)
    if seconds is None:
        return system
    if not isinstance(system, Network) or not system.units:
        raise ValueError(f"{args.target}: --isolate is for FMUs, and there is none in it")
    own = {n: replace(file, isolate=seconds) for n, file in system.units.items()}
    return replace(system, members={n: own.get(n, m) for n, m in system.members.items()})


def isolate_of(args: argparse.Namespace) -> float | None:
    """s that a call into a unit in a process of its own may take; None: units run in this process."""
    seconds = args.isolate_timeout
    if seconds is not None and not seconds > 0:
        raise ValueError(f"--isolate-timeout {seconds:g} s must be positive")
    return ISOLATE if seconds is None and args.isolate else seconds


def _tried(args: argparse.Namespace, s: Scene) -> dict[str, Rollback]:
    """Whether units can take steps back, where the coupling may ask it of them."""
    if args.coupling in EXPLICIT or not s.units:
        return {}
    from phfmu.network.members.unit_member import tried

    return tried(s.units, s.step if args.step is None else args.step)


def _coupling(args: argparse.Namespace, s: Scene, stuck: Mapping[str, str]) -> tuple[str, list[str]]:
    """The coupling asked for, or the one that fits and the line that says why; one model without a word if nobody asked."""
    from phfmu.network.couplings.auto import choose
    from phfmu.network.junctions.network import Network

    if args.coupling not in (None, "auto"):
        return args.coupling, []
    if not isinstance(s.system, Network):
        return "monolithic", []
    found = choose(s.system, asked_apart(args), stuck)
    silent = args.coupling is None and found.name == "monolithic"
    return found.name, [] if silent else [f"coupling {found.name}: {found.why}"]


def require_sound_scene(args: argparse.Namespace, s: Scene, events: Sequence[Event] | None = None) -> None:
    """`require_sound` of the whole, or, where units are in it, of each declared member."""
    from phfmu.network.junctions.network import Network

    if not s.units:
        return require_sound(args, s.declaration(), events)
    members = s.system.declared if isinstance(s.system, Network) else {}
    for name, declaration in members.items():
        own = [replace(e, name=e.name.removeprefix(f"{name}.")) for e in events or () if e.name.startswith(f"{name}.")]
        require_sound(args, declaration, None if events is None else own)
    return None


def engine_of(engine: str) -> str:
    """`auto` resolved: native if a compiler is found, else python, which is said on stderr."""
    if engine != "auto":
        return engine
    from phfmu.engine.compile import CompilerMissing, require_compiler

    try:
        require_compiler()
    except CompilerMissing as error:
        print(f"phfmu: no C compiler ({error}); using the Python engine", file=sys.stderr)
        return "python"
    return "native"


def instance_of(model: Any, engine: str) -> Any:
    """A Python or native instance of a discretised model."""
    if engine == "python":
        from phfmu.engine.python import PythonInstance

        return PythonInstance(model)
    from phfmu.engine.native import NativeInstance

    return NativeInstance(model, _announce)


def _announce() -> None:
    """The first run of a set of equations on a machine waits for the compiler; say so on a terminal."""
    if sys.stderr.isatty():
        print("phfmu: compiling the equations for this machine, once (--engine python runs without)", file=sys.stderr)


def _with_settings(system: Any, values: dict[str, float]) -> Any:
    from phfmu.network.junctions.network import Network

    if not values:
        return system
    if not isinstance(system, Network):
        return system.with_starts(values)
    net = replace(system, members=dict(system.members))
    joined = {n: f"junction '{j.name}'" for j in net.junctions for e in j.ends for n in inputs_of(net, e)}
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


def inputs_of(net: Network, end: End) -> list[str]:
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


def _label(schemes: Sequence[Any], engine: str, coupling: str, most: float = inf, held: str = "") -> str:
    """Schemes, the order of the whole (at most `most`, and why: `held`), engine and coupling."""
    if not schemes:
        return f"units, {coupling}"
    names = " and ".join(dict.fromkeys(s.name for s in schemes))
    gradient = "" if schemes[0].gradient in ("per-term", "nodal") else f", {schemes[0].gradient}"
    own = min(s.order for s in schemes)
    why = f" (members of order {own}, {held})" if own > most else ""
    return f"{names}, order {min(most, own)}{why}{gradient}, {engine}, {coupling}"


def _most(coupling: Named, schemes: Iterable[Scheme], units: Iterable[UnitFile], signals: bool) -> float:
    """The order that members stepped apart keep together at most; signals between them are held."""
    from phfmu.network.couplings.held_signals import ORDER as SIGNALS

    nodes = [u.k for u in units]
    at_nodes = coupling.nodes and all(s.node_values for s in schemes) and all(nodes)
    if at_nodes and not signals:
        return 2 * min(nodes, default=inf)
    return min(coupling.order, SIGNALS) if signals else coupling.order


def _order_lost(asked: int | None, coupling: Named, most: float) -> list[str]:
    """A line if the coupling does not keep the order that was asked for."""
    if asked is None or asked <= most:
        return []
    values = "one value per step, held" if most <= coupling.order else "as many values per step as its units take"
    return [
        f"--order {asked} is that of the members: {coupling.words} joins them by {values}, so the run is of order {most:g}"
    ]


def _monolithic(args: argparse.Namespace, s: Scene, declaration: PHDAE, why: list[str]) -> Job:
    scheme, engine = scheme_of(args, declaration), engine_of(args.engine)

    def build() -> Stepper:
        from phfmu.discretise.model import build_model
        from phfmu.network.couplings.monolithic import Monolithic

        if engine == "fmu":
            from phfmu.network.couplings.unit import FMUStepper

            return FMUStepper(_as_fmu(declaration, scheme, args.fmi, s.step if args.step is None else args.step))
        model = build_model(declaration, scheme)
        return Monolithic(model, instance_of(model, engine))

    return Job(s, _label([scheme], f"{engine} engine", "monolithic"), engine != "fmu", build, why)


def _coupled(
    args: argparse.Namespace, s: Scene, network: Network, name: str, why: list[str], tried: Mapping[str, Rollback]
) -> Job:
    from phfmu.network.couplings.named import named_coupling

    sequence = args.sequence and [name.strip() for name in args.sequence.split(",")]
    coupling = named_coupling(name, network, sequence, args.unconverged)
    schemes = {name: scheme_of(args, declaration, member=True) for name, declaration in network.declared.items()}

    own_engines = {member: engine_of(e) for member, e in engines_asked(args, network).items()}
    stepping = Stepping(engine_of(args.engine), own_engines, parts_asked(args, network))
    step = s.step if args.step is None else args.step
    notes = list(why)

    some_fmu = "fmu" in map(stepping.engine_of, schemes)
    kicked = _kicked(network, args.project) if some_fmu and coupling.nodes else set()

    def member(name: str, declaration: PHDAE | UnitFile) -> Member:
        from phfmu.declare.phdae import PHDAE
        from phfmu.discretise.model import build_model
        from phfmu.network.members.engine_member import EngineMember
        from phfmu.network.members.unit_member import unit_member

        if not isinstance(declaration, PHDAE):
            made, lines = unit_member(name, declaration, step, tried.get(name))
            notes.extend(lines)
            return made
        own, parts = replace(declaration, name=name), stepping.parts_of(name)
        if stepping.engine_of(name) == "fmu":
            from phfmu.network.members.fmu_member import FMUMember

            extra = _exchanged(schemes[name], name, kicked)
            return FMUMember(name, _as_fmu(own, schemes[name], args.fmi, step / parts, *extra))
        model = build_model(own, schemes[name])
        return EngineMember(name, model, instance_of(model, stepping.engine_of(name)), parts)

    def build() -> Stepper:
        from phfmu.network.couplings.coupled import Coupled

        return Coupled(network, [member(name, d) for name, d in network.members.items()], coupling.make)

    most = _most(coupling, schemes.values(), network.units.values(), bool(network.wires))
    held = coupling.held if most <= coupling.order else f"units of order {most:g}"
    label = _label(list(schemes.values()), stepping.words, coupling.words, most, held)
    notes += _order_lost(args.order, coupling, most)
    return Job(s, label, False, build, notes)


def _kicked(network: Network, projected: bool) -> set[str]:
    from phfmu.network.couplings.told import kicked

    return kicked(network, projected)


def _exchanged(scheme: Scheme, name: str, kicked: set[str]) -> tuple[bool, bool]:
    """Whether the unit of a member needs inputs at nodes, and impulses where steps have one node."""
    return scheme.node_values and scheme.order > 2, scheme.node_values and name in kicked


def _as_fmu(
    declaration: PHDAE,
    scheme: Any,
    fmi: str | None,
    step: float,
    node_inputs: bool = False,
    impulses: bool = False,
) -> Any:
    """The declaration exported to a temporary folder and loaded again."""
    import atexit
    import shutil
    import tempfile

    from phfmu.discretise.model import build_model
    from phfmu.fmu.export import export
    from phfmu.fmu.reader import FMUInstance
    from phfmu.fmu.version import LATEST

    folder = tempfile.mkdtemp(prefix="phfmu-")
    atexit.register(shutil.rmtree, folder, ignore_errors=True)
    tunable = [v.name for v in declaration.parameters if not v.signal]
    versions = (fmi or LATEST,)
    (path,) = export(
        build_model(declaration, scheme), folder, versions, step=step, node_inputs=node_inputs, impulses=impulses,
        tunable=tunable,
    )  # fmt: skip
    return FMUInstance(path)


def _fmu_run(args: argparse.Namespace) -> Job:
    from phfmu.fmu.reader import FMUInstance
    from phfmu.fmu.unit_file import unit_file
    from phfmu.network.couplings.unit import FMUStepper
    from phfmu.network.scene import fmu_scene

    _refuse_compiled_in(args)
    file = unit_file(args.target)
    unit = FMUInstance(file.path, file.port_maps, starts=settings(args.set), isolate=isolate_of(args))
    for line in file.left_out:
        print(f"phfmu: {args.target}: {line}", file=sys.stderr)
    return Job(fmu_scene(unit), f"FMI {unit.interface.version}", False, lambda: FMUStepper(unit))


def _refuse_compiled_in(args: argparse.Namespace) -> None:
    """ValueError for options that an FMU has compiled in."""
    if asked_apart(args):
        raise ValueError(
            f"{args.target}: --member and --parts are for members of a network; an FMU has none to choose for"
        )
    usual = {"order": (None, 2), "scheme": ("auto",), "gradient": ("per-term",), "closure": (None,),
             "engine": ("auto", "fmu"), "coupling": (None, "auto", "monolithic")}  # fmt: skip
    for option, values in usual.items():
        asked = getattr(args, option)
        if asked not in values:
            raise ValueError(
                f"{args.target}: --{option} {asked} has no effect on an FMU, its method is compiled in; "
                "run the declaration, or export it with the options you want"
            )
