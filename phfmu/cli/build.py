"""The run that a command line asks for: of one composed model, of members apart, or of an FMU."""

from __future__ import annotations

import argparse
from collections.abc import Mapping
from dataclasses import replace
from typing import TYPE_CHECKING, Any

from phfmu.cli import job_apart, job_unit, job_whole
from phfmu.cli.job import Job
from phfmu.cli.options import lenient_of
from phfmu.cli.settings import settings, with_settings
from phfmu.cli.sound import require_sound_scene
from phfmu.cli.stepping import asked_apart
from phfmu.network.couplings.coupling_table import AUTO, COUPLINGS, MONOLITHIC, CouplingRow
from phfmu.target import is_fmu, scene

if TYPE_CHECKING:
    from phfmu.network.members.rollback import Rollback
    from phfmu.network.scene import Scene


def job_of(args: argparse.Namespace) -> Job:
    """The scene, with its settings checked, and how it is stepped."""
    from phfmu.network.junctions.network import Network

    if args.fmi is not None and args.engine != "fmu" and not any(m.endswith("=fmu") for m in args.member):
        raise ValueError(f"--fmi {args.fmi} says what --engine fmu exports; add --engine fmu, or leave out --fmi")
    lenient = lenient_of(args)
    if is_fmu(args.target):
        _require_whole(args)
        return job_unit.unit(args)
    s = scene(args.target, lenient)
    s = replace(s, system=with_settings(s.system, settings(args.set)))
    s = replace(s, system=_with_unit_options(args, s.system))
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
        return job_whole.whole(args, s, s.declaration(), why)
    _require_whole(args)
    if not isinstance(s.system, Network):
        raise ValueError(f"{args.target} is a single component; --coupling {row.name} needs a network of members")
    return job_apart.apart(args, s, s.system, row.name, [*s.notes, *why], tried if row.kind.repeats else {})


def _require_whole(args: argparse.Namespace) -> None:
    """ValueError for details that only one composed model has."""
    if getattr(args, "audit_detail", False):
        raise ValueError(
            f"{args.target}: --audit-detail tells energies and resistors of one composed model by themselves; members that are "
            "stepped apart, and FMUs, tell their sums: take --coupling monolithic, or leave it out"
        )


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
    return replace(s, system=with_settings(s.system, settings(args.set)))


def _with_unit_options(args: argparse.Namespace, system: Any) -> Any:
    """The system with its units in processes of their own, or with a tolerance, if that is asked for."""
    from phfmu.network.junctions.network import Network

    seconds, tolerance = job_unit.isolate_of(args), job_unit.tolerance_of(args)
    if seconds is None and tolerance is None:
        return system
    if not isinstance(system, Network) or not system.units:
        option = "--isolate" if tolerance is None else "--unit-tolerance"
        raise ValueError(f"{args.target}: {option} is for FMUs, and there is none in it")
    own = {n: replace(file, isolate=seconds, tolerance=tolerance) for n, file in system.units.items()}
    return replace(system, members={n: own.get(n, m) for n, m in system.members.items()})


def _tried(args: argparse.Namespace, s: Scene) -> dict[str, Rollback]:
    """Whether units can take steps back, where the coupling may ask it of them."""
    if not s.units:
        return {}
    from phfmu.network.couplings.named import repeats

    if not repeats(args.coupling):
        return {}
    from phfmu.network.members.unit_member import tried

    return tried(s.units, s.step if args.step is None else args.step)


def _coupling(args: argparse.Namespace, s: Scene, stuck: Mapping[str, str]) -> tuple[CouplingRow, list[str]]:
    """The coupling asked for, or the one that fits and the line that says why; one model without a word if nobody asked."""
    from phfmu.network.couplings.auto import choose
    from phfmu.network.junctions.network import Network

    if args.coupling not in (None, AUTO.name):
        return COUPLINGS[args.coupling], []
    if not isinstance(s.system, Network):
        return MONOLITHIC, []
    found = choose(s.system, asked_apart(args), stuck)
    silent = args.coupling is None and found.row is MONOLITHIC
    return found.row, [] if silent else [f"coupling {found.row.name}: {found.why}"]
