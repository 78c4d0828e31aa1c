"""The pages of the reference: each name has its line in a table and says how it is imported."""

from __future__ import annotations

import sys
from importlib import import_module
from pathlib import Path
from types import ModuleType

import pytest

ROOT = Path(__file__).parent.parent


@pytest.fixture(scope="module")
def reference() -> ModuleType:
    pytest.importorskip("sphinx", reason="the extra `docs` is not installed")
    sys.path.insert(0, str(ROOT / "docs" / "site"))
    try:
        return import_module("reference")
    finally:
        sys.path.pop(0)


def test_a_page_begins_with_a_table_of_its_names(reference: ModuleType) -> None:
    text = reference.page(
        {"skew": "phfmu.declare.block", "Port": "phfmu.declare.port"}, {"skew": "phfmu", "Port": "phfmu"}
    )
    rows = [line.strip() for line in text[: text.index(".. autoclass:: phfmu.declare.port.Port")]]
    assert (
        "* - :py:obj:`Port <phfmu.declare.port.Port>`" in rows
        and "* - :py:obj:`skew <phfmu.declare.block.skew>`" in rows
    )
    assert any(row.startswith("- A power port: B acts on the rows of") for row in rows)


@pytest.mark.parametrize("full", ["phfmu.declare.block.skew", "phfmu.components.control.relay.relay"])
def test_a_docstring_begins_with_the_import(reference: ModuleType, full: str) -> None:
    module, _, name = full.rpartition(".")
    public = "phfmu" if name == "skew" else "phfmu.components.control"
    reference.page({name: module}, {name: public})
    lines = ["A line."]
    reference.set_docstring(None, "function", full, None, None, lines)
    (statement,) = (line.strip() for line in lines if " import " in line)
    assert statement == f"from {public} import {name}"
    assert getattr(import_module(public), name) is getattr(import_module(module), name)


def test_a_summary_is_a_sentence(reference: ModuleType) -> None:
    from phfmu import ELECTRICAL, Collocated, skew
    from phfmu.declare.port import Given

    assert reference.summary(skew).startswith("The block of J with J[rows, cols] = matrix")
    assert reference.summary(ELECTRICAL) == "Domain electrical"
    assert reference.summary(Given) == "Literal['effort', 'flow']"
    assert reference.summary(Collocated)
