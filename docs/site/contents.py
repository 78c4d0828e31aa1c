"""Tables of contents from the lists of links in `docs/index.md`: a page is listed once, for readers of files and of the site."""

from __future__ import annotations

import re
from typing import Any

HEADING = re.compile(r"^## (.+)$")
ENTRY = re.compile(r"\[([^\]]+)\]\(([^)#]+\.(?:md|ipynb))\)")


def tables(text: str) -> str:
    """One hidden toctree for each heading with a list of links below it."""
    groups: dict[str, list[str]] = {"Start": ["README <../README.md>"]}
    caption = "Start"
    for line in text.splitlines():
        if heading := HEADING.match(line):
            caption = heading[1]
        elif line.startswith("- "):
            for title, page in ENTRY.findall(line):
                groups.setdefault(caption, []).append(f"{title} <{page}>")
    groups["Project"] = ["Contributing <../CONTRIBUTING.md>", "Changelog <../CHANGELOG.md>"]
    trees = (
        f"```{{toctree}}\n:hidden:\n:caption: {name}\n\n" + "\n".join(pages) + "\n```\n"
        for name, pages in groups.items()
    )
    return "\n".join(trees)


def add_tables(app: Any, page: str, source: list[str]) -> None:
    if page == app.config.root_doc:
        source[0] += "\n" + tables(source[0])


def setup(app: Any) -> dict[str, Any]:
    app.connect("source-read", add_tables)
    return {"parallel_read_safe": True}
