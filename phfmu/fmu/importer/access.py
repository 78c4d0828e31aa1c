"""Access of a compiled master to a unit of this package that lives in this process: functions, variables, its books."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np
from numpy.typing import NDArray

from phfmu.fmu.importer.reader import FMUInstance
from phfmu.fmu.importer.refusal import UnitFailure
from phfmu.fmu.importer.slave import Slave
from phfmu.fmu.importer.unit_books import OwnBooks
from phfmu.fmu.importer.unit_interface import Scalar
from phfmu.fmu.importer.values import References
from phfmu.fmu.version import VERSIONS

Array = NDArray[np.float64]


class Access:
    """`prefix`: of the functions of its version; `instance`: address.  What is read and set is for who calls to keep."""

    def __init__(self, unit: FMUInstance, slave: Slave, books: OwnBooks):
        self._unit, self._slave, self.values, self.books = unit, slave, unit._values, books
        self._version = VERSIONS[unit.interface.version]
        self.prefix, self.instance = self._version.prefix, slave.address

    def functions(self, names: Sequence[str]) -> list[Any]:
        """Functions of its library by the names of the standard, less the version."""
        return [getattr(self._slave.fmu.dll, self.prefix + n) for n in names]

    def references(self, scalars: Sequence[Scalar]) -> References:
        """Buffers of the caller's own."""
        return References(scalars, self._version)

    def failure(self, function: str, status: int, t: float, h: float) -> UnitFailure:
        """The failure of a step from t by h in which a function answered with this status; after a fatal one the unit is dead."""
        error = self._slave.refused(function, status)
        return UnitFailure(self.values.name, t, h, error.function, error.answer, error.words)

    def stepped(self, t: float, h: float, given: Array, held: bool) -> None:
        """It was stepped from t by h, with inputs at nodes, or held ones (k x nu)."""
        if held:
            self.values.take(given[0])
        else:
            self.values.take_at_nodes(given)
        self._unit.steps.time, self._unit.steps.h = t + h, h
        self.books.book(h, np.zeros(0))


def access(unit: FMUInstance) -> Access | None:
    """None of units that go another way: foreign ones, those in processes of their own, those that may return early."""
    about, slave, books = unit.interface, unit._slave, unit._books
    if not isinstance(slave, Slave) or not isinstance(books, OwnBooks) or slave.early_return:
        return None
    plain = all(v.type == "Float64" for v in about.variables.values())
    whole = all(t.filled for r in (unit._values.u, unit._values.taken) for t in r.by_type)
    able = about.saves and about.derivatives and not about.one_step
    return Access(unit, slave, books) if plain and whole and able else None
