"""Power flow cases of PSS/E (.raw), revisions 32 to 35."""

from __future__ import annotations

import csv
import re
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass
from itertools import islice
from math import radians
from os import PathLike
from pathlib import Path
from typing import Any

from phfmu.importers.grid.table import (
    ISOLATED,
    LOAD,
    Bus,
    Demand,
    Generator,
    Grid,
    GridError,
    Line,
    Shunt,
    Transformer,
)

REVISIONS = (32, 33, 34, 35)
END = re.compile(r"\s*0\s*(?:/(?P<words>.*))?$")
ENDED = re.compile(r"END OF\s+(.*?)(?:\s+DATA)?\s*(?:,|$)", re.I)
BEGUN = re.compile(r"BEGIN\s+(.*?)(?:\s+DATA)?\s*$", re.I)
#: sections in the order of the file, for those whose ends bear no names
ORDER = (
    "BUS", "LOAD", "FIXED SHUNT", "GENERATOR", "BRANCH", "SYSTEM SWITCHING DEVICE", "TRANSFORMER", "AREA", "TWO-TERMINAL DC",
    "VSC DC LINE", "IMPEDANCE CORRECTION", "MULTI-TERMINAL DC", "MULTI-SECTION LINE", "ZONE", "INTER-AREA TRANSFER", "OWNER",
    "FACTS DEVICE", "SWITCHED SHUNT", "GNE", "INDUCTION MACHINE", "SUBSTATION",
)  # fmt: skip
#: sections that say nothing about the equations
SILENT = ("SYSTEM-WIDE", "AREA", "ZONE", "OWNER", "INTER-AREA TRANSFER", "SUBSTATION", "MULTI-SECTION LINE")
READ = ("BUS", "LOAD", "FIXED SHUNT", "GENERATOR", "BRANCH", "TRANSFORMER", "SWITCHED SHUNT")


@dataclass(frozen=True)
class RawRecord:
    """The fields of a line of the file; an absent or empty one is its default."""

    file: str
    line: int
    section: str
    fields: tuple[str, ...]

    def text(self, k: int, default: str = "") -> str:
        return (
            self.fields[k].strip().strip("'\"").strip() if k < len(self.fields) and self.fields[k].strip() else default
        )

    def number(self, k: int, default: float = 0.0) -> float:
        return self._as(float, k, default)

    def integer(self, k: int, default: int | None = None) -> int:
        return self._as(int, k, default)

    def _as(self, kind: Callable[[str], Any], k: int, default: Any) -> Any:
        text = self.text(k)
        if not text and default is not None:
            return default
        try:
            return kind(text.replace("D", "E") if kind is float else text)
        except ValueError:
            raise GridError(self.file, [
                f"line {self.line}, {self.section.lower()} data: field {k + 1} is '{text}', not "
                f"{'a number' if kind is float else 'an integer'}; the record: {','.join(self.fields).strip()[:80]}"
            ]) from None  # fmt: skip


def read_raw(path: str | PathLike[str]) -> Grid:
    """A case of PSS/E; GridError names the line of a record that cannot be read, and sections that are not there."""
    file = Path(path)
    name = file.name
    lines = file.read_text(encoding="utf-8", errors="replace").splitlines()
    if len(lines) < 4:
        raise GridError(name, [f"{len(lines)} lines are no case; a .raw file begins with three lines of titles"])
    head = RawRecord(name, 1, "case identification", _fields(lines[0]))
    if lines[0].startswith("@!"):
        head, lines = RawRecord(name, 2, head.section, _fields(lines[1])), ["", *lines[2:]]
    revision = head.integer(2, 0)
    if revision not in REVISIONS:
        raise GridError(name, [f"revision {revision} of the format; {REVISIONS[0]} to {REVISIONS[-1]} can be read"])
    sections = _sections(name, lines, revision)
    problems = [f"no section of {s.lower()} data ends; is the file whole?" for s in READ[:6] if s not in sections]
    if problems:
        raise GridError(name, problems)
    get = lambda section: sections.get(section, [])  # noqa: E731
    buses = [_bus(r) for r in get("BUS")]
    base = head.number(1, 100.0)
    Grid(name, base, head.number(5, 60.0), tuple(buses))  # which refuses buses that records below cannot be read with
    kv = {b.number: b.kv for b in buses}
    transformers: list[Transformer] = []
    records = iter(get("TRANSFORMER"))
    for first in records:
        stars, windings = _transformer(first, records, base, kv)
        buses += stars
        transformers += windings
    others = [s for s in sections if s not in READ and s not in SILENT and sections[s]]
    return Grid(
        file.stem, base, head.number(5, 60.0), tuple(buses),
        tuple(_line(r, revision) for r in get("BRANCH")), tuple(transformers),
        tuple(_load(r) for r in get("LOAD")),
        (*(_shunt(r) for r in get("FIXED SHUNT")), *(_switched(r, revision) for r in get("SWITCHED SHUNT"))),
        tuple(_generator(r, revision) for r in get("GENERATOR")),
        unused=tuple(f"{len(sections[s])} records of {s.lower()} data" for s in others),
    )  # fmt: skip


