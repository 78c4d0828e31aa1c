"""phfmu bench: error against run time beside peers; scaling; orders; planted faults; published results reproduced."""

from __future__ import annotations

import argparse
from collections.abc import Callable
from typing import Any

from phfmu.cli.progress import StatusLine


def add_parser(verbs: Any) -> None:
    from phfmu.cli.codes import TARGET
    from phfmu.cli.settings import add_settings

    parser = verbs.add_parser("bench", help="error against run time, beside peers")
    parser.add_argument(
        "target",
        help=f"{TARGET} | chain:N, net:N, ladder:N | scaling | orders | leave-out | coupling | sweep | gradients | fit | blame",
    )
    parser.add_argument("--paper", action="store_true", help="figures, table and statements of the model's paper")
    parser.add_argument(
        "--schemes", metavar="LIST", help="NAME:ORDER[:GRADIENT], suzuki, kahan-li (default: what fits the target)"
    )
    parser.add_argument("--engines", metavar="LIST", default="native", help="native, python (default native)")
    parser.add_argument("--steps", metavar="LIST", help="steps in s, with commas (default: 8 to 1/2 of the scene's)")
    parser.add_argument("--tolerances", metavar="LIST", help="relative tolerances of peers (default 1e-3 ... 1e-10)")
    parser.add_argument(
        "--times", metavar="LIST", help="times in s at which states are compared (default: stop/10, stop)"
    )
    parser.add_argument("--stop", type=float, help="end of the timed runs in s (default: the scene's)")
    parser.add_argument(
        "--states", metavar="LIST", help="state variables in the error (default: all, the worst counts)"
    )
    parser.add_argument("--errors", metavar="LIST", help="error levels at which costs are compared")
    parser.add_argument("--repeat", type=int, default=5, help="timed runs per row, the median counts (default 5)")
    parser.add_argument("--peers", metavar="LIST", default="all", help="all, none or names with commas (default all)")
    parser.add_argument(
        "--families",
        metavar="LIST",
        help="scaling: chain, net, ladder; orders: names of the library; coupling: scenes (default: all)",
    )
    parser.add_argument("--sizes", metavar="LIST", help="scaling: sizes n (default: those of the family)")
    parser.add_argument("--seeds", metavar="LIST", default="1,2", help="blame: of the planted faults (default 1,2)")
    parser.add_argument("--cases", type=int, default=200, help="blame: faults of a seed (default 200)")
    parser.add_argument("--reference", metavar="CSV", help="states at the times: column time and one per state")
    add_settings(parser)
    parser.add_argument(
        "-o",
        "--output",
        metavar="DIR",
        help="folder of the files (default: bench); orders, leave-out, coupling, sweep, gradients, fit, blame: a file",
    )
    parser.set_defaults(call=call)


def call(args: argparse.Namespace) -> int:
    from pathlib import Path

    from phfmu.files import require_folder, require_writable
    from phfmu.studies.bench.machine import one_thread
    from phfmu.target import require_known

    one_thread()
    tables = {
        "orders": _orders,
        "leave-out": _leave_out,
        "coupling": _coupling,
        "sweep": _sweep,
        "gradients": _gradients,
        "fit": _fit,
        "blame": _blame,
    }
    require_known(args.target, [*tables, "scaling"])
    if args.target in tables:
        if args.output:
            require_writable(Path(args.output), f"-o {args.output}")
        return tables[args.target](args)
    args.output = args.output or "bench"
    require_folder(Path(args.output), f"-o {args.output}", "pages and pictures")
    if args.target == "scaling":
        return _scaling(args)
    return _paper(args) if args.paper else _compare(args)


def _scaling(args: argparse.Namespace) -> int:
    from pathlib import Path

    from phfmu.cli.codes import FINE
    from phfmu.studies.bench.scaling import report

    sizes = _numbers("--sizes", args.sizes)
    if any(n != int(n) for n in sizes):
        raise ValueError(f"--sizes {args.sizes}: expected whole numbers with commas between, e.g. 10,100,1000")
    with StatusLine() as progress:
        lines = report(_names(args.families), [int(n) for n in sizes], Path(args.output), progress)
    print("\n".join(lines))
    return FINE


def _leave_out(args: argparse.Namespace) -> int:
    from phfmu.studies.bench.leave_out import page, table

    return _paged(args, page, table)


def _coupling(args: argparse.Namespace) -> int:
    from functools import partial

    from phfmu.studies.bench.apart.coupling import page, table

    return _paged(args, page, partial(table, _names(args.families)))


def _sweep(args: argparse.Namespace) -> int:
    from phfmu.studies.bench.sweeps import page, table

    return _paged(args, page, table)


def _gradients(args: argparse.Namespace) -> int:
    from phfmu.studies.bench.gradients import page, table

    return _paged(args, page, table)


