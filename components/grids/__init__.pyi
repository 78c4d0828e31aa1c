"""The names of `phfmu.components.grids` and where they are defined."""

from phfmu.components.grids.model import GridModel as GridModel
from phfmu.components.grids.model import grid_model as grid_model
from phfmu.components.grids.report import Report as Report
from phfmu.components.grids.report import Row as Row
from phfmu.components.grids.study import Fault as Fault
from phfmu.components.grids.study import Trip as Trip
from phfmu.components.grids.study import fault_of as fault_of
from phfmu.components.grids.study import grid_scene as grid_scene
from phfmu.components.grids.study import trip_of as trip_of

__all__: list[str]
