"""Messages about a wrong command line: one line with what was meant, and where the options are listed."""

from __future__ import annotations

import argparse
import re
import sys
from collections.abc import Mapping, Sequence
from typing import NoReturn

from phfmu.cli.codes import USAGE
from phfmu.words import meant, shown

#: how argparse tells a word that is none of several; it hands over no more than the text
_CHOICE = re.compile(r"invalid choice: '?(?P<word>.*?)'? \(choose from (?P<known>.*)\)")


class Parser(argparse.ArgumentParser):
    """`error` is argparse's place for this: its own is the usage, a screen of it for some verbs, before the line.

    verbs: name -> parser of a verb, once they are there
    """

    verbs: Mapping[str, argparse.ArgumentParser] = {}

    def error(self, message: str) -> NoReturn:
        """Say it in a line and leave with exit code 2."""
        found = _CHOICE.search(message)
        close = meant(found["word"], re.findall(r"[\w.-]+", found["known"]), " ") if found else " "
        remedy = "" if close == " " else f"; {close}"
        print(f"phfmu: {shown(message)}{remedy} (see: {self.prog} --help)", file=sys.stderr)
        sys.exit(USAGE)


def parsed(parser: Parser, words: Sequence[str]) -> argparse.Namespace:
    """The arguments, names also after options; what no option takes is told by the verb, with the option that was meant."""
    args, rest = parser.parse_known_args(words)
    if rest:
        verb = parser.verbs[args.verb]
        if not any(word.startswith("-") for word in rest) and words[0] == args.verb:
            args, rest = verb.parse_known_intermixed_args(list(words)[1:], argparse.Namespace(verb=args.verb))
    if rest:
        options = [word for action in verb._actions for word in action.option_strings]
        unknown = next((word for word in rest if word.startswith("-")), None)
        close = meant(unknown.partition("=")[0], options, " ") if unknown else " "
        verb.error(f"unrecognized arguments: {' '.join(rest)}" + ("" if close == " " else f"; {close}"))
    return args
