"""Dynamic data of machines, exciters and governors: .dyr of PSS/E, and tables with a column for each unit."""

from __future__ import annotations

import csv
import re
from collections.abc import Iterable, Iterator, Sequence
from dataclasses import replace
from glob import glob
from os import PathLike
from pathlib import Path

from phfmu.importers.grid.table import Dynamics, Grid, GridError
from phfmu.words import first_few

#: model -> its parameters in the order of a record
PARAMETERS: dict[str, tuple[str, ...]] = {
    "GENROU": ("Td10", "Td20", "Tq10", "Tq20", "H", "D", "xd", "xq", "xd1", "xq1", "xd2", "xl", "S1", "S12"),
    "GENSAL": ("Td10", "Td20", "Tq20", "H", "D", "xd", "xq", "xd1", "xd2", "xl", "S1", "S12"),
    "GENCLS": ("H", "D"),
    "TWOAXIS": ("Td10", "Tq10", "H", "xd", "xq", "xd1", "xq1", "xl"),
    "SEXS": ("TA_TB", "TB", "K", "TE", "Emin", "Emax"),
    "TGOV1": ("R", "T1", "Vmax", "Vmin", "T2", "T3", "Dt"),
    "HYGOV": ("R", "r", "Tr", "Tf", "Tg", "VELM", "Gmax", "Gmin", "TW", "At", "Dturb", "qNL"),
    "GAST": ("R", "T1", "T2", "T3", "AT", "KT", "Vmax", "Vmin", "Dturb"),
    "IEEEST": ("A1", "A2", "A3", "A4", "A5", "A6", "T1", "T2", "T3", "T4", "T5", "T6", "KS", "LSmax", "LSmin", "VCU", "VCL"),
}  # fmt: skip
#: parameters of .dyr before these that are no numbers of the model: IEEEST says what it measures, and where
CHOICES = {"IEEEST": 2}
#: first cells of the rows of a table that say whose column it is
BUS, ID, TYPE = ("BUS #", "BUS"), ("GEN ID", "ID"), ("TYPE",)


def with_dynamics(grid: Grid, source: str | PathLike[str]) -> Grid:
    """The grid with dynamic data of a .dyr, an .xlsx, or of .csv tables: a folder, a file or a pattern such as `dyn_39_*.csv`.

    GridError for what cannot be read, and for two sets of data of one model for one unit.
    """
    text = str(source)
    if text.lower().endswith(".dyr"):
        found = read_dyr(text)
    elif text.lower().endswith((".xlsx", ".xls")):
        found = [d for name, rows in _sheets(text) for d in _units(name, rows)]
    else:
        found = [d for file in _files(text) for d in _units(file.name, _rows(file))]
    there = {b.number for b in grid.buses}
    twice: list[str] = []
    seen: dict[tuple[int, str, str], Dynamics] = {}
    for d in found:
        key = d.bus, d.id, d.model
        if key in seen:
            twice.append(
                f"{d.where}: {d.model} of '{d.id}' at bus {d.bus} stands in {seen[key].where} too; "
                "give the files of one case, as a folder of its own or a pattern"
            )
        seen[key] = d
    if twice:
        raise GridError(text, twice[:3])
    # measuring and inverter plants' tables also speak of buses that the case may not have in service
    return replace(grid, dynamics=(*grid.dynamics, *(d for d in found if d.bus in there or d.model in PARAMETERS)))


def read_dyr(path: str | PathLike[str]) -> list[Dynamics]:
    """The records `bus 'MODEL' id numbers .. /` of a .dyr."""
    file, out = Path(path), []
    if not file.is_file():
        raise GridError(str(path), ["there is no such file"])
    text = re.sub(r"//.*|@!.*", "", file.read_text(encoding="utf-8", errors="replace"))
    for number, record in enumerate(filter(str.strip, re.split(r"/[^\n]*(?:\n|$)", text)), 1):
        words = re.findall(r"'[^']*'|[^\s,]+", record)
        where = f"{file.name}, record {number}"
        if len(words) < 3 or not words[0].lstrip("-").isdigit():
            raise GridError(
                file.name, [f"record {number}: '{record.strip()[:60]}' is not: bus 'MODEL' id numbers .. /"]
            )
        model = words[1].strip("' ").upper()
        out.append(_dynamics(int(words[0]), words[2], model, words[3 + CHOICES.get(model, 0) :], where))
    return out


