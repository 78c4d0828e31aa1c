"""The interfaces of the FMUs in fmus/recipes.toml are what others compile against: names, references, units."""

from __future__ import annotations

import importlib.util
from pathlib import Path

import pytest

FOLDER = Path(__file__).parents[2] / "fmus"
_spec = importlib.util.spec_from_file_location("fmus_build", FOLDER / "build.py")
assert _spec is not None and _spec.loader is not None
recipe_book = importlib.util.module_from_spec(_spec)
_spec.loader.exec_module(recipe_book)


@pytest.mark.parametrize("name", list(recipe_book.recipes()))
def test_interface_is_the_golden_one(name: str) -> None:
    """A wanted change is written by `python fmus/build.py --interfaces`."""
    now = recipe_book.interface(recipe_book.recipes()[name])
    assert now == (FOLDER / f"{name}.xml").read_text()
