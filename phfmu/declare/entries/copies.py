"""Copies of frozen parts of a declaration, of which a network of thousands of members needs as many."""

from __future__ import annotations

from dataclasses import fields
from functools import cache
from typing import Any, TypeVar

T = TypeVar("T")

_set = object.__setattr__


@cache
def _fields(kind: Any) -> tuple[str, ...]:
    return tuple(f.name for f in fields(kind))


def copied(item: T, **changes: Any) -> T:
    """A copy of a frozen dataclass with some fields changed, at a tenth of the cost of `dataclasses.replace`.

    Nothing is checked or derived anew, so that it is for changes that leave the checks as they are: of names, starts, owners.
    """
    new = object.__new__(type(item))
    for name in _fields(type(item)):
        _set(new, name, changes[name] if name in changes else getattr(item, name))
    return new
