"""Grids of power flow programs as one neutral table: PSS/E (.raw, .dyr, tables), MATPOWER, pandapower."""

from __future__ import annotations

from os import PathLike

from phfmu.files import GRIDS
from phfmu.importers.grid.dynamics import read_dyr, with_dynamics
from phfmu.importers.grid.matpower import from_pandapower, read_matpower
from phfmu.importers.grid.raw import read_raw
from phfmu.importers.grid.table import (
    Bus,
    Demand,
    Dynamics,
    Generator,
    Grid,
    GridError,
    Line,
    Shunt,
    Transformer,
)


def read_grid(path: str | PathLike[str], dynamics: str | PathLike[str] | None = None) -> Grid:
    """The grid of a .raw or .m, with the dynamic data of `dynamics` if it is given."""
    text = str(path)
    if not text.lower().endswith(GRIDS):
        raise GridError(text, [f"no grid: its name ends in none of {', '.join(GRIDS)}"])
    grid = read_raw(path) if text.lower().endswith(".raw") else read_matpower(path)
    return grid if dynamics is None else with_dynamics(grid, dynamics)


__all__ = [
    "Bus", "Demand", "Dynamics", "Generator", "Grid", "GridError", "Line", "Shunt", "Transformer", "from_pandapower",
    "read_dyr", "read_grid", "read_matpower", "read_raw", "with_dynamics",
]  # fmt: skip
