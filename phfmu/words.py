"""Words that messages share: counts, and what a name that is not known may have meant."""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from difflib import get_close_matches

SHOWN = 12


def counted(n: int, noun: str) -> str:
    """`1 step`, `2 steps`, `3 line searches`."""
    return f"{n} {noun}{'' if n == 1 else 'es' if noun.endswith('ch') else 's'}"


def folded(names: Iterable[str]) -> str:
    """Names in a row, entries of a vector that follow each other as one: `q[1], v[1..3]`."""
    runs: list[tuple[str, int, int]] = []
    for name in names:
        base, _, index = name.partition("[")
        i = int(index[:-1]) if index else 0
        if runs and index and runs[-1][0] == base and runs[-1][2] == i - 1:
            runs[-1] = (base, runs[-1][1], i)
        else:
            runs.append((base, i, i))
    texts = ((base, f"{a}..{b}" if b > a else f"{a}") for base, a, b in runs)
    return ", ".join(f"{base}[{text}]" if text != "0" else base for base, text in texts)


def first_few(names: Sequence[str]) -> str:
    """`a, b, c`; of more than `SHOWN` the first, `.. and 5 more`."""
    more = f" and {len(names) - SHOWN} more" if len(names) > SHOWN else ""
    return f"{', '.join(names[:SHOWN])}{more}"


def shown(text: str) -> str:
    r"""Text of a file as one line that a terminal takes as text: control characters are written out, `\x1b`."""
    return "".join(c if c.isprintable() else c.encode("unicode_escape").decode() for c in text)


def meant(name: str, known: Iterable[str], otherwise: str = "") -> str:
    """`did you mean a, b?`; where nothing is close, `otherwise` or what there is."""
    names = list(dict.fromkeys(known))
    close = get_close_matches(name, names, 3)
    if close:
        return f"did you mean {', '.join(close)}?"
    if otherwise:
        return otherwise
    return f"there are: {first_few(names) or 'none'}"
