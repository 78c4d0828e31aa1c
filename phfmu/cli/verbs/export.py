"""phfmu export: native FMUs.

phfmu export --ssp: a scene as a package of SSP.
"""

from __future__ import annotations

import argparse
import sys
from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from phfmu.declare.phdae import PHDAE
    from phfmu.fmu.export.schedule import UnitEvent
    from phfmu.network.scene import Event, Scene
    from phfmu.references.experiment import Series


def add_parser(verbs: Any) -> None:
    from phfmu.cli import options
    from phfmu.cli.codes import TARGET
    from phfmu.cli.settings import add_settings
    from phfmu.cli.sound import add_no_check
    from phfmu.fmu.version import VERSIONS
    from phfmu.network.couplings.coupling_table import COUPLINGS, GAUSS_SEIDEL, NEWTON
    from phfmu.ssp.names import VERSIONS as SSP_VERSIONS

    parser = verbs.add_parser(
        "export", help=f"write FMI {' and '.join(VERSIONS)} Co-Simulation FMUs, or a package of SSP"
    )
    parser.add_argument("target", help=TARGET.replace(" | X.fmu", ""))
    parser.add_argument("-o", "--output", default=".", metavar="DIR", help="folder for the FMUs (default: here)")
    parser.add_argument(
        "--fmi", action="append", choices=[_short(n) for n in VERSIONS], help="FMI version; all if not given"
    )
    parser.add_argument("--step", type=float, help="internal step in s (default: the scene's)")
    options.add_scheme(parser)
    parser.add_argument("--node-inputs", action="store_true",
                        help="optional port inputs at the nodes of a step, e.g. terminal.v_node[1,2] (order 4 or 6), "
                        "and impulses at its ends for ports that take some")  # fmt: skip
    parser.add_argument("--impulses", action="store_true",
                        help="the same at order 2 too, with impulses at the ends of a step for ports that take some")  # fmt: skip
    parser.add_argument("--outputs", default="ledger", choices=("ledger", "local"),
                        help="energies and residuals of constraints as outputs, or as local variables")  # fmt: skip
    parser.add_argument("--arrays", action="store_true",
                        help="vector ports as array variables in FMI 3.0 (in FMI 2.0 they are scalars)")  # fmt: skip
    parser.add_argument("--no-terminals", action="store_true",
                        help="leave terminalsAndIcons.xml out, which some importers of FMI 2.0 refuse")  # fmt: skip
    parser.add_argument("--reference-experiment", action="store_true",
                        help="a run with its results inside, by the draft FMI-LS-REF; `phfmu vet` tries it")  # fmt: skip
    parser.add_argument("--outward", action="append", default=[], metavar="PORT",
                        help="count the flow of this port (current, force) out of the unit; may be repeated")  # fmt: skip
    parser.add_argument("--platform", action="append", metavar="NAME", help="e.g. x86_64-linux; may be repeated")
    parser.add_argument("--all-platforms", action="store_true", help="linux, windows and darwin, x86_64 and aarch64")
    parser.add_argument("--tunable", action="append", default=[], metavar="NAME",
                        help="a parameter that may be set between steps, as those of the scene's events may")  # fmt: skip
    parser.add_argument("--events", default="outside", choices=("outside", "inside"),
                        help="outside: the importer sets what the scene's events change; inside: the unit does")  # fmt: skip
    parser.add_argument("--as-unit", action="store_true",
                        help="members of a network stay apart in the unit, joined by a coupling inside, each with its "
                             "scheme (without it they are composed to one model)")  # fmt: skip
    parser.add_argument("--coupling", choices=[n for n, c in COUPLINGS.items() if c.apart],
                        help=f"the coupling inside the unit, with --as-unit: {NEWTON.name}, which is the default")  # fmt: skip
    parser.add_argument("--sequence", metavar="A,B,..",
                        help=f"the order in which --coupling {GAUSS_SEIDEL.name} steps the members")  # fmt: skip
    parser.add_argument("--ssp", nargs="?", const=SSP_VERSIONS[0], choices=SSP_VERSIONS, metavar="VERSION",
                        help="a package of SSP (default 1.0; 2.1, with terminals, is a draft): members as units, "
                        "parameters, connections")  # fmt: skip
    options.add_grid(parser)
    options.add_lenient(parser)
    add_settings(parser)
    add_no_check(parser)
    parser.set_defaults(call=call)


