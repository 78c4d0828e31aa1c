"""Limits of what reading an archive may cost; beyond them the archive is refused with the number and the way out.

The numbers hold units of a hundred thousand variables and keep the memory that a hostile archive can take near 100 MB.
"""

from __future__ import annotations

import os

from phfmu.fmu.export.variables import FMUError

#: multiplies every limit, for a large unit that is trusted
FACTOR = "PHFMU_LIMITS"

#: files of an archive, and bytes of its list of files
ENTRIES = 20_000
DIRECTORY = 4 * 2**20
#: bytes of all files when extracted, and how often longer than packed they may be (beyond FREE bytes)
EXTRACTED = 2 * 2**30
RATIO = 150
FREE = 16 * 2**20
#: bytes of modelDescription.xml, which is read tag by tag, and of other documents, which are held
DESCRIPTION = 64 * 2**20
DOCUMENT = 2 * 2**20
#: bytes of one tag, tags of a document, tags within each other
TAG = 2**20
TAGS = 600_000
DEPTH = 100
#: variables of any type (entries of arrays counted), characters of a name
VARIABLES = 100_000
NAME = 1000


def within(where: object, found: int, limit: int, what: str) -> None:
    """FMUError if `found` of something (`what`, in words) is more than the limit."""
    factor = _factor()
    if found > limit * factor:
        raise FMUError(
            f"{where}: {found} {what}, more than {int(limit * factor)}; refused. If you trust the unit, set {FACTOR}="
            f"{-(-found // limit)} to read units that are so many times larger"
        )


def _factor() -> float:
    text = os.environ.get(FACTOR, "1")
    try:
        value = float(text)
    except ValueError:
        value = 0.0
    if not 1 <= value < float("inf"):
        raise FMUError(f"{FACTOR}={text}: expected a number from 1, by which the limits for units are multiplied")
    return value
