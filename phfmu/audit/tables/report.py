"""The report of an audit, as text and as CSV.

Sheets of large networks: the rows that matter most, and one for the sum of all others.
"""

from __future__ import annotations

import csv
import io
import math
from collections.abc import Iterator, Sequence
from typing import TYPE_CHECKING, Any, TypedDict

from phfmu.audit.alarms import Alarms, alarms
from phfmu.audit.events import EventRow
from phfmu.audit.kinds import CellKind, LedgerVerdict, RowKind
from phfmu.audit.summary import LedgerSummary
from phfmu.audit.tables.sheets import JOULE, Scale, Sheet, SheetColumn, all_sheets, sheets
from phfmu.html import ROWS, grid, paragraph
from phfmu.words import counted, shown

if TYPE_CHECKING:
    from rich.table import Table


def shortened(sheet: Sheet, most: int) -> Sheet:
    """At most `most` rows in their order: those that do not close, then those with the most energy; the last is all others."""
    n = len(sheet.rows)
    if n <= most:
        return sheet
    weight = [_weight(sheet.columns, row) for row in sheet.rows]
    told = set(sorted(range(n), key=lambda i: weight[i], reverse=True)[: most - 1])
    others = [row for i, row in enumerate(sheet.rows) if i not in told]
    cells = [_together(c, [row[j] for row in others]) for j, c in enumerate(sheet.columns)]
    kept = [row for i, row in enumerate(sheet.rows) if i in told]
    return Sheet(sheet.title, sheet.columns, (*kept, (f"{len(others)} others", *cells[1:])))


def _weight(columns: Sequence[SheetColumn], row: Sequence[Any]) -> tuple[bool, float]:
    energies = [abs(v) for c, v in zip(columns, row, strict=True) if c.kind is CellKind.ENERGY and v is not None]
    return LedgerVerdict.VIOLATED in row, max((e for e in energies if not math.isnan(e)), default=0.0)


def _together(column: SheetColumn, values: Sequence[Any]) -> Any:
    """Energies add up, of the worst the worst remains, and a word that all share."""
    there = [v for v in values if v is not None]
    if column.kind is CellKind.ENERGY and column.adds:
        return math.fsum(there)
    if column.kind in (CellKind.ENERGY, CellKind.RATIO):
        return max(there, key=abs, default=None)
    return values[0] if len(set(values)) == 1 else None


class SummaryTableOptions(TypedDict, total=False):
    """Keyword arguments of `summary_table`."""

    width: int
    color: bool
    by: Sequence[str]
    scale: Scale
    events: Sequence[EventRow]
    levels: Alarms | None
    most: int | None


def summary_table(
    summary: LedgerSummary,
    *,
    width: int = 120,
    color: bool = False,
    by: Sequence[str] = (),
    scale: Scale = JOULE,
    events: Sequence[EventRow] = (),
    levels: Alarms | None = None,
    most: int | None = None,
) -> str:
    """Text of where the energy went.

    Components (start, end, stored, dissipated, supplied, largest residual as a share of what is allowed, verdict), ports,
    junctions, network, what does not close, events; columns and tables that the run has nothing for are left out.
    `by`: kinds of tables to show, none: all.  `scale`: of energies, J by default.
    `events`: those to be listed.  `levels`: what to warn of.  `most`: rows
    of a table, the last is the sum of all others.
    """
    from rich.console import Console

    console = Console(
        file=io.StringIO(),
        width=width,
        force_terminal=color,
        no_color=not color,
        highlight=False,
        markup=False,  # names may hold brackets
        emoji=False,
        force_jupyter=False,  # it would show the text in the notebook and give back none
    )
    for part in _parts(summary, by, scale, events, levels, most):
        if not isinstance(part, str):
            console.print()
        console.print(part, soft_wrap=isinstance(part, str))
    assert isinstance(console.file, io.StringIO)
    return "\n".join(line.rstrip() for line in console.file.getvalue().splitlines()) + "\n"


def audit_html(summary: LedgerSummary) -> str:
    """Tables of a summary in HTML for a notebook, energies in joule."""
    tables = [
        grid("", [c.header for c in sheet.columns], [_cells(sheet, row, JOULE) for row in sheet.rows])
        for sheet in sheets(summary)
    ]
    said = [*map(str, summary.violations[:ROWS]), _happened(summary)]
    return "".join([paragraph(_heading(summary, JOULE)), *tables, *map(paragraph, said)])


