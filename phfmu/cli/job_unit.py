"""A run of one FMU."""

from __future__ import annotations

import argparse
import sys
from math import inf

from phfmu.cli.job import Job
from phfmu.cli.settings import settings
from phfmu.cli.stepping import asked_apart
from phfmu.network.couplings.coupling_table import COUPLINGS

#: s that a call into a unit in a process of its own may take, unless told
ISOLATE = 60.0


def unit(args: argparse.Namespace) -> Job:
    from phfmu.fmu.reader import FMUInstance
    from phfmu.fmu.unit_file import unit_file
    from phfmu.network.couplings.unit import FMUStepper
    from phfmu.network.scene import fmu_scene

    _refuse_compiled_in(args)
    file = unit_file(args.target).with_starts(settings(args.set))
    instance = FMUInstance(
        file.path, file.port_maps, starts=file.starts, isolate=isolate_of(args), tolerance=tolerance_of(args)
    )
    for line in (*file.left_out, *instance.lacking):
        print(f"phfmu: {args.target}: {line}", file=sys.stderr)
    return Job(fmu_scene(instance), f"FMI {instance.interface.version}", False, lambda: FMUStepper(instance))


def isolate_of(args: argparse.Namespace) -> float | None:
    """s that a call into a unit in a process of its own may take; None: units run in this process."""
    seconds = args.isolate_timeout
    if seconds is not None and not seconds > 0:
        raise ValueError(f"--isolate-timeout {seconds:g} s must be positive")
    return ISOLATE if seconds is None and args.isolate else seconds


def tolerance_of(args: argparse.Namespace) -> float | None:
    """The relative tolerance that units are told of; None: their own."""
    value = args.unit_tolerance
    if value is not None and not 0 < value < inf:
        raise ValueError(f"--unit-tolerance {value:g}: expected a positive number, e.g. 1e-6")
    return value


def _refuse_compiled_in(args: argparse.Namespace) -> None:
    """ValueError for options that an FMU has compiled in."""
    if asked_apart(args):
        raise ValueError(
            f"{args.target}: --member and --parts are for members of a network; an FMU has none to choose for"
        )
    whole = (row.name for row in COUPLINGS.values() if not row.apart)
    usual = {"order": (None, 2), "scheme": ("auto",), "gradient": ("per-term",), "closure": (None,),
             "engine": ("auto", "fmu"), "coupling": (None, *whole)}  # fmt: skip
    for option, values in usual.items():
        asked = getattr(args, option)
        if asked not in values:
            raise ValueError(
                f"{args.target}: --{option} {asked} has no effect on an FMU, its method is compiled in; "
                "run the declaration, or export it with the options you want"
            )
