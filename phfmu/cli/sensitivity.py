"""--sensitivity: derivatives of a run beside its columns."""

from __future__ import annotations

import argparse
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from phfmu.derivatives.apart.sensitive_members import SensitiveMembers
    from phfmu.derivatives.sensitive import SensitiveSteps
    from phfmu.discretise.model import Model
    from phfmu.network.couplings.coupled import Coupled


def names_of(args: argparse.Namespace) -> list[str]:
    """Names that results are differentiated by; none without the option."""
    return listed(getattr(args, "sensitivity", None) or "")


def listed(text: str) -> list[str]:
    """Items between commas."""
    return [n.strip() for n in text.split(",") if n.strip()]


def require_equal_steps(args: argparse.Namespace, engine: str) -> None:
    """Raise ValueError for options that derivatives do not go with."""
    odd = {
        "--rtol": args.rtol, "--dense": args.dense,
        "--audit-detail": args.audit_detail, "--engine fmu": engine == "fmu",
    }  # fmt: skip
    if found := [name for name, value in odd.items() if value]:
        raise ValueError(
            f"{args.target}: --sensitivity and {found[0]} do not go together: derivatives are told of equal steps, row by row"
        )


def sensitive(args: argparse.Namespace, model: Model, instance: Any) -> SensitiveSteps:
    """The model stepped with derivatives of the columns that --signals keeps."""
    from phfmu.derivatives.sensitive import SensitiveSteps
    from phfmu.network.members.columns import SignalColumns
    from phfmu.pick import pick

    names = SignalColumns(model, instance.layout).names
    chosen = pick(args.signals, names, args.target) if args.signals else None
    return SensitiveSteps(model, instance, names_of(args), chosen)


def sensitive_members(args: argparse.Namespace, apart: Coupled) -> SensitiveMembers:
    """Members stepped apart with derivatives of the columns that --signals keeps."""
    from phfmu.derivatives.apart.sensitive_members import SensitiveMembers
    from phfmu.pick import pick

    made = SensitiveMembers(apart, names_of(args))
    if args.signals:
        kept = pick(args.signals, made.own_names, args.target)
        made.choose([n for n in kept if n in made.derivable] or kept)
    return made