def call(args: argparse.Namespace) -> int:
    from dataclasses import replace

    from phfmu.cli.options import scene_of, scheme_of
    from phfmu.cli.settings import settings, with_settings
    from phfmu.cli.sound import require_sound
    from phfmu.cli.timeline import started
    from phfmu.discretise.model import build_model
    from phfmu.fmu.export.export import PLATFORMS, export
    from phfmu.fmu.export.schedule import fed_inside
    from phfmu.fmu.version import VERSIONS
    from phfmu.network.signal_ports import exchanging
    from phfmu.references.writing import reference_results

    _require_coupling(args)
    s = scene_of(args)
    if args.ssp:
        _require_places(args, s)
        return export_package(args, s)
    if args.as_unit:
        return export_apart(args, s)
    if s.units:
        raise ValueError(
            f"{args.target}: one model holds no FMU, as {', '.join(s.units)} would be; --as-unit keeps the members apart in a "
            "unit, --ssp writes a package of all, or put declarations in their place"
        )
    given = settings(args.set)
    events, notes = started(s.events, given, s.declaration().settable_names())
    begun = {e.name: e.value for e in events if e.t <= 0.0}
    system = with_settings(with_settings(s.system, begun), given)
    declaration = replace(s, system=system).declaration()
    require_sound(args, declaration)
    inside, left_out = _events(args, [e for e in events if e.t > 0.0], declaration)
    left_out += [f"{s.restart} damping steps after each event"] if s.restart else []
    if inside:
        require_sound(args, declaration, [e for e in events if e.t > 0.0])
        declaration = fed_inside(declaration, [e.name for e in inside])
    step = _require_places(args, s)
    asked = {_short(n): n for n in VERSIONS}
    versions = [asked[v] for v in (args.fmi or asked)]
    platforms = list(PLATFORMS) if args.all_platforms else args.platform
    scheme = scheme_of(args, declaration)
    if args.node_inputs and scheme.node_values and not declaration.state_events:
        declaration = exchanging(declaration, [e.name for e in inside])
    model = build_model(declaration, scheme)
    series = reference_results(model, step, s.stop, inside) if args.reference_experiment else None
    paths = export(model, args.output, versions=versions, step=step, stop=s.stop, platforms=platforms,
                   node_inputs=args.node_inputs, ledger_outputs=args.outputs == "ledger",
                   terminals=not args.no_terminals, left_out=left_out, arrays=args.arrays, outward=args.outward,
                   impulses=args.impulses,
                   tunable=[*args.tunable, *_changed(events, declaration)], events=inside)  # fmt: skip
    if series is not None:
        notes = [*notes, *_add_reference(series, paths, step, s.stop)]
    return _said(notes, left_out, paths)


def _add_reference(series: Series, paths: Sequence[Path], step: float, stop: float) -> list[str]:
    """Put the results of the model into its units, which then have to give its results; lines of what was not tried.

    FMUError for a unit that does not: it is left without.
    """
    from phfmu.fmu.export.variables import FMUError
    from phfmu.references.writing import add_experiment
    from phfmu.vet.claims.references import CLAIM
    from phfmu.vet.finding import FALSE, HOLDS
    from phfmu.vet.process import judged
    from phfmu.vet.subject import Subject

    notes = list[str]()
    for path in paths:
        bare = path.read_bytes()
        add_experiment(path, series, step, stop)
        found = judged(CLAIM, Subject(path))
        if found.verdict == FALSE:
            path.write_bytes(bare)
            raise FMUError(f"{path}: written without its experiment, whose results it does not give: {found.seen}")
        if found.verdict != HOLDS:
            notes.append(f"{path}: its experiment was not tried: {found.seen}")
    return notes


