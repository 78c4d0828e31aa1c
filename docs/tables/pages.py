"""Parts of every table: Markdown, observed orders, independent solutions, and its place on a page."""

from __future__ import annotations

import re
import sys
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from importlib.util import module_from_spec, spec_from_file_location
from pathlib import Path
from types import ModuleType
from typing import Any

import numpy as np
from numpy.typing import NDArray

from phfmu.studies.tables import markdown_table

Array = NDArray[np.float64]
ROOT = Path(__file__).parents[2]
DOCS = ROOT / "docs"
REFERENCE = ROOT / "tests" / "reference"


def nothing() -> Sequence[Path]:
    """Draws no picture."""
    return ()


@dataclass(frozen=True)
class PageBlock:
    """The result of a command: text in Markdown, notes below it, and the pictures that `draw` puts into a folder of docs."""

    text: str = ""
    notes: tuple[str, ...] = ()
    draw: Callable[[], Sequence[Path]] = nothing

    def __str__(self) -> str:
        return "\n\n".join(part for part in (self.text, "\n".join(f"- {n}" for n in self.notes)) if part)


def table(head: Sequence[str], rows: Sequence[Sequence[Any]], digits: str = ".2e", **more: Any) -> PageBlock:
    """A Markdown table with floats in the format `digits`; `more`: notes and draw."""
    text = [[f"{x:{digits}}" if isinstance(x, float) else str(x) for x in row] for row in rows]
    return PageBlock(markdown_table(head, text), **more)


def slopes(errors: Sequence[float], steps: Sequence[float]) -> list[str]:
    """Observed order between neighbours; a dash where there is none."""
    e, h = np.array(errors), np.array(steps)
    return ["-", *(f"{s:.2f}" for s in np.log(e[:-1] / e[1:]) / np.log(h[:-1] / h[1:]))]


def independent(name: str) -> ModuleType:
    """The module tests/reference/<name>.py: solutions that share no code with the package."""
    if name not in sys.modules:
        spec = spec_from_file_location(name, REFERENCE / f"{name}.py")
        assert spec is not None and spec.loader is not None, name
        module = module_from_spec(spec)
        sys.modules[name] = module
        spec.loader.exec_module(module)
    return sys.modules[name]


def reference(name: str) -> dict[str, Array]:
    """Columns of tests/reference/<name>.csv."""
    return independent("reference_tools").read(name)


def declared(page: str, name: str) -> Callable[..., Any]:
    """The function `name` as the Python block of docs/<page> that holds it defines it."""
    space: dict[str, Any] = {}
    for block in re.findall(
        r"^```python\n(.*?)^```$", (DOCS / page).read_text(encoding="utf-8"), re.MULTILINE | re.DOTALL
    ):
        imports = re.findall(r"^from .*$", block, re.MULTILINE)
        exec("\n".join(imports), space)
        if re.search(rf"^def {name}\(", block, re.MULTILINE):
            exec(block, space)
            return space[name]
    raise KeyError(f"docs/{page} has no function '{name}'")


def write(name: str, made: PageBlock) -> list[Path]:
    """Replace what stands below the line `python docs/tables <name>` of each page; the pages that hold it."""
    notes = r"(?:\n(?:- .*\n)+)?" if made.notes else ""
    below = re.compile(rf"(^    python docs/tables {name}\n\n)(?:\|.*\n)*{notes}", re.MULTILINE)
    found = [page for page in sorted(DOCS.rglob("*.md")) if below.search(page.read_text(encoding="utf-8"))]
    for page in found if made.text else ():
        old = page.read_text(encoding="utf-8")
        page.write_text(below.sub(lambda m: f"{m[1]}{made}\n", old), encoding="utf-8")
    return found
