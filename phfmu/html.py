"""Tables for notebooks, as `_repr_html_` gives them."""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from html import escape

#: most rows shown; the line below them says how many there are more
ROWS = 60
#: of a cell: notebooks and pages of other tools align each as they like, or not at all
STYLE = 'style="text-align:{};padding:0 1em 0 0"'


def grid(title: str, head: Sequence[str], rows: Iterable[Sequence[str]], note: str = "") -> str:
    """A table, titled if it has a title; columns of numbers are aligned to the right; the number of rows left out is told."""
    all_rows = [[str(cell) for cell in row] for row in rows]
    more = f"{len(all_rows) - ROWS} more rows" if len(all_rows) > ROWS else ""
    below = "; ".join(part for part in (more, note) if part)
    return (f"<p><b>{escape(title)}</b></p>" if title else "") + _table(head, all_rows) + paragraph(below)


def paragraph(text: str) -> str:
    """A paragraph of a line of text, "" for an empty one."""
    return f"<p>{escape(text)}</p>" if text else ""


def _table(head: Sequence[str], rows: Sequence[Sequence[str]]) -> str:
    if not rows:
        return ""
    sides = [STYLE.format("right" if _numbers(column) else "left") for column in zip(*rows, strict=True)]
    lines = "".join(f"<tr>{_cells('td', row, sides)}</tr>" for row in rows[:ROWS])
    return f"<table><thead><tr>{_cells('th', head, sides)}</tr></thead><tbody>{lines}</tbody></table>"


def _cells(tag: str, texts: Sequence[str], sides: Sequence[str]) -> str:
    return "".join(f"<{tag} {side}>{escape(text)}</{tag}>" for text, side in zip(texts, sides, strict=True))


def _numbers(column: Iterable[str]) -> bool:
    """Whether all that is there are numbers."""
    there = [cell for cell in column if cell]
    try:
        return bool([float(cell) for cell in there])
    except ValueError:
        return False
