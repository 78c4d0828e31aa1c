"""Tables for notebooks, as `_repr_html_` gives them."""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from html import escape

#: most rows shown; the line below them says how many there are more
ROWS = 60


def grid(title: str, head: Sequence[str], rows: Iterable[Sequence[str]], note: str = "") -> str:
    """A titled table; what is long is cut, with the number of rows left out."""
    all_rows = list(rows)
    lines = "".join(f"<tr>{''.join(f'<td>{escape(str(cell))}</td>' for cell in row)}</tr>" for row in all_rows[:ROWS])
    heads = "".join(f"<th>{escape(h)}</th>" for h in head)
    more = f"{len(all_rows) - ROWS} more rows" if len(all_rows) > ROWS else ""
    below = "; ".join(part for part in (more, note) if part)
    table = f"<table><thead><tr>{heads}</tr></thead><tbody>{lines}</tbody></table>" if all_rows else ""
    return f"<p><b>{escape(title)}</b></p>{table}" + (f"<p>{escape(below)}</p>" if below else "")
