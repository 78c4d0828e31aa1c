"""Matrices of cases of which some run by default, others with `-m slow`, the rest with `-m long`."""

from __future__ import annotations

from collections.abc import Iterable
from typing import Any
from zlib import crc32

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


def turning(names: Iterable[Any], others: Iterable[Any], *telling: Any) -> list[Any]:
    """Pairs of a name and one of `others`, as orders or couplings: `telling` ones run by default, a slow one is there for each
    name, whose other goes round among them and is the same in all tests; the rest run with `-m long`."""
    rest = list(others)
    every = [(name, other) for name in names for other in rest]
    assert all(pair in every for pair in telling), f"{telling} are not all among the pairs"
    turn = {name: rest[crc32(str(name).encode()) % len(rest)] for name, _ in every}
    return [
        pair if pair in telling else slow(pair) if turn[pair[0]] == pair[1] else marked(pair, pytest.mark.long)
        for pair in every
    ]


def marked(case: Any, mark: Any) -> Any:
    """A case, of one parameter or a tuple of them, with a mark."""
    return pytest.param(*(case if isinstance(case, tuple) else (case,)), marks=mark)


def slow(case: Any) -> Any:
    """A case, of one parameter or a tuple of them, that takes long or says what others say too."""
    return marked(case, pytest.mark.slow)
