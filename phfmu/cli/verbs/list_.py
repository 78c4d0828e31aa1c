"""phfmu list: the library, one line each."""

from __future__ import annotations

import argparse
from typing import Any


def add_parser(verbs: Any) -> None:
    parser = verbs.add_parser("list", help="components and scenes, one line each")
    parser.set_defaults(call=call)


def call(args: argparse.Namespace) -> int:
    from phfmu.components.library import TABLE

    del args
    width = max(map(len, TABLE))
    for kind in ("component", "scene"):
        print(f"{kind}s")
        for name, (what, _, line) in TABLE.items():
            if what == kind:
                print(f"  {name:<{width}}  {line}")
    return 0
