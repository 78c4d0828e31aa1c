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
        groups: dict[tuple[str, str, str, str], list[Row]] = {}
        for row in self.rows:
            groups.setdefault((row.kind, row.used, row.unused, row.assumed), []).append(row)
        for (kind, used, unused, assumed), rows in groups.items():
            names = [r.members[0] if r.members else r.device for r in rows]
            more = f", .. ({len(names)})" if len(names) > most else ""
            yield f"{kind}: {', '.join(names[:most])}{more}"
            for word, text in (("used", used), ("unused", unused), ("assumed", assumed)):
                if text:
                    yield f"    {word + ':':9}{text}"
