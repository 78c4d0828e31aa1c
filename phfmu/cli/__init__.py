"""The command line: one verb a file, heavy imports inside the verb.

Exit codes: `codes.py`.
"""

from __future__ import annotations

import argparse
import io
import os
import signal
import sys
from collections.abc import Iterable, Sequence
from importlib import import_module

from phfmu.cli.codes import FINE, NO_CONVERGENCE, USAGE
from phfmu.cli.parser import Parser, parsed
from phfmu.interrupt import raising

#: verbs in the order of `phfmu --help`, and their modules
VERBS = {
    "list": "list_",
    "new": "new",
    "info": "info",
    "check": "check",
    "run": "run",
    "sweep": "sweep",
    "plot": "results.plot",
    "view": "results.view",
    "report": "results.report",
    "compare": "results.compare",
    "fit": "fit",
    "modes": "modes",
    "export": "export",
    "audit": "results.audit",
    "replay": "replay",
    "vet": "vet",
    "bench": "bench",
    "stress": "stress",
    "completion": "completion",
}


def _parser(asked: Iterable[str] = VERBS) -> Parser:
    """The parser of the verbs that are asked for; what other verbs need is not loaded."""
    from phfmu import __version__

    parser = Parser(
        prog="phfmu", description="Port-Hamiltonian DAEs as co-simulation components with exact energy balance."
    )
    parser.add_argument("--version", action="version", version=f"phfmu {__version__}")
    verbs = parser.add_subparsers(dest="verb", metavar="VERB", required=True)
    for name in asked:
        import_module(f"phfmu.cli.verbs.{VERBS[name]}").add_parser(verbs)
    parser.verbs = verbs.choices
    return parser


def _asked(words: Sequence[str]) -> Parser:
    """The parser for a command line: of its verb, or of all where it begins with none; a shell may ask what completes it."""
    if "_ARGCOMPLETE" in os.environ:
        from phfmu.cli.verbs.completion import complete

        parser = _parser()
        complete(parser)
        return parser
    return _parser(words[:1] if words and words[0] in VERBS else VERBS)


def main(arguments: Sequence[str] | None = None) -> int:
    """Run one verb; returns the exit code."""
    for stream in (sys.stdout, sys.stderr):
        if isinstance(stream, io.TextIOWrapper):  # names and descriptions that the terminal has no letters for
            stream.reconfigure(errors="backslashreplace")
    words = sys.argv[1:] if arguments is None else list(arguments)
    parser = _asked(words)
    if not words:
        parser.print_help(sys.stderr)
        print("\nphfmu: required: VERB; start with `phfmu list`", file=sys.stderr)
        return USAGE
    args = parsed(parser, words)
    with raising():
        return _called(args)


def _called(args: argparse.Namespace) -> int:
    """The exit code of the verb."""
    if os.environ.get("PHFMU_TRACEBACK"):
        return args.call(args)
    try:
        return args.call(args)
    except BrokenPipeError:
        os.dup2(os.open(os.devnull, os.O_WRONLY), sys.stdout.fileno())
        return FINE
    except KeyboardInterrupt as stop:
        _say(stop, f"interrupted{f' ({stop})' if stop.args else ''}")
        return 128 + getattr(stop, "number", signal.SIGINT)
    except Exception as error:
        return _report(error)


def _report(error: Exception) -> int:
    """The problems on stderr, a line for each, and the exit code."""
    from phfmu.outcome.status import StepFailure

    text = error.args[0] if isinstance(error, KeyError) and error.args else str(error)
    known = (ValueError, KeyError, OSError, RuntimeError)
    if not isinstance(error, known):
        text = f"internal error: {type(error).__name__}: {text} (set PHFMU_TRACEBACK=1 for the traceback)"
    _say(error, text)
    return NO_CONVERGENCE if isinstance(error, StepFailure) else USAGE


def _say(error: BaseException, text: str) -> None:
    """The lines of an error and of its notes."""
    for part in (text, *getattr(error, "__notes__", ())):
        for line in part.splitlines() or [""]:
            print(f"phfmu: {line}", file=sys.stderr)
