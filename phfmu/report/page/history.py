"""The rows of an audit as columns over time: of each component, port, junction, and the events."""

import os
from collections.abc import Iterator
from dataclasses import dataclass, field
from typing import TYPE_CHECKING, Any

import numpy as np

from phfmu.audit.kinds import RowKind
from phfmu.audit.log.archive import Stream, check_schema, there
from phfmu.audit.log.reading import InternedNames
from phfmu.report.recording import Floats

if TYPE_CHECKING:
    import pyarrow as pa

#: number columns that are read of each kind of row; a log without one gives NaN
NUMBERS: dict[RowKind, tuple[str, ...]] = {
    RowKind.COMPONENT: ("H0", "H1", "dH", "dissipated", "numerical", "residual", "residual_rel"),
    RowKind.PORT: ("supplied",),
    RowKind.JUNCTION: ("residual",),
    RowKind.NETWORK: ("iterations",),
    RowKind.EVENT: ("energy_jump",),
}
#: columns that tell rows of a kind apart
KEYS: dict[RowKind, tuple[str, ...]] = {
    RowKind.COMPONENT: ("component",),
    RowKind.PORT: ("component", "port", "junction"),
    RowKind.JUNCTION: ("junction",),
    RowKind.NETWORK: (),
    RowKind.EVENT: ("kind", "component", "message"),
}
BATCH_ROWS = 1 << 17
_WHEN = ("step", "t0", "h")

Columns = dict[str, Floats]
Key = tuple[str, ...]


@dataclass
class History:
    """Columns [rows] by key: `step`, `t0`, `h` and those of `NUMBERS`; absent names are "".

    components: (component,); ports: (component, port, junction), one row a step and pair; junctions: (junction,);
    steps: of the network; events: (kind, component, message). `about`: what the writer says of the run.
    """

    path: str
    about: dict[str, Any]
    components: dict[Key, Columns] = field(default_factory=dict)
    ports: dict[Key, Columns] = field(default_factory=dict)
    junctions: dict[Key, Columns] = field(default_factory=dict)
    events: dict[Key, Columns] = field(default_factory=dict)
    steps: Columns = field(default_factory=lambda: {name: np.zeros(0) for name in (*_WHEN, *NUMBERS[RowKind.NETWORK])})

    def within(self, start: float, stop: float) -> "History":
        """Steps whose middle lies within [start, stop], and the events there."""

        def cut(groups: dict[Key, Columns]) -> dict[Key, Columns]:
            parts = {key: _taken(c, _inside(c, start, stop)) for key, c in groups.items()}
            return {key: c for key, c in parts.items() if len(c["t0"])}

        return History(
            self.path, self.about, cut(self.components), cut(self.ports), cut(self.junctions), cut(self.events),
            _taken(self.steps, _inside(self.steps, start, stop)),
        )  # fmt: skip


def read_history(path: str | os.PathLike[str]) -> History:
    """One pass over an audit log; the memory it takes is that of its numbers.

    Errors: FileNotFoundError; ValueError for a file that is not an audit log, or is damaged.
    """
    import pyarrow as pa

    interned = InternedNames()
    parts: dict[RowKind, dict[tuple[int, ...], list[Columns]]] = {kind: {} for kind in NUMBERS}
    try:
        schema, batches = _batches(path)
        for batch in batches:
            _sort_in(batch, interned, parts)
    except (pa.ArrowInvalid, pa.ArrowNotImplementedError, pa.ArrowTypeError) as error:
        raise ValueError(f"{path} is not an audit log: {error}") from error
    except FileNotFoundError:
        raise
    except OSError as error:
        raise ValueError(f"{path} is damaged: {error}") from error

    def whole(kind: RowKind) -> dict[Key, Columns]:
        named = {tuple(interned.name(code) or "" for code in key): p for key, p in parts[kind].items()}
        return {key: {name: np.concatenate([c[name] for c in p]) for name in p[0]} for key, p in named.items()}

    told = (RowKind.COMPONENT, RowKind.PORT, RowKind.JUNCTION, RowKind.EVENT)
    components, ports, junctions, events = map(whole, told)
    found = History(str(path), _about(schema), components, ports, junctions, events)
    found.steps = whole(RowKind.NETWORK).get((), found.steps)
    return found


def _batches(path: str | os.PathLike[str]) -> "tuple[pa.Schema, Iterator[pa.RecordBatch]]":
    import pyarrow.parquet as pq

    place = there(path)
    if place.suffix == ".arrows":
        stream = Stream(place)
        check_schema(stream.schema.metadata, place)
        return stream.schema, iter(stream)
    file = pq.ParquetFile(place, page_checksum_verification=True)
    check_schema(file.schema_arrow.metadata, place)
    used = {"row", *_WHEN, *(n for names in (*NUMBERS.values(), *KEYS.values()) for n in names)}
    columns = [n for n in file.schema_arrow.names if n in used]
    return file.schema_arrow, file.iter_batches(BATCH_ROWS, columns=columns)


def _sort_in(
    batch: "pa.RecordBatch", interned: InternedNames, parts: dict[RowKind, dict[tuple[int, ...], list[Columns]]]
) -> None:
    """Put the rows of a batch to those of their kind and key."""
    columns = dict(zip(batch.schema.names, batch.columns, strict=True))

    def codes(name: str) -> Any:
        column = columns.get(name)
        return np.full(batch.num_rows, -1, np.int64) if column is None else interned.codes(column)

    def numbers(name: str) -> Floats:
        column = columns.get(name)
        if column is None or column.null_count == len(column):
            return np.full(batch.num_rows, np.nan)
        return column.cast("float64").fill_null(np.nan).to_numpy(zero_copy_only=False)

    rows, names, values = codes("row"), {}, {}
    for kind, found in parts.items():
        at = np.flatnonzero(rows == interned._code(kind))
        if not len(at):
            continue
        names |= {n: codes(n) for n in KEYS[kind] if n not in names}
        values |= {n: numbers(n) for n in (*_WHEN, *NUMBERS[kind]) if n not in values}
        size, keys = len(interned.names) + 1, np.zeros(len(at), np.int64)
        for name in KEYS[kind]:  # one number a row; the names of at most three columns fit
            keys = keys * size + names[name][at] + 1
        different, first, which = np.unique(keys, return_index=True, return_inverse=True)
        order = np.argsort(which.ravel(), kind="stable")
        cuts = np.cumsum(np.bincount(which.ravel()))[:-1]
        read = {n: values[n][at[order]] for n in (*_WHEN, *NUMBERS[kind])}
        cut = {n: np.split(column, cuts) for n, column in read.items()}
        for k, row in enumerate(at[first].tolist()):
            key = tuple(int(names[n][row]) for n in KEYS[kind])
            found.setdefault(key, []).append({n: column[k] for n, column in cut.items()})


def _about(schema: "pa.Schema") -> dict[str, Any]:
    from phfmu.audit import metadata

    return metadata(schema.empty_table())


def _inside(c: Columns, start: float, stop: float) -> Any:
    middle = c["t0"] + 0.5 * np.nan_to_num(c["h"])
    return (middle >= start) & (middle <= stop)


def _taken(c: Columns, at: Any) -> Columns:
    return {name: values[at] for name, values in c.items()}
