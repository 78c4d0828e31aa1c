"""phfmu fit: parameters, start values and inputs from measurements."""

from __future__ import annotations

import argparse
import json
from pathlib import Path
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from phfmu.cli.one_model import MembersApart, OneModel
    from phfmu.derivatives.fits.fit import Experiment, Fit

LOSSES = ("linear", "soft_l1", "huber", "cauchy", "arctan")


def add_parser(verbs: Any) -> None:
    from phfmu.cli.codes import TARGET
    from phfmu.cli.one_model import add_one_model
    from phfmu.network.couplings.coupling_table import AUTO, COUPLINGS
    from phfmu.network.members.interpolations import INTERPOLATIONS

    parser = verbs.add_parser("fit", help="parameters from measurements, by least squares with exact derivatives")
    parser.add_argument("target", help=TARGET)
    parser.add_argument(
        "data", help="measurements, .csv or .parquet: time, then signals of the model; nan where there are none"
    )
    parser.add_argument("--free", metavar="NAME,NAME", required=True,
                        help="what is sought, from its present value: parameters, start values, held inputs")  # fmt: skip
    parser.add_argument("--measure", metavar="SIGNAL,SIGNAL", required=True, help="columns of the data, and of the run")
    parser.add_argument("--experiment", action="append", default=[], metavar="FILE[:NAME=VALUE,..]",
                        help="more measurements, of a run with these values set; may be repeated")  # fmt: skip
    parser.add_argument("--weight", action="append", default=[], metavar="SIGNAL=SIZE",
                        help="standard deviation of the noise of a signal (default: the largest size of its data)")  # fmt: skip
    parser.add_argument("--bounds", action="append", default=[], metavar="NAME=LEAST:MOST",
                        help="of a free value (default: the limits of the parameter, see phfmu info)")  # fmt: skip
    parser.add_argument("--tries", type=int, default=1, metavar="N",
                        help="begin N times, also at values around those given, and keep the best")  # fmt: skip
    parser.add_argument("--loss", default="linear", choices=LOSSES, help="how residuals count (default: their squares)")
    parser.add_argument("--stop", type=float, help="stop time in s (default: after the last measurement)")
    add_one_model(parser)
    parser.add_argument("--coupling", default="monolithic", choices=[n for n in COUPLINGS if n != AUTO.name],
                        help="of the members of a network that are stepped apart (default: as one composed model)")  # fmt: skip
    parser.add_argument("--input", metavar="FILE", help="input values over time, as of phfmu run")
    parser.add_argument("--interpolate", default="held", choices=tuple(INTERPOLATIONS), help="as of phfmu run")
    parser.add_argument("--plot", metavar="FILE", help="picture of data, fit and residuals, X.png or X.html")
    parser.add_argument(
        "-o", "--output", metavar="FILE", help="what was found, X.json; phfmu run --set @X.json takes it"
    )
    parser.add_argument("--resume", metavar="FILE",
                        help="keep the runs in FILE; if it is there, go on with the fit that left it")  # fmt: skip
    parser.add_argument("--quiet", action="store_true", help="print nothing but errors")
    parser.set_defaults(call=call)


def call(args: argparse.Namespace) -> int:
    from phfmu.cli.codes import FINE
    from phfmu.cli.one_model import members_apart, one_model
    from phfmu.cli.progress import StatusLine
    from phfmu.cli.sensitivity import listed
    from phfmu.derivatives.fits.fit import fit
    from phfmu.interrupt import DeferredInterrupt

    if args.output and not args.output.endswith(".json"):
        raise ValueError(f"-o {args.output}: its name ends with .json")
    if args.plot:
        from phfmu.report.picture.draw import check_picture

        check_picture(args.plot, "--plot")
    one = one_model(args) if args.coupling == "monolithic" else members_apart(args, args.coupling)
    experiments = _experiments(args, one)
    instance = one.instance(100.0 * max(e.options.stop / e.options.step for e in experiments))
    with DeferredInterrupt() as signals, StatusLine() as line:

        def progress(runs: int, residual: float) -> None:
            signals.check()
            if not args.quiet:
                line(f"run {runs}: residual {residual:.4g}")

        found = fit(
            one.model, instance, experiments, listed(args.free), listed(args.measure),
            weights=_numbers(args.weight, "--weight"), bounds=_bounds(args.bounds), tries=args.tries, loss=args.loss,
            progress=progress, resume=args.resume,
        )  # fmt: skip
    if not args.quiet:
        print("\n".join(_lines(args, found)))
    if args.output:
        Path(args.output).write_text(json.dumps(as_json(found), indent=2) + "\n")
    if args.plot:
        from phfmu.derivatives.fits.fit_picture import picture_of
        from phfmu.report.picture.draw import draw

        draw(picture_of(found), args.plot)
    return FINE


