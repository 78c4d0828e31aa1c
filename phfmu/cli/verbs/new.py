"""phfmu new: a component or scene to begin with, in a file that runs, and a test for it."""

from __future__ import annotations

import argparse
from pathlib import Path
from typing import Any

KINDS = ("component", "scene")


def add_parser(verbs: Any) -> None:
    parser = verbs.add_parser("new", help="a file with a component or scene to begin with, and a test for it")
    parser.add_argument("kind", choices=KINDS)
    parser.add_argument("name", help="of the function and of its file, e.g. tank")
    parser.add_argument("-o", "--output", default=".", metavar="DIR", help="folder for the files (default: here)")
    parser.set_defaults(call=call)


def call(args: argparse.Namespace) -> int:
    from importlib.util import find_spec

    from phfmu.cli.codes import FINE

    _require_name(args.name)
    folder = Path(args.output)
    if not folder.is_dir():
        raise ValueError(f"-o {args.output}: there is no such folder; make it first")
    made = folder / f"{args.name}.py", folder / f"test_{args.name}.py"
    if there := [str(path) for path in made if path.exists()]:
        raise ValueError(f"{' and '.join(there)} would be replaced; choose another name or folder")
    for path, starter in zip(made, (args.kind, f"test_{args.kind}"), strict=True):
        path.write_text(_text(starter).replace("NAME", args.name), encoding="utf-8")
    part, test = made
    print(f"{part}: a {args.kind} that runs, with comments on what to change\n{test}: its test\n")
    extra = "" if find_spec("pytest") else "    (after: pip install pytest)"
    for line in (f"phfmu check {part}", f"phfmu run {part} --plot {part.with_suffix('.png')}", f"pytest {test}{extra}"):
        print(f"  {line}")
    return FINE


def _text(starter: str) -> str:
    from importlib.resources import files

    return (files("phfmu.cli") / "starters" / f"{starter}.py.txt").read_text(encoding="utf-8")


def _require_name(name: str) -> None:
    """Raise ValueError for a text that is no name of a function, or that of a module that the file would hide."""
    import re
    from importlib.util import find_spec
    from keyword import iskeyword

    if not name.isidentifier() or iskeyword(name) or name.startswith("_"):
        close = re.sub(r"\W+", "_", name).lstrip("_0123456789")
        hint = f", e.g. {close}" if close and not iskeyword(close) else ""
        raise ValueError(f"'{name}' is no name of a function; letters, digits and _ only, a letter first{hint}")
    spec = find_spec(name)
    if spec is not None and spec.origin is not None and not Path(f"{name}.py").exists():
        raise ValueError(f"there is a module '{name}' that {name}.py would hide from Python; choose another name")
