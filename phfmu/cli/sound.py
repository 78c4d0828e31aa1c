"""Values that `phfmu check` refuses are refused before a run, unless --no-check is given."""

from __future__ import annotations

import argparse
from collections.abc import Sequence
from dataclasses import replace
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from phfmu.declare.phdae import PHDAE
    from phfmu.network.scene import Event, Scene


def add_no_check(parser: argparse.ArgumentParser) -> None:
    """--no-check."""
    parser.add_argument("--no-check", action="store_true",
                        help="go on with values that `check` refuses: negative resistances, masses that are zero ..")  # fmt: skip


def require_sound(args: argparse.Namespace, declaration: PHDAE, events: Sequence[Event] | None = None) -> None:
    """Raise ValueError with the problems of the values of this run, as `phfmu check` tells them; none with --no-check.

    `events`: what they make of the parameters; None: the start.
    """
    parameters = {n for v in declaration.parameters for n in (v.name, *v.names())}
    if args.no_check or (events is not None and not any(e.name in parameters for e in events)):
        return
    from phfmu.checks.run_values import check_values

    problems = check_values(declaration, events=events or ())
    if problems:
        lines = "\n".join(f"  {p}" for p in problems)
        raise ValueError(f"{args.target}: refused for its values or units (--no-check goes on anyway):\n{lines}")


def require_sound_scene(args: argparse.Namespace, s: Scene, events: Sequence[Event] | None = None) -> None:
    """`require_sound` of the whole, or, where units are in it, of each declared member."""
    from phfmu.network.network import Network

    network = s.system if isinstance(s.system, Network) else None
    members = network.declared if network is not None else {}
    if network is not None and events is None and not network.wires:  # many are quickly seen to be sound
        from phfmu.checks.run_values import sound_members

        if args.no_check or sound_members(members.values()):
            return None
    if not s.units:
        return require_sound(args, s.declaration(), events)
    for name, declaration in members.items():
        own = [replace(e, name=e.name.removeprefix(f"{name}.")) for e in events or () if e.name.startswith(f"{name}.")]
        require_sound(args, declaration, None if events is None else own)
    return None
