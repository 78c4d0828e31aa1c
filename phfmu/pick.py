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
        wanted = re.compile(re.escape(pattern).replace(r"\*", ".*").replace(r"\?", "."))
        chosen = [n for n in names if wanted.fullmatch(n) or wanted.fullmatch(n.partition("[")[0])]
        if not chosen:
            known = [*names, *dict.fromkeys(n.partition("[")[0] for n in names)]
            raise ValueError(f"{where} has no signal '{pattern}'; {meant(pattern, known)}{hint and f'; {hint}'}")
        found |= dict.fromkeys(chosen)
    return list(found)
