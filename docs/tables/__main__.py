"""Makes the tables and pictures of the documentation: `python docs/tables [--write] NAME ...` (needs a C compiler).

Without a NAME all names are listed.  `--write` puts a table into the pages, below the line with its command, and
pictures where the pages show them.  Errors are measured against tests/reference, independent solutions of high accuracy,
or against closed forms; pictures are drawn from runs, never from stored numbers.
"""

from __future__ import annotations

import argparse
import sys
from collections.abc import Callable
from importlib import import_module
from pathlib import Path

from phfmu.studies.bench import machine

machine.one_thread()  # before numpy is imported

from pages import ROOT, PageBlock, write  # noqa: E402

#: module -> what it makes; the docstring of each function says what is measured
MAKERS = {
    "pictures": ("smib_picture", "skew_picture"),
    "gallery": ("gallery",),
    "one_circuit": ("one_step", "one_balance", "mental_model_picture"),
    "particles": ("four_particle_convergence", "four_particle_balance", "four_particle_large_steps"),
    "machines": (
        "oscillator_coupling",
        "smib_convergence",
        "smib_folded_convergence",
        "smib_coordinates",
        "two_machine_order",
    ),
    "multibody": ("chain", "top"),
    "mechanisms": ("mechanism_values", "mechanism_windows", "mechanism_slopes"),
    "stepping": ("restart", "tolerance", "between"),
    "audit_cost": ("audit_cost",),
    "library": ("orders",),
    "events": ("event_orders", "event_losses", "apart_orders"),
    "event_peers": ("event_peers", "event_peers_equal"),
    "event_picture": ("event_picture",),
    "multibody_peers": ("multibody_peers", "multibody_peers_equal", "multibody_peers_iftomm"),
    "singular_mass": ("mass_spring_orders",),
    "networks": ("couplings",),
    "grid_peers": ("grid_peers", "grid_peers_equal", "grid_peers_steps"),
    "quarter_truck": ("quarter_truck",),
    "grids": (
        "grid_power_flows",
        "grid_steady",
        "grid_fault_orders",
        "grid_openings",
        "grid_clearing",
        "grid_ieee39",
        "grid_map",
        "grid_wecc240",
    ),
    "gradient_peers": ("gradient_peers",),
    "house": ("house",),
    "timings": ("four_particle", "chain_10", "chain_50", "scaling_chain", "scaling_net", "scaling_ladder"),
}
MODULE = {name: module for module, names in MAKERS.items() for name in names}


def maker(name: str) -> Callable[..., PageBlock]:
    return getattr(import_module(MODULE[name]), name)


def main() -> None:
    parser = argparse.ArgumentParser(prog="python docs/tables", description=(__doc__ or "").split("\n\n")[0])
    parser.add_argument("names", nargs="*", metavar="NAME", help="what to make; none: list them")
    parser.add_argument("--write", action="store_true", help="into the pages, below the line with the command")
    parser.add_argument(
        "--tree", action="append", type=Path, metavar="PATH", help="of house: a tree to measure; may be repeated"
    )
    parser.add_argument(
        "--picture", action="append", metavar="SCENE", help="of gallery: draw only this one; may be repeated"
    )
    args = parser.parse_args()
    if args.picture and args.names != ["gallery"]:
        parser.error("--picture is of gallery")
    if args.tree and args.names != ["house"]:
        parser.error("--tree is of house")
    unknown = [n for n in args.names if n not in MODULE]
    if unknown:
        parser.error(f"there is no '{unknown[0]}'; there are: {', '.join(MODULE)}")
    for name in args.names:
        chosen = args.tree or args.picture
        made = maker(name)(chosen) if chosen else maker(name)()
        print(f"### {name}\n\n{maker(name).__doc__}\n\n{made}\n", flush=True)
        if args.write:
            for path in (*write(name, made), *made.draw()):
                print(f"wrote {path.relative_to(ROOT)}", file=sys.stderr)
    for name in () if args.names else MODULE:
        print(f"{name:<28} {(maker(name).__doc__ or '').splitlines()[0]}")


if __name__ == "__main__":
    main()