def _fields(line: str) -> tuple[str, ...]:
    """Fields between commas or blanks; quotes keep both, and a slash outside of them begins a comment."""
    line = re.sub(r"('[^']*')|/.*", lambda m: m[1] or "", line)
    if "," not in line:
        line = ",".join(re.findall(r"'[^']*'|\S+", line))
    return tuple(next(csv.reader([line], quotechar="'", skipinitialspace=True), []))


def _sections(name: str, lines: Sequence[str], revision: int) -> dict[str, list[RawRecord]]:
    """Section -> records: by the names in the lines that end them, else by their order."""
    order = [s for s in ORDER if s != "SYSTEM SWITCHING DEVICE" or revision >= 34]
    begun = "SYSTEM-WIDE" if revision >= 34 else "BUS"
    found: dict[str, list[RawRecord]] = {}
    records: list[RawRecord] = []
    for number, line in enumerate(lines[3:], 4):
        text = line.strip()
        if not text or text.startswith("@!"):
            continue
        if text.upper() == "Q":
            break
        end = END.match(line)
        if end is None:
            records.append(RawRecord(name, number, begun, _fields(line)))
            continue
        words = end["words"] or ""
        ended, after = (_section(m[1]) if (m := pattern.search(words)) else "" for pattern in (ENDED, BEGUN))
        if ended in order and ended != begun:
            raise GridError(name, [f"line {number} ends the {ended.lower()} data where {begun.lower()} data stand; "
                                   f"the line that ends these is missing, or a section is at the wrong place"])  # fmt: skip
        found[begun] = records
        k = order.index(begun) + 1 if begun in order else 0
        begun, records = after or (order[k] if k < len(order) else "REST"), []
    return found


def _section(words: str) -> str:
    """The name of a section as it is in `ORDER`."""
    text = words.upper()
    known = (*ORDER, "SYSTEM-WIDE")
    return text if text in known else next((s for s in known if text.startswith(s)), text)


def _bus(r: RawRecord) -> Bus:
    return Bus(r.integer(0), r.text(1), r.number(2), r.integer(3, LOAD), r.number(7, 1.0), radians(r.number(8)))


def _load(r: RawRecord) -> Demand:
    return Demand(r.integer(0), r.text(1, "1"), *(r.number(k) for k in range(5, 11)), on=r.integer(2, 1) != 0)


def _shunt(r: RawRecord) -> Shunt:
    return Shunt(r.integer(0), r.text(1, "1"), r.number(3), r.number(4), r.integer(2, 1) != 0)


def _switched(r: RawRecord, revision: int) -> Shunt:
    """At its initial susceptance."""
    status, initial = (4, 11) if revision >= 35 else (3, 9)
    return Shunt(r.integer(0), "switched", 0.0, r.number(initial), r.integer(status, 1) != 0)


def _generator(r: RawRecord, revision: int) -> Generator:
    bus, k = r.integer(0), 9 if revision >= 35 else 8
    if r.number(k + 4):
        raise GridError(r.file, [
            f"line {r.line}, generator '{r.text(1, '1')}' at bus {bus}: it has a step-up transformer of its own "
            f"(XT = {r.number(k + 4):g}); give that as a transformer with a bus between"
        ])  # fmt: skip
    return Generator(
        bus, r.text(1, "1"), r.number(2), r.number(3), r.number(6, 1.0), r.integer(7, 0) or bus, r.number(k, 100.0),
        r.number(k + 1), r.number(k + 2, 1.0), r.integer(k + 6, 1) != 0, (r.number(5, -9999.0), r.number(4, 9999.0)),
    )  # fmt: skip


def _line(r: RawRecord, revision: int) -> Line:
    k = 19 if revision >= 34 else 9
    ends = (r.number(k), r.number(k + 1), r.number(k + 2), r.number(k + 3))
    return Line(
        abs(r.integer(0)), abs(r.integer(1)), r.text(2, "1"), r.number(3), r.number(4), r.number(5), ends,
        r.integer(k + 4, 1) != 0,
    )  # fmt: skip


