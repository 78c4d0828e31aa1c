"""Matrices of cases of which some run by default, the rest with `-m slow`."""

from __future__ import annotations

from collections.abc import Iterable
from typing import Any

import pytest


def wide(cases: Iterable[Any], *telling: Any) -> list[Any]:
    """Parameters of a test: the `telling` cases run by default, all others are slow."""
    every = list(cases)
    assert all(case in every for case in telling), f"{telling} are not all among the cases"
    return [case if case in telling else slow(case) for case in every]


def longer(cases: Iterable[Any], *telling: Any) -> list[Any]:
    """Parameters of a test of minutes: the `telling` cases are slow ones, all others run with `-m long`."""
    every = list(cases)
    assert all(case in every for case in telling), f"{telling} are not all among the cases"
    return [slow(case) if case in telling else marked(case, pytest.mark.long) for case in every]


def marked(case: Any, mark: Any) -> Any:
    """A case, of one parameter or a tuple of them, with a mark."""
    return pytest.param(*(case if isinstance(case, tuple) else (case,)), marks=mark)


def slow(case: Any) -> Any:
    """A case, of one parameter or a tuple of them, that takes long or says what others say too."""
    return marked(case, pytest.mark.slow)