def audit_csv(
    summary: LedgerSummary, kind: RowKind | str, scale: Scale = JOULE, events: Sequence[EventRow] = ()
) -> str:
    """One kind of table (component, port, junction, part, event) as CSV, with all digits.

    The header, which is there without rows too, has the unit of energies.
    """
    out = io.StringIO()
    writer = csv.writer(out, lineterminator="\n")
    for sheet in all_sheets(summary, events):
        if sheet.title == kind:
            writer.writerow(
                f"{c.header} [{scale.label}]" if c.kind is CellKind.ENERGY else c.header for c in sheet.columns
            )
            writer.writerows(
                [
                    scale.of(v) if c.kind is CellKind.ENERGY and v is not None else v
                    for c, v in zip(sheet.columns, row, strict=True)
                ]
                for row in sheet.rows
            )
    return out.getvalue()


def _parts(
    summary: LedgerSummary,
    by: Sequence[str],
    scale: Scale,
    events: Sequence[EventRow],
    levels: Alarms | None,
    most: int | None,
) -> Iterator[Any]:
    yield _heading(summary, scale)
    chosen = [sheet for sheet in sheets(summary, events) if not by or sheet.title in by]
    yield from (_drawn(sheet if most is None else shortened(sheet, most), scale) for sheet in chosen)
    if by and summary.steps and not chosen:
        yield f"there is no {' and no '.join(by)} in it{TERMS if RowKind.TERM in by else ''}"
    if summary.violations:
        yield _table(
            f"{LedgerVerdict.VIOLATED}: what does not close; allowed: {summary.rtol:.1e} of the energies in play, and rounding"
        )
        yield from (shown(str(v)) for v in summary.violations[:most])
        if most is not None and len(summary.violations) > most:
            yield f"and {len(summary.violations) - most} more"
    if levels is not None:
        yield from (shown(line) for line in alarms(summary, levels))
    if summary.events:
        yield _happened(summary)


def _heading(summary: LedgerSummary, scale: Scale) -> str:
    """Line with the unit, direction and span of time of the energies."""
    if not summary.steps:
        return "no steps: nothing was stored, dissipated or supplied"
    span = f"{counted(summary.steps, 'step')} from t = {summary.t_start:.6g} s to {summary.t_end:.6g} s"
    unit = {"J": "joule"}.get(scale.unit, scale.unit)
    if scale.whole is not None:
        unit = f"percent of {scale.whole:.4g} J, {scale.words}"
    return f"Energy in {unit}, positive into the component; {span}"


def _happened(summary: LedgerSummary) -> str:
    """Line with the number of events of each kind, "" for none."""
    parts = ", ".join(f"{count} {shown(kind)}" for kind, count in summary.events.items())
    return f"events: {parts}" if parts else ""


def _drawn(sheet: Sheet, scale: Scale) -> Table:
    first, *others = sheet.columns
    table = _table(first.header)
    for c in others:
        table.add_column(
            c.header,
            justify="left" if c.kind is CellKind.WORD else "right",
            no_wrap=c.header not in ("junction", "message"),
        )
    for row in sheet.rows:
        table.add_row(*map(shown, _cells(sheet, row, scale)))
    return table


#: how to have what a log lacks
TERMS = "; a run tells energies and resistors by themselves with: phfmu run TARGET --audit full --audit-detail"
_FORMAT = {CellKind.TIME: ".6g"}


def _cells(sheet: Sheet, row: Sequence[Any], scale: Scale) -> list[str]:
    return [_cell(c, v, scale) for c, v in zip(sheet.columns, row, strict=True)]


def _cell(column: SheetColumn, value: Any, scale: Scale) -> str:
    if value is None:
        return ""
    if column.kind is CellKind.ENERGY:
        number = scale.of(value)
        return f"{number:.3e}" if scale.label == "J" else f"{number:.4g}"
    if column.kind is CellKind.RATIO:
        return percent(value)
    return format(value, _FORMAT[column.kind]) if column.kind in _FORMAT else str(value)


def percent(share: float) -> str:
    """`0.0024 %`; what is far below or above one in the form of 1e-07 %."""
    return f"{100.0 * share:.2g} %"


def _table(title: str) -> Table:
    from rich.box import Box
    from rich.table import Table

    # a rule below the header and nothing else, in ASCII: any pipe takes it
    rule = Box("    \n" * 2 + " -- \n" + "    \n" * 5, ascii=True)
    table = Table(box=rule, show_edge=False, padding=(0, 1, 0, 0), pad_edge=False)
    table.add_column(title, overflow="fold", min_width=10)
    return table
