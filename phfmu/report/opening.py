"""Recognition of the kind of recording that a file is."""

import os
from pathlib import Path

from phfmu.audit.log.archive import SCHEMA_KEY
from phfmu.report.audit_signals import AuditSignals
from phfmu.report.page.history import read_history
from phfmu.report.recording import Recording
from phfmu.report.result_table import ResultTable


def is_audit(path: str | os.PathLike[str]) -> bool:
    """Whether the file is an audit log. Errors: FileNotFoundError; ValueError for another ending or what cannot be read."""
    place = Path(path)
    if place.is_dir():
        raise ValueError(f"{place} is a folder; name a file in it that phfmu run wrote: X.csv or X.parquet")
    if not place.suffix or ".py" in place.suffixes or place.name.partition(".")[2].startswith("py:"):
        run = f"phfmu run {place} -o RUN.csv"
        raise ValueError(f"{place} is no file of a run; run it first, and give the file that this writes: {run}")
    if place.suffix not in (".csv", ".parquet", ".arrows"):
        raise ValueError(f"{place}: the ending must be .csv or .parquet (table of a run) or .parquet (audit)")
    if not place.is_file():
        stream = place.with_suffix(".arrows")
        if place.suffix == ".parquet" and stream.is_file():
            return True  # the log says what is left of it
        raise FileNotFoundError(f"no file '{place}'; make one with: phfmu run TARGET -o RUN.csv --audit AUDIT.parquet")
    if not place.stat().st_size:
        raise ValueError(f"{place} is empty")
    if place.suffix != ".parquet":
        return place.suffix == ".arrows"
    import pyarrow as pa
    import pyarrow.parquet as pq

    try:
        return SCHEMA_KEY in (pq.read_schema(place).metadata or {})
    except pa.ArrowInvalid as error:
        raise ValueError(f"{place} was cut off or is not a Parquet file: {error}") from error


def opened(path: str | os.PathLike[str]) -> Recording:
    """The recording of a file: the table of a run or its audit; errors as for `is_audit`."""
    return AuditSignals(read_history(path)) if is_audit(path) else ResultTable(path)