def export_apart(args: argparse.Namespace, s: Scene) -> int:
    """Write units of the coupled members; as `call` in all else."""
    from phfmu.cli.options import scheme_of
    from phfmu.cli.settings import settings, with_settings
    from phfmu.cli.sound import require_sound_scene
    from phfmu.cli.timeline import started
    from phfmu.fmu.export.export import PLATFORMS
    from phfmu.fmu.version import VERSIONS
    from phfmu.network.as_unit.export import export_network, untold_of
    from phfmu.network.couplings.choice.gathered import composed_members, gathered
    from phfmu.network.couplings.coupling_table import NEWTON
    from phfmu.network.network import Network
    from phfmu.signals import of_member
    from phfmu.ssp.export import network_of
    from phfmu.words import first_few

    if odd := [n for n, on in {"--node-inputs": args.node_inputs, "--impulses": args.impulses}.items() if on]:
        raise ValueError(f"--as-unit and {odd[0]} do not go together: inputs of the whole are held over a step")
    if args.reference_experiment:
        raise ValueError("--reference-experiment takes the run of one model; leave out --as-unit")
    if not isinstance(s.system, Network):
        raise ValueError(f"{args.target} has no members to keep apart; leave out --as-unit")
    given = settings(args.set)
    known = [f"{m}.{n}" for m, d in network_of(s).members.items() for n in d.settable_names()]
    events, notes = started(s.events, given, known)
    begun = {e.name: e.value for e in events if e.t <= 0.0}
    s = replace(s, system=with_settings(with_settings(s.system, begun), given))
    require_sound_scene(args, s)
    network, events = network_of(s), [e for e in events if e.t > 0.0]
    if not args.sequence:  # as a run does
        network = gathered(network)
    own = [(m, n) for m, d in network.declared.items() for v in d.parameters for n in (v.name, *v.names())]
    parameters = {of_member(m, n) for m, n in own}
    changed = [n for n in dict.fromkeys(e.name for e in events) if n in parameters]
    inside, left_out = _told(args, events, changed)
    left_out += [f"{s.restart} damping steps after each event"] if s.restart else []
    if one := composed_members(network):
        notes = [*notes, f"composed to one member: {first_few(one)}, as in a run"]
    asked = {_short(n): n for n in VERSIONS}
    paths = export_network(
        network, args.output, {n: scheme_of(args, d, member=True) for n, d in network.declared.items()},
        [asked[v] for v in (args.fmi or asked)], step=_require_places(args, s), stop=s.stop,
        platforms=list(PLATFORMS) if args.all_platforms else args.platform, ledger_outputs=args.outputs == "ledger",
        terminals=not args.no_terminals, left_out=left_out, arrays=args.arrays, outward=args.outward,
        tunable=[*args.tunable, *changed], events=inside, coupling=args.coupling or NEWTON.name,
        sequence=args.sequence and [name.strip() for name in args.sequence.split(",")],
    )  # fmt: skip
    return _said(notes, [*left_out, *untold_of(network)], paths)


def _require_coupling(args: argparse.Namespace) -> None:
    """Raise ValueError for a coupling of a unit that has no members to couple."""
    for option, asked in {"--coupling": args.coupling, "--sequence": args.sequence}.items():
        if asked and not args.as_unit:
            raise ValueError(f"{option} {asked} joins members that stay apart in the unit; say --as-unit too")


def _said(notes: Sequence[str], left_out: Sequence[str], paths: Sequence[Path]) -> int:
    for note in notes:
        print(f"phfmu: {note}", file=sys.stderr)
    for line in left_out:
        print(f"phfmu: not in the unit: {line}", file=sys.stderr)
    for path in paths:
        print(path)
    return 0


