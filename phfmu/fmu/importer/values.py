"""Values of scalars of all number types, as floats, in buffers of the library's own types."""

from __future__ import annotations

import ctypes
from collections.abc import Sequence
from typing import Any

import numpy as np
from numpy.typing import NDArray

from phfmu.fmu.export.variables import FMUError
from phfmu.fmu.importer.unit_interface import Scalar
from phfmu.fmu.version import Version

Array = NDArray[np.float64]


class TypedValues:
    """Variables of one type: `places` of their scalars in a group, `picks` of those in the buffer."""

    def __init__(self, type_: str, version: Version, scalars: Sequence[Scalar], places: list[int]):
        word, element = version.types[type_]
        self.getter, self.setter = (f"{version.prefix}{verb}{word}" for verb in ("Get", "Set"))
        first: dict[int, int] = {}
        total, own = 0, []
        for s in scalars:
            if s.reference not in first:
                first[s.reference] = total
                total += max(s.size, 1)
            own.append(first[s.reference] + s.entry)
        self.references = (ctypes.c_uint * max(len(first), 1))(*first)  # ctypes wants memory, also for nothing
        self.n, self.total = len(first), total
        self.address = (element * max(total, 1))()
        self.buffer: NDArray[Any] = np.ctypeslib.as_array(self.address)[:total]
        self.picks, self.places = np.array(own, int), np.array(places, int)
        #: of the functions of the library, after the instance
        self.arguments = (self.references, self.n, self.address, *((self.total,) if version.arrays else ()))
        self.boolean = type_ == "Boolean"
        #: whether every place of the buffer has a scalar; whether they are the same, in order
        self.filled, self.whole = len(set(own)) == total, own == list(range(total))


class References:
    """A group of scalars; `values` holds what is to be set or what was read (n)."""

    def __init__(self, scalars: Sequence[Scalar], version: Version):
        self.scalars, self.n = tuple(scalars), len(scalars)
        kinds: dict[str, list[int]] = {}
        for i, s in enumerate(scalars):
            kinds.setdefault(s.type, []).append(i)
        self.by_type = [TypedValues(k, version, [scalars[i] for i in own], own) for k, own in kinds.items()]
        b = self.by_type[0] if len(self.by_type) == 1 else None
        #: numbers of type double without gaps are set and read in place
        self.direct = b if b is not None and b.whole and b.buffer.dtype == np.float64 else None
        self.values: Array = np.zeros(self.n) if self.direct is None else self.direct.buffer

    def spread(self, own: TypedValues) -> None:
        """Values of the group into those of one type; FMUError for a number that its type cannot hold."""
        values = self.values[own.places]
        with np.errstate(invalid="ignore", over="ignore"):
            own.buffer[own.picks] = values
            kept = own.buffer[own.picks].astype(float)
        lost = ~np.isfinite(kept) if own.buffer.dtype == np.float32 else kept != values
        if own.boolean:
            lost |= (values != 0) & (values != 1)
        if lost.any():
            i = int(own.places[np.argmax(lost)])
            s = self.scalars[i]
            raise FMUError(f"'{s.name}' is of the type {s.type}, which cannot hold {self.values[i]:.9g}")

    def gather(self, own: TypedValues) -> None:
        """Values of one type into the group."""
        self.values[own.places] = own.buffer[own.picks]


class Derivative:
    """d unknowns / d known, all of type Float64: the arguments of the call, made once."""

    def __init__(self, unknowns: References, known: Scalar, version: Version):
        self.unknowns, self.known = unknowns, known
        found, given = unknowns.by_type[0], TypedValues(known.type, version, [known], [0])
        given.buffer[known.entry] = 1.0
        result = type(found.address)()
        self.buffer: Array = np.ctypeslib.as_array(result)
        self.picks = found.picks
        ends = ((given.total,), (found.total,)) if version.arrays else ((), ())
        self.arguments = (
            found.references,
            found.n,
            given.references,
            given.n,
            given.address,
            *ends[0],
            result,
            *ends[1],
        )
