"""The account of an import: for each device of the file what was used, what was not, and what was assumed."""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass


@dataclass(frozen=True)
class Row:
    """A device of the file (`line 5-7 '1'`), the members that it became, and what became of its data."""

    kind: str
    device: str
    members: tuple[str, ...]
    used: str
    unused: str = ""
    assumed: str = ""


@dataclass(frozen=True)
class Report:
    """Rows by device, and lines about what of the file has no place in the network."""

    rows: tuple[Row, ...]
    notes: tuple[str, ...] = ()

    def __str__(self) -> str:
        """Devices with the same account in one entry, then the notes."""
        return "\n".join([*self.lines(), *self.notes])

    def of(self, member: str) -> Row:
        """The row of a member or device; KeyError for another name."""
        for row in self.rows:
            if member == row.device or member in row.members:
                return row
        raise KeyError(f"no device or member '{member}' in the account of the import")

    def lines(self, most: int = 4) -> Iterable[str]:
        """An entry for each kind and account: the devices (at most `most` by name), used, unused, assumed."""
        for (kind, used, unused, assumed), names in self._groups():
            more = f", .. ({len(names)})" if len(names) > most else ""
            yield f"{kind}: {', '.join(names[:most])}{more}"
            for word, text in (("used", used), ("unused", unused), ("assumed", assumed)):
                if text:
                    yield f"    {word + ':':9}{text}"

    def beside(self) -> Iterable[str]:
        """Data of each kind that were not used, and assumptions, a line each with the number of devices."""
        found: dict[tuple[str, str, str], int] = {}
        for (kind, _, unused, assumed), names in self._groups():
            for word, text in (("unused", unused), ("assumed", assumed)):
                if text:
                    found[kind, word, text] = found.get((kind, word, text), 0) + len(names)
        return [f"{word}, {n} x {kind}: {text}" for (kind, word, text), n in found.items()]

    def _groups(self) -> Iterable[tuple[tuple[str, str, str, str], list[str]]]:
        groups: dict[tuple[str, str, str, str], list[str]] = {}
        for row in self.rows:
            name = row.members[0] if row.members else row.device
            groups.setdefault((row.kind, row.used, row.unused, row.assumed), []).append(name)
        return groups.items()
