"""Networks of the tables that `phfmu.importers.grid` reads: parts, operating point, faults and trips."""

from phfmu.components.grids.model import GridModel, grid_model
from phfmu.components.grids.report import Report, Row
from phfmu.components.grids.study import Fault, Trip, fault_of, grid_scene, trip_of

__all__ = [
    "Fault", "GridModel", "Report", "Row", "Trip", "fault_of", "grid_model", "grid_scene", "trip_of",
]  # fmt: skip