def _numbers(items: list[str], option: str) -> dict[str, float]:
    """NAME=VALUE items; ValueError for the bad one."""
    found = {}
    for item in items:
        name, _, text = item.partition("=")
        try:
            found[name.strip()] = float(text)
        except ValueError:
            raise ValueError(f"{option} {item}: expected NAME=VALUE") from None
    return found


def _bounds(items: list[str]) -> dict[str, tuple[float, float]]:
    """NAME=LEAST:MOST items, of which one side may be empty."""
    found = {}
    for item in items:
        name, _, text = item.partition("=")
        low, sign, high = text.partition(":")
        try:
            found[name.strip()] = float(low or "-inf"), float(high or "inf")
        except ValueError:
            sign = ""
        if not sign or not found[name.strip()][0] < found[name.strip()][1]:
            raise ValueError(f"--bounds {item}: expected NAME=LEAST:MOST, as R=0.1:10")
    return found


def _experiments(args: argparse.Namespace, one: OneModel | MembersApart) -> list[Experiment]:
    from math import ceil

    from phfmu.cli.sensitivity import listed
    from phfmu.cli.settings import settings
    from phfmu.cli.timeline import timeline
    from phfmu.derivatives.fits.fit import Experiment
    from phfmu.results.file import open_result
    from phfmu.runs.options import Options

    step = one.step
    events, inputs, _ = timeline(args, one.scene, one.settable())
    found = []
    for text in [args.data, *args.experiment]:
        path, _, given = text.partition(":") if text is not args.data else (text, "", "")
        data = open_result(path)
        stop = args.stop if args.stop is not None else step * max(1, ceil(float(data.time[-1]) / step - 1e-9))
        own = Options(stop=stop, step=step, events=[e for e in events if e.t < stop], project=args.project)
        found.append(Experiment(text, data, own, settings(listed(given)), inputs, args.interpolate))
    return found


def _lines(args: argparse.Namespace, found: Fit) -> list[str]:
    """Table of the values that were found, by lines."""
    from phfmu.words import counted

    n = sum(len(times) for _, _, times, _, _ in found.curves)
    lines = [
        f"{args.target}: {counted(len(found.free), 'value')} from {counted(n, 'measurement')}; "
        f"{counted(found.iterations, 'iteration')}, {counted(found.runs, 'run')}",
        found.message,
        "",
        f"{'name':24}{'value':>16}{'standard error':>18}{'relative':>12}",
    ]
    for name, value in found.values.items():
        error = found.errors[name]
        told = "not told" if error == float("inf") else f"{error:.3g}"
        part = "" if error == float("inf") or not value else f"{100 * error / abs(value):.2g} %"
        lines.append(f"{name:24}{value:16.9g}{told:>18}{part:>12}")
    lines += ["", *(f"{name}: residual {r:.4g} (root mean square)" for name, r in found.residuals.items())]
    for direction in found.undetermined:
        lines.append(
            f"the data do not tell: {', '.join(f'{v:+.2g} {n}' for n, v in direction.items())} (of their sizes)"
        )
    pairs = [
        (abs(found.correlation[i, j]), a, b, found.correlation[i, j])
        for i, a in enumerate(found.free)
        for j, b in enumerate(found.free[:i])
    ]
    lines += [
        f"{a} and {b} go together: correlation {c:.4f}"
        for size, a, b, c in sorted(pairs, reverse=True)[:5]
        if size > 0.95
    ]
    lines += [
        f"{name}: residuals follow each other (correlation {c:.2f} from row to row): the model misses something"
        for name, c in found.misfit.items()
    ]
    if found.sequences > 1:
        lines.append(f"runs had {found.sequences} sequences of state events: where one follows another residuals have a kink, "
                     "at which a fit may stop; --tries begins at other values too")  # fmt: skip
    if found.between:
        lines.append(f"{counted(found.between, 'measurement')} between two rows of the run: taken on the line between them; "
                     "a step that meets their times avoids it")  # fmt: skip
    lines += [f"written: {path}" for path in (args.output, args.plot) if path]
    return lines


def as_json(found: Fit) -> dict[str, Any]:
    """The content of the file."""
    return {
        "values": found.values,
        "errors": {n: None if e == float("inf") else e for n, e in found.errors.items()},
        "residual": found.residual,
        "residuals": found.residuals,
        "iterations": found.iterations,
        "runs": found.runs,
        "message": found.message,
        "correlation": {
            "names": list(found.free),
            "matrix": [[None if c != c else c for c in row] for row in found.correlation.tolist()],
        },
        "singular_values": found.singular.tolist(),
        "undetermined": list(found.undetermined),
        "misfit": found.misfit,
        "sequences": found.sequences,
    }
