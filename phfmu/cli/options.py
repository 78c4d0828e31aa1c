"""Options shared by verbs that discretise a model."""

from __future__ import annotations

import argparse
from pathlib import Path
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from phfmu.declare.phdae import PHDAE
    from phfmu.network.scene import Scene
    from phfmu.runs.options import Options
    from phfmu.schemes.scheme import Scheme


def add_scheme(parser: argparse.ArgumentParser) -> None:
    """--order, --scheme, --gradient, --closure."""
    from phfmu.gradients.gradient_names import GRADIENTS
    from phfmu.schemes.scheme_names import CLOSURES, ORDERS, SCHEMES

    parser.add_argument("--order", type=int, choices=ORDERS, help="order of the scheme (default 2, radau 3)")
    parser.add_argument("--scheme", default="auto", choices=SCHEMES,
                        help="auto: two-level with holonomic constraints, else collocated")  # fmt: skip
    parser.add_argument("--gradient", default="per-term", choices=GRADIENTS)
    parser.add_argument(
        "--closure",
        choices=CLOSURES,
        help="where algebraic variables of a step belong (semi-explicit, gradient-pair, dirac-dissipative)",
    )


def add_lenient(parser: argparse.ArgumentParser) -> None:
    """--lenient."""
    parser.add_argument("--lenient", action="store_true",
                        help="a unit of measurement that an .ssp or .ssd does not define is told, and unknown")  # fmt: skip


def lenient_of(args: argparse.Namespace) -> bool:
    """--lenient; ValueError for targets that are no package."""
    from phfmu.target import is_ssp

    if args.lenient and not is_ssp(args.target):
        raise ValueError(f"{args.target}: --lenient is for packages of SSP (.ssp, .ssd)")
    return args.lenient


def add_grid(parser: argparse.ArgumentParser) -> None:
    """--dynamics, --fault, --trip, --plants, --no-controls, --q-limits, --saturation: of grids."""
    parser.add_argument("--dynamics", metavar="DIR|FILE",
                        help="dynamic data of a grid: .dyr, .xlsx, or .csv tables (a folder, 'DIR/a_*.csv')")  # fmt: skip
    parser.add_argument("--fault", action="append", default=[], metavar="BUS:BEGIN:END[:R]",
                        help="three-phase fault of a grid, bus7:0.1:0.18, R in per unit (0.001); may be repeated")  # fmt: skip
    parser.add_argument("--trip", action="append", default=[], metavar="LINE[:TIME]",
                        help="line of a grid whose poles open at their next current zeros, line5-7:0.18 (default: "
                        "when the first fault ends); may be repeated")  # fmt: skip
    parser.add_argument("--plants", choices=("refuse", "currents", "inverters"),
                        help="generators of a grid without dynamic data: refused (default), constant currents, or "
                        "grid-following inverters of constant power")  # fmt: skip
    parser.add_argument("--no-controls", action="store_true",
                        help="a grid without its exciters, governors, stabilisers: fields and torques constant")  # fmt: skip
    parser.add_argument("--q-limits", action="store_true",
                        help="generators of a grid hold their voltage within their limits of reactive power only")  # fmt: skip
    parser.add_argument("--saturation", action="store_true",
                        help="machines of a grid saturate as S(1.0), S(1.2) of their data say (default: linear)")  # fmt: skip


def scene_of(args: argparse.Namespace) -> Scene:
    """The target as a scene, a grid with its dynamic data, faults and trips; ValueError for these options with other targets."""
    from phfmu.target import is_grid, scene

    given = [f"--{name}" for name in ("dynamics", "fault", "trip", "plants", "no-controls", "q-limits", "saturation")
             if getattr(args, name.replace("-", "_"))]  # fmt: skip
    if not is_grid(args.target):
        if given:
            raise ValueError(f"{args.target}: {given[0]} is for grids (.raw, .m)")
        return scene(args.target, lenient_of(args))
    from phfmu.components.grids import fault_of, grid_scene, trip_of
    from phfmu.importers.grid import read_grid

    return grid_scene(
        read_grid(args.target, args.dynamics), faults=[fault_of(f) for f in args.fault],
        trips=[trip_of(t) for t in args.trip], plants=args.plants or "refuse",
        controls=not args.no_controls, q_limits=args.q_limits, saturation=args.saturation,
    )  # fmt: skip


def add_steps(parser: argparse.ArgumentParser) -> None:
    """--rtol, --atol, --energy-rtol, --ecco, --min-step, --max-step, --restart, --dense."""
    parser.add_argument("--rtol", type=float, help="adapt the step: allowed error of a step relative to each state")
    parser.add_argument("--atol", type=float, help="the same relative to each state's nominal value (default: --rtol)")
    parser.add_argument("--energy-rtol", type=float, metavar="R",
                        help="adapt the step of coupled members: allowed energy that each junction makes or hides in a step, "
                        "relative to what passes through it; --atol: the least of that in J (default: none)")  # fmt: skip
    parser.add_argument("--ecco", type=float, metavar="TOL",
                        help="adapt the step of couplings that take each step once: allowed energy that a junction makes in "
                        "a step, relative to what passes through it and 1 J")  # fmt: skip
    parser.add_argument("--min-step", type=float, help="smallest adaptive step in s (default: none)")
    parser.add_argument("--max-step", type=float, help="largest adaptive step in s (default: none)")
    parser.add_argument("--restart", type=int, metavar="N",
                        help="take N damping steps (Radau) after each event, loss booked (default: the scene's)")  # fmt: skip
    parser.add_argument("--dense", type=int, metavar="N",
                        help="write N interpolated rows within each step too, marked in the column `interpolated`")  # fmt: skip


def audit_file(args: argparse.Namespace) -> str | None:
    """The file that --audit asks for, if it does."""
    if args.audit in ("none", "summary"):
        return None
    if args.audit != "full":
        return args.audit
    from phfmu.target import function_name

    return f"{function_name(args.target) or Path(args.target.partition(':')[0]).stem}.audit.parquet"


def of_run(args: argparse.Namespace, scene: Scene, *, whole: bool) -> Options:
    """The options of a run that its events and outputs are still to be added to; the scene's restarts need one composed model."""
    from phfmu.runs.options import Options

    stop = scene.stop if args.stop is None else args.stop
    step = scene.step if args.step is None else args.step
    restart = args.restart if args.restart is not None else scene.restart if whole else 0
    given = {n: getattr(args, n) for n in ("energy_rtol", "ecco", "atol", "min_step", "max_step")}
    if args.rtol is not None and args.step:
        given["landing"] = args.step
    return Options(
        stop=stop, step=step, rtol=args.rtol, restart=restart, dense=args.dense, project=args.project, kept=tuple(args.keep),
        audit_rtol=args.audit_rtol, audited=args.audit != "none",
        **{name: value for name, value in given.items() if value is not None},
    )  # fmt: skip


def scheme_of(args: argparse.Namespace, declaration: PHDAE, *, member: bool = False) -> Scheme:
    """The scheme asked for; members without constraints fall back to collocated under auto and two-level."""
    from phfmu.schemes.named import named_scheme

    name: Any = args.scheme
    if member and name == "two-level" and not declaration.constraints:
        name = "collocated"
    return named_scheme(declaration, name, args.order, args.gradient, args.closure)
