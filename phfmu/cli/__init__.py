"""The command line: one verb a file, heavy imports inside the verb.

Exit codes: `codes.py`.
"""

from __future__ import annotations

import argparse
import io
import os
import signal
import sys
from collections.abc import Sequence

from phfmu.cli.codes import FINE, NO_CONVERGENCE, USAGE
from phfmu.cli.parser import Parser, parsed
from phfmu.interrupt import raising


def _parser() -> Parser:
    from phfmu import __version__
    from phfmu.cli.verbs import (
        bench,
        check,
        completion,
        export,
        fit,
        info,
        list_,
        modes,
        new,
        replay,
        run,
        stress,
        sweep,
        vet,
    )
    from phfmu.cli.verbs.results import audit, compare, plot, report, view

    parser = Parser(
        prog="phfmu", description="Port-Hamiltonian DAEs as co-simulation components with exact energy balance."
    )
    parser.add_argument("--version", action="version", version=f"phfmu {__version__}")
    verbs = parser.add_subparsers(dest="verb", metavar="VERB", required=True)
    for module in (
        list_,
        new,
        info,
        check,
        run,
        sweep,
        plot,
        view,
        report,
        compare,
        fit,
        modes,
        export,
        audit,
        replay,
        vet,
        bench,
        stress,
        completion,
    ):
        module.add_parser(verbs)
    completion.complete(parser, verbs)
    parser.verbs = verbs.choices
    return parser


def main(arguments: Sequence[str] | None = None) -> int:
    """Run one verb; returns the exit code."""
    for stream in (sys.stdout, sys.stderr):
        if isinstance(stream, io.TextIOWrapper):  # names and descriptions that the terminal has no letters for
            stream.reconfigure(errors="backslashreplace")
    parser, words = _parser(), sys.argv[1:] if arguments is None else list(arguments)
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
