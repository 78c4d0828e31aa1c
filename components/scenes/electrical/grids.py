"""Public grids in their operating points, with a three-phase fault, and generated ones of any size."""

from __future__ import annotations

from pathlib import Path

from phfmu import Scene
from phfmu.components.grids import Fault, Trip, grid_scene
from phfmu.components.grids.lattice import lattice
from phfmu.importers.grid import Grid, read_grid

DATA = Path(__file__).parents[2] / "grids" / "data"


def public_grid(name: str) -> Grid:
    """The grid `ieee39`, `wecc240` or `new_england` of the package, with its dynamic data."""
    return read_grid(DATA / name / f"{name}.raw", DATA / name)


def ieee39(
    *,
    bus: int = 16,
    t_fault: float = 0.1,
    t_clear: float = 0.2,
    trip: str = "",
    stop: float = 1.0,
    controls: bool = True,
) -> Scene:
    """39 buses, ten machines with exciters (SEXS) and governors (GAST); a fault of 0.001 pu at `bus` from t_fault to t_clear [s].

    trip: a line (`line16_17`) whose poles open from t_clear on at their current zeros;  stop [s]: end of the run
    controls: without them field voltages and torques are constant.  Members gen30, avr30, gov30, meter30, ..
    Source: ParaEMT_public of NREL, BSD 3-clause; phfmu/components/grids/data.
    """
    return _faulted("ieee39", Fault(bus, t_fault, t_clear), trip, stop, controls)


def new_england(
    *, bus: int = 16, t_fault: float = 0.1, t_clear: float = 0.2, trip: str = "", stop: float = 1.0
) -> Scene:
    """The 39 buses of New England as the books have them, ten machines of two axes; the arguments are those of `ieee39`.

    Source: case39 of MATPOWER; machines of Pai, Energy Function Analysis for Power System Stability, 1989.
    """
    return _faulted("new_england", Fault(bus, t_fault, t_clear), trip, stop, False)


def wecc240(
    *,
    bus: int = 3803,
    t_fault: float = 0.1,
    t_clear: float = 0.15,
    trip: str = "",
    stop: float = 0.5,
    controls: bool = False,
) -> Scene:
    """243 buses of the reduced WECC system, 111 machines, 91 plants as constant currents; the arguments are those of `ieee39`.

    With controls=True the machines have their 232 controllers, with 1126 state events.

    Source: ParaEMT_public of NREL, BSD 3-clause; phfmu/components/grids/data.
    """
    return _faulted("wecc240", Fault(bus, t_fault, t_clear), trip, stop, controls)


def grid(n: int = 100, *, seed: int = 0, stop: float = 0.5) -> Scene:
    """A generated grid of n buses, see `phfmu.components.grids.lattice`; a fault at bus 1 from 0.1 to 0.15 s."""
    return grid_scene(lattice(n, seed), faults=[Fault(1, 0.1, 0.15)], stop=stop)


def _faulted(name: str, fault: Fault, trip: str, stop: float, controls: bool) -> Scene:
    return grid_scene(
        public_grid(name), faults=[fault], trips=[Trip(trip)] if trip else [], plants="currents", controls=controls, stop=stop,
    )  # fmt: skip
