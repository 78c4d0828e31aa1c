"""phfmu export --ssp: a scene as a package of SSP."""

from __future__ import annotations

import argparse
import sys
from dataclasses import replace
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from phfmu.network.scene import Scene


def export_package(args: argparse.Namespace, s: Scene) -> int:
    """Write it, with FMI 2.0 units unless --fmi says another; lines about what other tools will not find in it."""
    from phfmu.cli.options import scheme_of
    from phfmu.cli.settings import settings, with_settings
    from phfmu.cli.sound import require_sound_scene
    from phfmu.cli.timeline import started
    from phfmu.fmu.export import PLATFORMS
    from phfmu.ssp.export import Options, export_ssp, network_of

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
    options = Options(step, f"{(args.fmi or ['2'])[0]}.0", platforms, schemes, args.outward)
    path, left_out = export_ssp(s, args.output, options, args.ssp)
    for line in (*s.notes, *notes):
        print(f"phfmu: {line}", file=sys.stderr)
    for line in left_out:
        print(f"phfmu: not for other tools: {line}", file=sys.stderr)
    print(path)
    return 0


def _refuse_others(args: argparse.Namespace) -> None:
    """ValueError for options that are about a single unit."""
    chosen = {"--node-inputs": args.node_inputs, "--impulses": args.impulses, "--arrays": args.arrays,
              "--no-terminals": args.no_terminals, "--outputs local": args.outputs != "ledger",
              "--tunable": args.tunable, "--events inside": args.events != "outside"}  # fmt: skip
    if odd := [name for name, value in chosen.items() if value]:
        raise ValueError(f"--ssp and {odd[0]} do not go together; export the units by themselves for that")
    if args.fmi and len(args.fmi) > 1:
        raise ValueError("--ssp writes units of one FMI version; say --fmi once")
