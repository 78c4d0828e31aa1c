"""Networks of the tables that `phfmu.importers.grid` reads: parts, operating point, faults and trips."""

from phfmu.components.grids.model import GridModel, grid_model
from phfmu.components.grids.report import Report, Row
from phfmu.components.grids.study import grid_scene

__all__ = ["GridModel", "Report", "Row", "grid_model", "grid_scene"]
