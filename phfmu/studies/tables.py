"""Tables of the studies: in Markdown for results pages, in aligned columns for a terminal, as CSV files."""

from __future__ import annotations

import csv
from collections.abc import Iterable, Sequence
from pathlib import Path


def markdown_table(head: Sequence[str], rows: Iterable[Sequence[object]]) -> str:
    """A table of cells as they print: heads, a rule, and a line for each row."""
    lines = [head, ["---"] * len(head), *rows]
    return "\n".join("| " + " | ".join(map(str, line)) + " |" for line in lines)


def aligned_table(head: Sequence[str], rows: Iterable[Sequence[str]], words: int = 0) -> str:
    """Columns two spaces apart; the first `words` of them begin on the left, numbers end on the right."""
    lines = [head, *rows]
    width = [max(len(line[i]) for line in lines) for i in range(len(head))]
    return "\n".join(
        "  ".join(c.ljust(w) if i < words else c.rjust(w) for i, (c, w) in enumerate(zip(line, width, strict=True)))
        for line in lines
    )


def write_csv(path: Path, about: Iterable[str], head: Sequence[str], rows: Iterable[Iterable[object]]) -> None:
    """Rows with floats of six digits below lines of comment."""
    with path.open("w", newline="", encoding="utf-8") as file:
        file.writelines(f"# {line}\n" for line in about)
        out = csv.writer(file)
        out.writerow(head)
        out.writerows([f"{c:.6g}" if isinstance(c, float) else c for c in row] for row in rows)
