"""Cells of tables: a number or a few words stay in one line, so that 1e-12 is not broken at its sign."""

from __future__ import annotations

from typing import Any

from docutils import nodes

LONGEST = 24  # characters


def keep_whole(app: Any, tree: nodes.document) -> None:
    for cell in tree.findall(nodes.entry):
        if len(cell.astext()) <= LONGEST:
            cell["classes"].append("short")


def setup(app: Any) -> dict[str, Any]:
    app.connect("doctree-read", keep_whole)
    return {"parallel_read_safe": True}