def _fit(args: argparse.Namespace) -> int:
    from functools import partial
    from pathlib import Path

    from phfmu.studies.bench.fits import page, table

    return _paged(args, partial(page, picture=Path(args.output or ".").parent / "img" / "fits.png"), table)


def _blame(args: argparse.Namespace) -> int:
    from phfmu.studies.blame.report import CampaignResult, measure, page, summary, table

    seeds = _numbers("--seeds", args.seeds)
    if any(s != int(s) for s in seeds) or args.cases < 1:
        raise ValueError(
            f"--seeds {args.seeds} --cases {args.cases}: expected positive whole numbers, e.g. --seeds 1,2 --cases 200"
        )

    def found(progress: StatusLine) -> list[CampaignResult]:
        return [measure(int(s), args.cases, progress) for s in seeds]

    def tables(progress: StatusLine) -> str:
        return "\n\n".join(f"{summary(f)}\n\n{table(f)}" for f in found(progress))

    return _paged(args, lambda progress: page(found(progress)), tables)


def _paged(args: argparse.Namespace, page: Callable[..., str], table: Callable[..., str]) -> int:
    """The page as a file, or its table."""
    from pathlib import Path

    from phfmu.cli.codes import FINE

    with StatusLine() as progress:
        text = page(progress) if args.output else table(progress=progress)
    if args.output:
        Path(args.output).write_text(text, encoding="utf-8")
        text = f"page: {args.output}"
    print(text)
    return FINE


def _orders(args: argparse.Namespace) -> int:
    from pathlib import Path

    from phfmu.cli.codes import FINE
    from phfmu.studies.bench.orders import measure, table

    with StatusLine() as progress:
        text = table(measure(_names(args.families), progress))
    if args.output:
        Path(args.output).write_text(text + "\n", encoding="utf-8")
    print(text)
    return FINE


def _compare(args: argparse.Namespace) -> int:
    from dataclasses import replace
    from pathlib import Path

    from phfmu.cli.codes import FINE
    from phfmu.cli.settings import settings
    from phfmu.studies.bench.families import member
    from phfmu.studies.bench.precision.problem import problem_of
    from phfmu.studies.bench.precision.run import TOLERANCES, ComparisonSettings, compare, known_peers, write
    from phfmu.target import scene

    if args.repeat < 1:
        raise ValueError(f"--repeat {args.repeat}: at least one timed run is needed")
    found = member(args.target) or scene(args.target)
    choice = ComparisonSettings(
        schemes=_names(args.schemes), engines=_names(args.engines), steps=_numbers("--steps", args.steps),
        tolerances=_numbers("--tolerances", args.tolerances) or TOLERANCES, peers=known_peers(_names(args.peers)),
        repeat=args.repeat, errors=_numbers("--errors", args.errors),
    )  # fmt: skip
    times, states = _numbers("--times", args.times), _names(args.states)
    if args.stop is None and times:
        args.stop = max(found.stop, *times)
    declared = found.declaration().with_starts(settings(args.set))
    problem = problem_of(replace(found, system=declared), times=times, stop=args.stop, judged=states)
    if args.reference:
        problem.read_reference(args.reference)
    with StatusLine() as progress:
        found = compare(problem, choice, progress)
    print("\n".join(write(found, Path(args.output))))
    return FINE


def _names(text: str | None) -> tuple[str, ...]:
    return tuple(t.strip() for t in text.split(",") if t.strip()) if text else ()


def _numbers(option: str, text: str | None) -> tuple[float, ...]:
    try:
        values = tuple(float(t) for t in _names(text))
    except ValueError:
        values = (0.0,)
    if not all(0 < v < float("inf") for v in values):
        raise ValueError(f"{option} {text}: expected positive numbers with commas between, e.g. 0.02,0.01")
    return values


def _paper(args: argparse.Namespace) -> int:
    from importlib.util import find_spec

    from phfmu.cli.codes import FINE, PROBLEMS
    from phfmu.studies.bench.paper import MODEL
    from phfmu.studies.bench.paper_figures import write
    from phfmu.target import load

    if args.target != MODEL:
        raise ValueError(f"--paper reproduces the paper of {MODEL} only: phfmu bench {MODEL} --paper -o DIR")
    if find_spec("matplotlib") is None:
        raise ValueError('figures need matplotlib: pip install "phfmu[report]"')
    found = write(load(args.target), args.output)
    for s in found:
        print(f"{'yes' if s.holds else 'NO '}  {s.number:12.4g}  {s.text}" + (f" ({s.remark})" if s.remark else ""))
    print(f"figures 3 to 6, table 1 and statements.csv in {args.output}")
    return FINE if all(s.holds or s.remark for s in found) else PROBLEMS
