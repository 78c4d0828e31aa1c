"""phfmu completion: what a shell needs to complete verbs, options and targets."""

from __future__ import annotations

import argparse
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from phfmu.cli.parser import Parser

#: eval "$(phfmu completion bash)"
SHELLS = ("bash", "zsh", "fish", "tcsh", "powershell")


def add_parser(verbs: Any) -> None:
    parser = verbs.add_parser("completion", help='completion by TAB: eval "$(phfmu completion bash)"')
    parser.add_argument("shell", choices=SHELLS)
    parser.set_defaults(call=call)


def call(args: argparse.Namespace) -> int:
    from argcomplete.shell_integration import shellcode

    from phfmu.cli.codes import FINE

    print(shellcode(["phfmu"], shell=args.shell))
    return FINE


def complete(parser: Parser) -> None:
    """Answer the shell that asks, and leave."""
    from argcomplete import autocomplete

    actions: list[Any] = [action for verb in parser.verbs.values() for action in verb._actions]
    for action in actions:
        if action.dest == "target":
            action.completer = targets
    autocomplete(parser)


def targets(prefix: str, **_: Any) -> list[str]:
    """Names of the library, files, and functions of a file whose name is complete."""
    from pathlib import Path

    from argcomplete.completers import FilesCompleter

    from phfmu.components.library import TABLE
    from phfmu.target import functions

    file, colon, _function = prefix.rpartition(":")
    if colon:
        return [f"{file}:{name}" for name in functions(Path(file))] if Path(file).is_file() else []
    files = FilesCompleter(("py", "fmu", "ssp", "ssd", "parquet", "csv"))(prefix)
    return [name for name in TABLE if name.startswith(prefix)] + list(files)