def _dynamics(bus: int, unit: str, model: str, cells: Sequence[str], where: str) -> Dynamics:
    """Numbers by name; those of models that are not known have their place as name."""
    names = PARAMETERS.get(model)
    if names is None:
        return Dynamics(bus, identifier(unit), model, {}, where)
    cells = [c for c in cells if c.strip()]
    if len(cells) < len(names):
        missing = ", ".join(names[len(cells) :])
        raise GridError(
            where, [f"{model} of '{identifier(unit)}' at bus {bus} has {len(cells)} numbers; missing: {missing}"]
        )
    return Dynamics(
        bus, identifier(unit), model, dict(zip(names, _numbers(cells, where, model, bus), strict=False)), where
    )


def _numbers(cells: Iterable[str], where: str, model: str, bus: int) -> list[float]:
    try:
        return [float(c) for c in cells]
    except ValueError as error:
        raise GridError(where, [f"{model} at bus {bus}: {error}"]) from None


def identifier(text: str) -> str:
    """The identifier of a unit as all files mean it: `1'`, `1.0` and ` 1 ` are 1."""
    text = text.strip().strip("'\"").strip()
    return text[:-2] if text.endswith(".0") else text


def _files(text: str) -> list[Path]:
    folder = Path(text)
    found = sorted(folder.glob("*.csv") if folder.is_dir() else map(Path, glob(text)))
    if not found:
        raise GridError(text, ["there are no tables (.csv) here; give a folder, a pattern, an .xlsx or a .dyr"])
    return [f for f in found if not f.stem.endswith("_para")]


def _rows(file: Path) -> list[list[str]]:
    with file.open(newline="", encoding="utf-8-sig") as stream:
        return list(csv.reader(stream))


def _sheets(path: str) -> Iterator[tuple[str, list[list[str]]]]:
    try:
        from openpyxl import load_workbook
    except ImportError:
        raise ImportError("tables of .xlsx need openpyxl: pip install 'phfmu[grid]'") from None
    for sheet in load_workbook(path, read_only=True, data_only=True):
        rows = [["" if c is None else str(c) for c in row] for row in sheet.iter_rows(values_only=True)]
        yield f"{Path(path).name}, {sheet.title}", rows


def _units(name: str, rows: list[list[str]]) -> Iterator[Dynamics]:
    """The data of a table whose first column has names of parameters and whose others are units.

    Numbers stand in the order of the model's record, since a table of several models can name its rows for one of them only.
    """
    heads = [row[0].strip().upper() if row else "" for row in rows]
    where = {kind: next((k for k, h in enumerate(heads) if h in words), None) for kind, words in
             (("bus", BUS), ("id", ID), ("type", TYPE))}  # fmt: skip
    if where["bus"] is None:
        raise GridError(name, [f"no row 'Bus #' says whose the columns are; its rows: {first_few(heads)}"])
    stem = (
        Path(name.partition(",")[0]).stem.rpartition("_")[2].upper() if "," not in name else name.split(", ")[1].upper()
    )
    first = max(k for k in where.values() if k is not None) + 1
    for column in range(1, len(rows[0])):
        cell = lambda k, column=column: rows[k][column].strip() if k is not None and column < len(rows[k]) else ""  # noqa: E731
        if not cell(where["bus"]):
            continue
        try:
            bus = int(float(cell(where["bus"])))
        except ValueError:
            raise GridError(name, [f"column {column + 1}: bus '{cell(where['bus'])}' is no number"]) from None
        model = cell(where["type"]).upper() or stem
        yield from _column(
            bus, cell(where["id"]), model, [cell(k) for k in range(first, len(rows))], heads[first:], name
        )


def _column(bus: int, unit: str, model: str, cells: list[str], heads: list[str], name: str) -> Iterator[Dynamics]:
    data = _dynamics(bus, unit, model, cells, name)
    values = dict(data.values)
    if "RA" in heads and cells[heads.index("RA")]:
        values["ra"] = float(cells[heads.index("RA")])
    if model == "VM" and cells and cells[0]:
        values["T"] = float(cells[0])
    yield replace(data, values=values)
