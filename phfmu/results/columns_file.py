"""RUN.columns.json beside RUN.csv: unit, kind and label of each column, which CSV has no place for.

    {"time": {"unit": "s"}, "gen.I[4]": {"unit": "A", "kind": "observable", "label": "gen.I[fd]"}, ..}

In pandas: `pandas.read_json("run.columns.json", orient="index")` is a table of the columns.  A file of units of one's own,
{"time": "s", "gen.I[4]": "A"}, is read too.
"""

from __future__ import annotations

import json
import os
from collections.abc import Mapping
from pathlib import Path
from typing import TYPE_CHECKING, Any

from phfmu.files import beside
from phfmu.results.schema import KIND_KEY, LABEL_KEY, UNIT_KEY

if TYPE_CHECKING:
    import pyarrow as pa

_KEYS = (UNIT_KEY, KIND_KEY, LABEL_KEY)


def columns_file(table: Path) -> Path:
    """The file that tells of the columns of a CSV."""
    return table.with_suffix(".columns.json")


def write_columns(table: Path, schema: pa.Schema) -> None:
    """Write what a schema says of its columns, whole or not at all."""
    told = {f.name: {k.decode(): f.metadata[k].decode() for k in _KEYS if k in (f.metadata or {})} for f in schema}
    path = columns_file(table)
    begun = beside(path)
    lines = (
        f"  {json.dumps(n, ensure_ascii=False)}: {json.dumps(about, ensure_ascii=False)}" for n, about in told.items()
    )
    try:
        begun.write_text("{\n" + ",\n".join(lines) + "\n}\n", encoding="utf-8")
        os.replace(begun, path)
    except OSError:
        begun.unlink(missing_ok=True)
        raise


def read_columns(table: Path) -> dict[bytes, dict[str, str]]:
    """Key of a schema -> column -> its text, of the file beside a CSV; nothing where there is none.

    Errors: ValueError for a file that is not of this form.
    """
    path = columns_file(table)
    if not path.is_file():
        return {}
    try:
        found: Any = json.loads(path.read_text(encoding="utf-8"))
        if not isinstance(found, Mapping):
            raise ValueError("it holds no object")
        told = {n: {"unit": about} if isinstance(about, str) else dict(about) for n, about in found.items()}
        return {k: {n: str(about[k.decode()]) for n, about in told.items() if about.get(k.decode())} for k in _KEYS}
    except (ValueError, TypeError) as error:
        raise ValueError(
            f"{path} does not tell of the columns of {table.name}: {error}; delete it, or write the table again with "
            f"phfmu run TARGET -o {table.name}"
        ) from error
