"""Declarations that are alike: equal equations, names and limits; only start values, the own name and words may differ.

What is made of the equations (plans, kernels, compiled code) is the same for all that are alike.
"""

from __future__ import annotations

from collections.abc import Hashable, Mapping
from dataclasses import fields, is_dataclass
from functools import cache
from hashlib import sha256
from typing import Any
from weakref import WeakKeyDictionary, WeakValueDictionary

import casadi as ca
import numpy as np

from phfmu.declare.phdae import PHDAE
from phfmu.declare.variable import time

#: what alike declarations may differ in
FREE = {"start", "description"}
OF_THE_WHOLE = {"name", "description", "shapes"}

_FIRST: WeakValueDictionary[Hashable, PHDAE] = WeakValueDictionary()
_KNOWN: WeakKeyDictionary[PHDAE, PHDAE] = WeakKeyDictionary()


def first_alike(declaration: PHDAE) -> PHDAE:
    """The first declaration still in use that is like this one; itself if there is none before, and for composed networks.

    Functions given to a declaration (of a strain energy, a closed pair) are equal if they are the same object.
    """
    if declaration.members != ("",):
        return declaration
    found = _KNOWN.get(declaration)
    if found is None:
        found = _KNOWN[declaration] = _FIRST.setdefault(form(declaration), declaration)
    return found


def form(declaration: PHDAE) -> Hashable:
    """Key that declarations share if and only if they are alike."""
    reading = _Reading()
    parts = tuple(reading.of(getattr(declaration, f.name)) for f in fields(PHDAE) if f.name not in OF_THE_WHOLE)
    return parts, reading.equations()


@cache
def compared(kind: type) -> tuple[str, ...]:
    """Fields of a part of a declaration that alike ones share."""
    return tuple(f.name for f in fields(kind) if f.name not in FREE)


class _Reading:
    """Reads a declaration: expressions are put aside, to be compared together; what is met again is told by its number."""

    def __init__(self) -> None:
        self._exprs: list[ca.SX] = []
        self._met: dict[int, int] = {}

    def of(self, item: Any) -> Hashable:
        if item is None or isinstance(item, str | bool | int):
            return item
        if isinstance(item, float):
            return item.hex()
        if isinstance(item, tuple | list):
            return tuple([self.of(i) for i in item])
        if isinstance(item, Mapping):
            return tuple([(self.of(k), self.of(v)) for k, v in item.items()])
        if isinstance(item, ca.SX | ca.DM):
            self._exprs.append(item if isinstance(item, ca.SX) else ca.SX(item))
            return len(self._exprs)
        if isinstance(item, np.ndarray | np.generic):
            return str(item.dtype), item.shape, item.tobytes()
        if is_dataclass(item):
            return self._known(item)
        return item  # a function, or what is not known: like itself only

    def _known(self, item: Any) -> Hashable:
        if id(item) in self._met:
            return "again", self._met[id(item)]
        self._met[id(item)] = len(self._met)
        return type(item).__name__, tuple([self.of(getattr(item, n)) for n in compared(type(item))])

    def equations(self) -> str:
        """All expressions as one function of their symbols, in the order in which they are met."""
        shapes = [(e.shape, e.sparsity().get_triplet()) for e in self._exprs if e.numel() != 1 or e.nnz() != 1]
        whole = _stacked([time, *self._exprs])
        symbols = _stacked(ca.symvar(whole))
        text = ca.Function("equations", [symbols], [whole]).serialize()
        return sha256(f"{shapes!r}{[e.nnz() for e in self._exprs]!r}{text}".encode()).hexdigest()


def _stacked(parts: list[ca.SX]) -> ca.SX:
    """The nonzeros of all parts as one column, joined by hundreds: all at once take time quadratic in their number."""
    parts = [p if p.is_dense() else p.nz[:] for p in parts]
    while len(parts) > 1:
        parts = [ca.veccat(*parts[i : i + 100]) for i in range(0, len(parts), 100)]
    return ca.vec(parts[0])