def _require_places(args: argparse.Namespace, s: Scene) -> float:
    """The step; ValueError for one that is not positive, or a place where no folder can be."""
    step = args.step if args.step is not None else s.step
    if not step > 0:
        raise ValueError(f"--step {step} s must be positive")
    from phfmu.files import require_folder

    folder = Path(args.output)
    if folder.suffix in (".fmu", ".ssp"):
        package = " --ssp" if folder.suffix == ".ssp" and not args.ssp else ""
        raise ValueError(
            f"-o {folder} is a folder, files in it are named by the model; say{package} -o {folder.parent}"
        )
    require_folder(folder, f"-o {folder}", "the FMUs")
    return step


def _short(number: str) -> str:
    """2.0 -> 2."""
    return number.removesuffix(".0")


def _changed(events: Sequence[Event], declaration: PHDAE) -> list[str]:
    """Parameters that events change."""
    known = {n for v in declaration.parameters if not v.signal for n in (v.name, *v.names())}
    return [n for n in dict.fromkeys(e.name for e in events if e.t > 0.0) if n in known]


def _events(args: argparse.Namespace, events: Sequence[Event], declaration: PHDAE) -> tuple[list[UnitEvent], list[str]]:
    """Events for the unit, or a line for each that happens in the importer."""
    return _told(args, events, _changed(events, declaration))


def _told(
    args: argparse.Namespace, events: Sequence[Event], changed: Sequence[str]
) -> tuple[list[UnitEvent], list[str]]:
    """The same; `changed`: parameters that events change, all else are inputs."""
    from phfmu.fmu.export.schedule import UnitEvent

    if args.events == "inside":
        return [UnitEvent(e.t, e.name, e.value) for e in events], []
    tunable = set(changed)
    what = {True: "set this tunable parameter at that time", False: "set this input at that time"}
    return [], [f"event at t = {e.t:g} s, {e.name} = {e.value:g}: {what[e.name in tunable]}" for e in events]


def export_package(args: argparse.Namespace, s: Scene) -> int:
    """Write it, with FMI 2.0 units unless --fmi says another; lines about what other tools will not find in it."""
    from phfmu.cli.options import scheme_of
    from phfmu.cli.settings import settings, with_settings
    from phfmu.cli.sound import require_sound_scene
    from phfmu.cli.timeline import started
    from phfmu.fmu.export.export import PLATFORMS
    from phfmu.ssp.export import PackageOptions, export_ssp, network_of

    _refuse_others(args)
    given = settings(args.set)
    known = [f"{m}.{n}" for m, d in network_of(s).members.items() for n in d.settable_names()]
    events, notes = started(s.events, given, known)
    begun = {e.name: e.value for e in events if e.t <= 0.0}
    system = with_settings(with_settings(s.system, begun), given)
    s = replace(s, system=system, events=tuple(e for e in events if e.t > 0.0))
    require_sound_scene(args, s)
    step = args.step if args.step is not None else s.step
    schemes = {n: scheme_of(args, d, member=True) for n, d in network_of(s).declared.items()}
    platforms = list(PLATFORMS) if args.all_platforms else args.platform
    options = PackageOptions(step, f"{(args.fmi or ['2'])[0]}.0", platforms, schemes, args.outward)
    path, left_out = export_ssp(s, args.output, options, args.ssp)
    for line in (*s.notes, *notes):
        print(f"phfmu: {line}", file=sys.stderr)
    for line in left_out:
        print(f"phfmu: not for other tools: {line}", file=sys.stderr)
    print(path)
    return 0


def _refuse_others(args: argparse.Namespace) -> None:
    """Raise ValueError for options that are about a single unit."""
    chosen = {"--node-inputs": args.node_inputs, "--impulses": args.impulses, "--arrays": args.arrays,
              "--no-terminals": args.no_terminals, "--outputs local": args.outputs != "ledger",
              "--tunable": args.tunable, "--events inside": args.events != "outside",
              "--reference-experiment": args.reference_experiment}  # fmt: skip
    if odd := [name for name, value in chosen.items() if value]:
        raise ValueError(f"--ssp and {odd[0]} do not go together; export the units by themselves for that")
    if args.fmi and len(args.fmi) > 1:
        raise ValueError("--ssp writes units of one FMI version; say --fmi once")
