"""phfmu modes: eigenvalues of a model at a time of its run, with frequency, damping and the states that take part."""

from __future__ import annotations

import argparse
import json
from math import pi
from pathlib import Path
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from phfmu.derivatives.modes import Eigenmodes

#: modes that are printed without --all
MOST = 24
#: of eigenvalues
ROUNDING = 1e-11


def add_parser(verbs: Any) -> None:
    from phfmu.cli.codes import TARGET
    from phfmu.cli.one_model import add_one_model

    parser = verbs.add_parser("modes", help="eigenvalues at a time: frequency, damping, states that take part")
    parser.add_argument("target", help=TARGET)
    parser.add_argument("--at", type=float, default=0.0, metavar="T", help="time of the run in s (default 0)")
    parser.add_argument("--period", type=float, metavar="P",
                        help="of the motion in s, 0.02 of a grid in phase quantities: modes of one period from T on")  # fmt: skip
    add_one_model(parser)
    parser.add_argument("--all", action="store_true", help=f"all modes, not the {MOST} that decay most slowly")
    parser.add_argument("-o", "--output", metavar="FILE", help="the modes as X.json")
    parser.set_defaults(call=call)


def call(args: argparse.Namespace) -> int:
    from phfmu.cli.codes import FINE
    from phfmu.cli.one_model import one_model
    from phfmu.cli.settings import settings
    from phfmu.cli.timeline import started
    from phfmu.derivatives.modes import modes_at
    from phfmu.derivatives.tangents import require_smooth
    from phfmu.network.couplings.monolithic import Monolithic
    from phfmu.runs.loop import run
    from phfmu.runs.options import Options

    if args.output and not args.output.endswith(".json"):
        raise ValueError(f"-o {args.output}: its name ends with .json")
    if not args.at >= 0:
        raise ValueError(f"--at {args.at:g} s must not be negative")
    one = one_model(args)
    require_smooth(one.model)
    step, instance = one.step, one.instance(args.at / one.step + 1.0)
    stepper = Monolithic(one.model, instance)
    events, _ = started(one.scene.events, settings(args.set), stepper.settable())
    until = [e for e in events if e.t <= args.at]
    if args.at > 0:
        run(stepper, Options(stop=args.at, step=step, events=until, project=args.project, audited=False))
    else:
        for e in until:
            stepper.set_value(e.name, e.value)
        if args.project:
            stepper.project_start(0.0)
        stepper.check_start()
    found = modes_at(one.model, instance, args.at, step, args.period)
    print("\n".join(_lines(args, found)))
    if args.output:
        Path(args.output).write_text(json.dumps(as_json(found), indent=2) + "\n")
    return FINE


def _lines(args: argparse.Namespace, found: Eigenmodes) -> list[str]:
    from phfmu.derivatives.modes import names_of
    from phfmu.words import counted

    over = f"one step of {found.step:g} s" if found.period is None else f"one period of {found.period:g} s"
    gone = f"; {counted(found.gone, 'direction')} that constraints leave nothing of" if found.gone else ""
    lines = [f"{args.target}: {counted(len(found.modes), 'mode')} of {over} at t = {found.t:g} s{gone}", ""]
    lines.append(f"{'Re s in 1/s':>14}{'Hz':>12}{'damping':>10}{'Re of the model':>17}{'Hz':>12}  states")
    shown = found.modes if args.all else found.modes[:MOST]
    for m in shown:
        real, hertz = _rounded(m.s, found.step)
        damping = m.damping if real else 0.0
        own = f"{'':17}{'':12}" if m.model is None else "{:17.6g}{:12.6g}".format(*_rounded(m.model, found.step))
        lines.append(f"{real:14.6g}{hertz:12.6g}{damping:10.4f}{own}  {names_of(m.shares)}")
    if len(shown) < len(found.modes):
        lines.append(f"and {len(found.modes) - len(shown)} more (--all)")
    return lines


def _rounded(s: complex, step: float) -> tuple[float, float]:
    """Re s and the frequency [Hz], 0 where they are rounding beside |s| and what a step resolves."""
    least = ROUNDING * max(abs(s), 1.0 / step)
    return (s.real if abs(s.real) > least else 0.0), (abs(s.imag) / (2 * pi) if abs(s.imag) > least else 0.0)


def as_json(found: Eigenmodes) -> dict[str, Any]:
    """The content of the file."""
    return {
        "t": found.t, "step": found.step, "period": found.period, "gone": found.gone,
        "modes": [
            {
                "real": m.s.real, "imag": m.s.imag, "frequency": m.frequency, "damping": m.damping,
                "model": None if m.model is None else [m.model.real, m.model.imag],
                "participation": dict(m.shares),
            }
            for m in found.modes
        ],
    }  # fmt: skip