@dataclass(frozen=True)
class _Winding:
    """A winding's bus, its ratio in per unit of the bus voltage and its angle."""

    bus: int
    tap: float
    angle: float


def _transformer(
    r: RawRecord, records: Iterator[RawRecord], base: float, kv: dict[int, float]
) -> tuple[list[Bus], list[Transformer]]:
    """Two windings, or three as a star whose inner bus is added, with the number of the first bus and seven digits more."""
    three = r.integer(2, 0) != 0
    rest = list(islice(records, 4 if three else 3))
    label = f"transformer {r.integer(0)}-{r.integer(1)} '{r.text(3, '1')}'"
    if len(rest) < (4 if three else 3):
        raise GridError(r.file, [f"line {r.line}, {label}: {1 + len(rest)} records; there are {5 if three else 4}"])
    unknown = [str(r.integer(k)) for k in range(3 if three else 2) if r.integer(k) not in kv]
    if unknown:
        raise GridError(r.file, [f"line {r.line}, {label}: no bus {', '.join(unknown)}"])
    windings = [_winding(r.integer(4, 1), r.integer(k), s, kv) for k, s in enumerate(rest[1:])]
    impedances = [_impedance(r, rest[0], 3 * k, base) for k in range(3 if three else 1)]
    magnetising = _magnetising(r, rest[0], base)
    circuit, group, status = r.text(3, "1"), r.text(20), r.integer(11, 1)
    first, second = windings[:2]
    if not three:
        z = impedances[0] * second.tap**2
        return [], [
            Transformer(first.bus, second.bus, circuit, z.real, z.imag, first.tap / second.tap, first.angle - second.angle,
                        magnetising.real, magnetising.imag, group, status != 0)
        ]  # fmt: skip
    star = Bus(first.bus * 10_000_000 + r.line, f"star of {label}", kv[first.bus], LOAD if status else ISOLATED,
               rest[0].number(9, 1.0), radians(rest[0].number(10)))  # fmt: skip
    z12, z23, z31 = impedances
    legs = ((z12 + z31 - z23) / 2, (z12 + z23 - z31) / 2, (z23 + z31 - z12) / 2)
    off = {2: 1, 3: 2, 4: 0}.get(status)
    return [star], [
        Transformer(w.bus, star.number, circuit, z.real, z.imag, w.tap, w.angle, *(
            (magnetising.real, magnetising.imag) if k == 0 else (0.0, 0.0)), group, status != 0 and k != off)
        for k, (w, z) in enumerate(zip(windings, legs, strict=True))
    ]  # fmt: skip


def _winding(cw: int, bus: int, r: RawRecord, kv: dict[int, float]) -> _Winding:
    """Its ratio, which the file gives in per unit of the bus (1), in kV (2) or in per unit of its own rated voltage (3)."""
    value, rated = r.number(0, kv[bus] if cw == 2 else 1.0), r.number(1) or kv[bus]
    tap = {1: value, 2: value / kv[bus], 3: value * rated / kv[bus]}.get(cw)
    if tap is None:
        raise GridError(r.file, [f"line {r.line}, winding at bus {bus}: CW = {cw} is none of 1, 2, 3"])
    return _Winding(bus, tap, radians(r.number(2)))


def _impedance(first: RawRecord, r: RawRecord, k: int, base: float) -> complex:
    """r + jx in per unit of the base; given on the case's base (1), the winding's (2), or by losses in W and |z| (3)."""
    cz, resistance, reactance, own = first.integer(5, 1), r.number(k), r.number(k + 1), r.number(k + 2, base) or base
    if cz == 3:
        resistance /= own * 1e6
        reactance = (reactance**2 - resistance**2) ** 0.5
    elif cz not in (1, 2):
        raise GridError(first.file, [f"line {first.line}, transformer data: CZ = {cz} is none of 1, 2, 3"])
    return complex(resistance, reactance) * (1.0 if cz == 1 else base / own)


def _magnetising(r: RawRecord, second: RawRecord, base: float) -> complex:
    """g + jb in per unit; given so (1), or as no-load loss in W and exciting current in per unit of the winding's base (2)."""
    a, b = r.number(7), r.number(8)
    if r.integer(6, 1) == 1:
        return complex(a, b)
    own = second.number(2, base)
    g = a / (base * 1e6)
    return complex(g, -(max((b * own / base) ** 2 - g**2, 0.0) ** 0.5))
