"""Options shared by verbs that discretise a model."""

from __future__ import annotations

import argparse
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from phfmu.declare.phdae import PHDAE
    from phfmu.discretise.scheme import Scheme


def add_scheme(parser: argparse.ArgumentParser) -> None:
    """--order, --scheme, --gradient, --closure."""
    from phfmu.discretise.scheme_names import CLOSURES, GRADIENTS, ORDERS, SCHEMES

    parser.add_argument("--order", type=int, default=2, choices=ORDERS, help="order of the scheme (default 2)")
    parser.add_argument("--scheme", default="auto", choices=SCHEMES,
                        help="auto: two-level with holonomic constraints, else collocated")  # fmt: skip
    parser.add_argument("--gradient", default="per-term", choices=GRADIENTS)
    parser.add_argument(
        "--closure",
        choices=CLOSURES,
        help="where algebraic variables of a step belong (semi-explicit, gradient-pair, dirac-dissipative)",
    )


def add_settings(parser: argparse.ArgumentParser) -> None:
    """--set NAME=VALUE."""
    parser.add_argument("--set", action="append", default=[], metavar="NAME=VALUE",
                        help="parameter, start value of a state, or start of an input; may be repeated")  # fmt: skip


def tolerance(rtol: float) -> float:
    """--rtol checked."""
    if not 0 <= rtol < float("inf"):
        raise ValueError(f"--rtol {rtol}: expected a number from 0, e.g. 1e-11")
    return rtol


def settings(items: list[str]) -> dict[str, float]:
    """NAME=VALUE items; ValueError names the bad one."""
    out = {}
    for item in items:
        name, sign, text = item.partition("=")
        try:
            value = float(text)
        except ValueError:
            value = float("nan")
        if not sign or value != value or value in (float("inf"), float("-inf")):
            raise ValueError(f"--set {item}: expected NAME=VALUE with a finite number")
        out[name.strip()] = value
    return out


def scheme_of(args: argparse.Namespace, declaration: PHDAE, *, member: bool = False) -> Scheme:
    """The scheme asked for; members without constraints fall back to collocated under auto and two-level."""
    from phfmu.discretise.schemes import named_scheme

    name: Any = args.scheme
    if member and name == "two-level" and not declaration.constraints:
        name = "collocated"
    return named_scheme(declaration, name, args.order, args.gradient, args.closure)
