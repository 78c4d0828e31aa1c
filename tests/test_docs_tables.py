"""The commands behind the tables of the documentation: every command of a page exists, and prints what the page holds."""

from __future__ import annotations

import re
import subprocess
import sys
from pathlib import Path

import pytest

ROOT = Path(__file__).parent.parent
PAGES = [ROOT / "README.md", *sorted((ROOT / "docs").rglob("*.md"))]
COMMAND = re.compile(r"python docs/tables (?:--write )?(\w+)")


def tables(*arguments: str) -> subprocess.CompletedProcess[str]:
    command = [sys.executable, str(ROOT / "docs" / "tables"), *arguments]
    return subprocess.run(command, capture_output=True, text=True, timeout=300, encoding="utf-8")


def rows(text: str) -> list[list[str]]:
    """Cells of the rows of Markdown tables."""
    return [[c.strip() for c in line.strip("|").split("|")] for line in text.splitlines() if line.startswith("|")]


def below(name: str) -> list[list[str]]:
    """The table below the line with the command of `name`."""
    found = [
        m[1]
        for page in PAGES
        if (m := re.search(rf"^    python docs/tables {name}\n\n((?:\|.*\n)+)", page.read_text("utf-8"), re.MULTILINE))
    ]
    assert len(found) == 1, name
    return rows(found[0])


def test_every_command_of_a_page_exists_and_every_table_is_on_a_page() -> None:
    listed = {line.split()[0] for line in tables().stdout.splitlines()}
    named = {name for page in PAGES for name in COMMAND.findall(page.read_text("utf-8"))}
    assert named == listed


def test_a_name_that_is_none_is_refused_with_the_names() -> None:
    refused = tables("nothing")
    assert refused.returncode == 2
    assert "no 'nothing'" in refused.stderr and "scaling_net" in refused.stderr


@pytest.mark.parametrize("name", ["mass_spring_orders", "one_step"])
def test_a_command_prints_what_the_page_holds(name: str) -> None:
    printed, page = rows(tables(name).stdout), below(name)
    assert [len(r) for r in printed] == [len(r) for r in page] and printed[:2] == page[:2]
    for new, old in zip(printed[2:], page[2:], strict=True):
        for a, b in zip(new, old, strict=True):
            if re.fullmatch(r"\d\.\d\de[+-]\d\d", b) and float(b) > 1e-12:  # below: rounding, another on each machine
                assert float(a) == pytest.approx(float(b), rel=0.02)
            elif not re.fullmatch(r"\d\.\d\de[+-]\d\d", b):
                assert a == b or abs(float(a) - float(b)) <= 0.01  # slopes
