"""Signals by name or pattern."""

import re
from collections.abc import Sequence

from phfmu.words import meant


def pick(patterns: Sequence[str], names: Sequence[str], where: str, hint: str = "") -> list[str]:
    """Names that the patterns mean, each once, in the order of the patterns and then of the file.

    `*` stands for any text, `?` for one letter, brackets for themselves: `gen.*`, `*.I[1]`. The bare name of a vector is
    all of it. Errors: ValueError for a pattern that means none, with close names and `hint`.
    """
    found: dict[str, None] = {}
    for pattern in patterns:
        chosen = matching(pattern, names)
        if not chosen:
            known = [*names, *dict.fromkeys(n.partition("[")[0] for n in names)]
            raise ValueError(
                f"{where} has no signal '{_short(pattern)}'; {meant(_short(pattern), known)}{hint and f'; {hint}'}"
            )
        found |= dict.fromkeys(chosen)
    return list(found)


def matching(pattern: str, names: Sequence[str]) -> list[str]:
    """Names that one pattern of `pick` means, in their order; none where there is none."""
    wanted = _compiled(pattern)
    return [n for n in names if wanted.fullmatch(n) or wanted.fullmatch(n.partition("[")[0])]


def _compiled(pattern: str) -> re.Pattern[str]:
    """The text between two stars is taken at its first place and never looked for again: no number of stars takes long."""
    first, *rest = [re.escape(part).replace(r"\?", ".") for part in re.split(r"\*+", pattern)]
    if not rest:
        return re.compile(first)
    *between, last = rest
    return re.compile(f"{first}{''.join(f'(?>.*?{part})' for part in between)}.*{last}")


def _short(pattern: str, most: int = 100) -> str:
    return pattern if len(pattern) <= most else f"{pattern[: most - 3]}..."
