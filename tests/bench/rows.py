"""Declarations by name, rows of a benchmark."""

from __future__ import annotations

from pathlib import Path

import numpy as np

from phfmu import Scene
from phfmu.components.library import build
from phfmu.declare.phdae import PHDAE
from phfmu.network.network import Network
from phfmu.studies.bench.precision.peers import ProblemFunctions
from phfmu.studies.bench.precision.problem import InitialValueProblem

REFERENCE = Path(__file__).parents[1] / "reference"


def declaration(name: str) -> PHDAE:
    item = build(name)
    if isinstance(item, Scene):
        return item.declaration()
    return item.compose() if isinstance(item, Network) else item


def rows(name: str) -> dict[float, np.ndarray]:
    """Independent states by time."""
    lines = [t for t in (REFERENCE / f"{name}.csv").read_text().splitlines() if not t.startswith("#")]
    return {float(t.split(",")[0]): np.array([float(x) for x in t.split(",")[1:]]) for t in lines[1:]}


# -- peers that may be absent -------------------------------------------------------------------------------------------


def solved(p: InitialValueProblem) -> InitialValueProblem:
    from phfmu.studies.bench.precision.peers import solve_reference

    solve_reference(p, ProblemFunctions(p))
    return p
