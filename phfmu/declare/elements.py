"""Names of the entries of a vector, for readers of pictures and reports: windings d, q, 0, fd, kd; phases a, b, c.

Columns of tables and variables of units keep their numbers, `gen.I[4]`, which programs and other tools bind to.
"""

from __future__ import annotations

import re
from collections.abc import Sequence

from phfmu.declare.error import DeclarationError

#: what a name may hold, so that it can stand in brackets
_NAME = re.compile(r"[^\s\[\],*?]+")
_INDEX = re.compile(r"\[\d+\]$")


def element_names(entry: str, elements: Sequence[str], size: int | None) -> tuple[str, ...]:
    """The names of `size` entries as they are declared, () for none; DeclarationError for those that do not fit."""
    found = tuple(elements)
    if not found:
        return ()
    if isinstance(elements, str) or len(found) != size:
        told = f"{len(found)} elements ({', '.join(found)}) name {'a scalar' if size is None else f'{size} entries'}"
        raise DeclarationError(
            entry, told, 'give a list with one name for each entry, e.g. elements=("a", "b", "c")', "shape"
        )
    wrong = [n for i, n in enumerate(found) if not _NAME.fullmatch(n) or n in found[:i]]
    if wrong:
        remedy = "give each entry a name of its own, without blanks, commas, stars and brackets"
        raise DeclarationError(entry, f"'{wrong[0]}' is no name of an element", remedy, "shape")
    return found


def labelled(names: Sequence[str], elements: Sequence[str]) -> list[str]:
    """Names with indices -> with the names of the elements: `psi[1]` -> `psi[d]`."""
    if not elements:
        return list(names)
    return [_INDEX.sub(f"[{e}]", n) for n, e in zip(names, elements, strict=True)]
