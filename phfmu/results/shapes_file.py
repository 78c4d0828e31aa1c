"""RUN.shapes.json beside the table of a run: the shapes that its columns move, see `phfmu.declare.shape`."""

from __future__ import annotations

import json
import os
from collections.abc import Sequence
from pathlib import Path

from phfmu.declare.shape import Shape, from_data, to_data
from phfmu.files import beside


def shapes_file(table: Path) -> Path:
    """The file that tells of the shapes of a table."""
    return table.with_suffix(".shapes.json")


def write_shapes(table: Path, shapes: Sequence[Shape]) -> None:
    """Write it, whole or not at all; without shapes there is none, and one of an earlier run goes."""
    path = shapes_file(table)
    if not shapes:
        path.unlink(missing_ok=True)
        return
    begun = beside(path)
    try:
        begun.write_text(json.dumps(to_data(shapes), ensure_ascii=False), encoding="utf-8")
        os.replace(begun, path)
    except OSError:
        begun.unlink(missing_ok=True)
        raise


def read_shapes(table: Path) -> tuple[Shape, ...]:
    """The shapes of a table, () where no file tells of them. Errors: ValueError for a file that is not of this form."""
    path = shapes_file(table)
    if not path.is_file():
        return ()
    try:
        return from_data(json.loads(path.read_text(encoding="utf-8")))
    except (ValueError, TypeError, KeyError) as error:
        raise ValueError(
            f"{path} does not tell of shapes: {error}; delete it, and name the target they are of: "
            f"phfmu view {table.name} --shapes TARGET"
        ) from error
