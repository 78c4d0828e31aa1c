"""The first difference of two audit logs of the same run: which step, whose row, which quantity, bit for bit.

Rows of a log stand in the order in which blocks of steps were written, which is a matter of wall time; they are compared by step
and name.  Numbers are equal if their bits are, so that 0 and -0 differ and a nan equals itself.

In a step of coupled members a wrong bit of one changes all of them.  The one where it arose is known by its energy: between the
steps it became another, so that H1 - H0 is no longer what the step stored, while it is for the others.  A state from which no
energy follows differs in its hash, where the log has hashes, while those of others are the same.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from phfmu.audit.kinds import ColumnType, RowKind
from phfmu.audit.log.columns import COLUMNS

if TYPE_CHECKING:
    import pyarrow as pa

#: kinds of rows of steps, those of members first: what differs there may follow in the others
STEPS = (RowKind.COMPONENT, RowKind.HASH, RowKind.TERM, RowKind.PORT, RowKind.JUNCTION, RowKind.PART, RowKind.NETWORK)
#: quantities that are rounding, and follow others
ROUNDINGS = ("residual", "residual_rel", "unexplained", "cum_unexplained", "junction_residual", "cum_junction_residual")
#: of an energy: what its rounding may be in H1 - H0 - dH
CLOSE = 1e-13
#: names by which rows of one step and kind are told apart
NAMES = ("component", "port", "index", "junction", "part", "term")


@dataclass(frozen=True)
class Difference:
    """A number or word that differs: `was` in the first log, `now` in the second; None where a log has none.

    step: number of the step, None for an event;  time: its start, or that of the event, in s;  what: name of the row
    jump: by how much the energy of the component became another between the steps, in J
    """

    kind: RowKind
    step: int | None
    time: float
    what: str
    quantity: str
    was: Any
    now: Any
    jump: float = 0.0

    @property
    def size(self) -> float:
        """The difference relative to the larger magnitude, infinite where they are not both finite numbers."""
        if isinstance(self.was, float) and isinstance(self.now, float) and np.isfinite([self.was, self.now]).all():
            return abs(self.was - self.now) / max(abs(self.was), abs(self.now), np.finfo(float).tiny)
        return np.inf

    def __str__(self) -> str:
        where = (
            f"step {self.step} from t = {self.time:.9g} s"
            if self.step is not None
            else f"event at t = {self.time:.9g} s"
        )
        if self.kind is RowKind.HASH and self.quantity == self.kind:
            return f"{where}: hash of {self.what} was {_shown(self.was)}, is {_shown(self.now)}"
        return f"{where}: {self.kind} {self.what}: {self.quantity} was {_shown(self.was)}, is {_shown(self.now)}"


def _shown(value: Any) -> str:
    return "absent" if value is None else repr(value)


def first_differences(was: pa.Table, now: pa.Table) -> list[Difference]:
    """All that differs in the first step or event with a difference: events, members in which it arose, all others."""
    rows = {kind: (_KindRows(was, kind), _KindRows(now, kind)) for kind in STEPS}
    found = [d for kind, (a, b) in rows.items() for d in _of_kind(kind, a, b)]
    events = list(_of_kind(RowKind.EVENT, _KindRows(was, RowKind.EVENT), _KindRows(now, RowKind.EVENT)))
    first = min((d.time for d in (*found, *events)), default=0.0)
    found = [d for d in (*found, *events) if d.time == first]
    order = [RowKind.EVENT, *STEPS]  # what happens at the start of a step comes before it
    states = [d for d in found if d.kind is RowKind.HASH]
    some = bool(states) and len(states) < rows[RowKind.HASH][0].of_step(states[0].step)

    def arose(d: Difference) -> bool:
        return d.kind is RowKind.EVENT or d.jump > 0.0 or (some and d.kind is RowKind.HASH)

    def place(d: Difference) -> tuple[Any, ...]:
        last = d.kind is RowKind.HASH and not some  # they differ for all: what follows from what is in the ledger
        return not arose(d), last, order.index(d.kind), d.quantity in ROUNDINGS, -d.jump, -d.size

    return sorted(found, key=place)


class _KindRows:
    """The rows of one kind, in order of steps and names; events in order of time and as they were written."""

    def __init__(self, table: pa.Table, kind: RowKind):
        import pyarrow.compute as pc

        own = table.filter(pc.field("row") == str(kind))
        self.n = own.num_rows
        self.columns = {n: own[n].combine_chunks() for n in COLUMNS if n in own.column_names and n != "row"}
        self.time = own["t0"].to_numpy()
        names = [self._words(name) for name in NAMES if name in self.columns]
        step = own["step"].to_numpy() if "step" in self.columns and kind is not RowKind.EVENT else np.zeros(self.n)
        self.step = None if kind is RowKind.EVENT else step
        keys = [*reversed(names), step] if self.step is not None else [self.time]
        self.order = np.lexsort(keys) if self.n else np.zeros(0, int)

    def _words(self, name: str) -> NDArray[Any]:
        return np.array([str(value) for value in self.columns[name].to_pylist()], object).astype(str)

    def numbers(self, name: str) -> NDArray[Any]:
        """A column in order, as bits where it holds floats; `absent` tells where it has nothing."""
        column = self.columns.get(name)
        if column is None:
            return np.full(self.n, None, object)
        if COLUMNS[name] is ColumnType.F64:
            return column.fill_null(0.0).to_numpy(zero_copy_only=False).astype(float).view(np.int64)[self.order]
        return np.array(column.to_pylist(), object)[self.order]

    def absent(self, name: str) -> NDArray[np.bool_]:
        """Entries of a column in order that are empty."""
        column = self.columns.get(name)
        if column is None:
            return np.ones(self.n, bool)
        return column.is_null().to_numpy(zero_copy_only=False)[self.order]

    def value(self, name: str, i: int) -> Any:
        """An entry of a column in order."""
        column = self.columns.get(name)
        return None if column is None else column[int(self.order[i])].as_py()

    def of_step(self, step: int | None) -> int:
        """Number of rows of a step."""
        return 0 if self.step is None else int((self.step == step).sum())

    def what(self, i: int) -> str:
        """The name of a row."""
        words = [self.value(name, i) for name in NAMES]
        return ".".join(str(word) for word in words if word is not None) or "network"

    def place(self, i: int) -> tuple[int | None, float]:
        """Step and time of a row."""
        at = int(self.order[i])
        return None if self.step is None else int(self.step[at]), float(self.time[at])


def _of_kind(kind: RowKind, was: _KindRows, now: _KindRows) -> Iterator[Difference]:
    """Differences in the first rows of a kind that have some, or the first row that only one log has."""
    n = min(was.n, now.n)
    bad = dict[str, NDArray[np.bool_]]()
    for name in dict.fromkeys((*was.columns, *now.columns)):
        a, b = was.numbers(name)[:n], now.numbers(name)[:n]
        differs = (a != b) | (was.absent(name)[:n] != now.absent(name)[:n])
        if differs.any():
            bad[name] = differs.astype(bool)
    if bad:
        first = min(int(np.argmax(differs)) for differs in bad.values())
        time = was.place(first)[1]
        for name, differs in bad.items():
            for i in np.flatnonzero(differs).tolist():
                if was.place(i)[1] != time:
                    break
                jump = _jump(was, now, i) if kind is RowKind.COMPONENT else 0.0
                yield Difference(kind, *was.place(i), was.what(i), name, was.value(name, i), now.value(name, i), jump)
    elif was.n != now.n:
        longer = was if was.n > n else now
        texts = ("there", None) if longer is was else (None, "there")
        yield Difference(kind, *longer.place(n), longer.what(n), "row", *texts)


def _jump(was: _KindRows, now: _KindRows, i: int) -> float:
    """By how much H1 - H0 - dH of a component differ, 0 for rounding or where energies are not told."""
    ends = [[rows.value(name, i) for name in ("H1", "H0", "dH")] for rows in (was, now)]
    if any(value is None for values in ends for value in values):
        return 0.0
    (a1, a0, a), (b1, b0, b) = ends
    jump, size = abs((b1 - b0 - b) - (a1 - a0 - a)), max(map(abs, (a1, a0, b1, b0)))
    return jump if jump > CLOSE * size else 0.0
