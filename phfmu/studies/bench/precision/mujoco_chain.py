"""MuJoCo on pendulum chains: hinge coordinates, so that no constraint can drift.

Best practice: a tree of hinges (minimal coordinates), contacts and constraints disabled, RK4 with small steps (the most accurate
integrator it has) beside `implicitfast` (its own recommendation for robots).  Point masses need a tiny inertia (1e-9 kg m2).
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from importlib import import_module
from importlib.util import find_spec
from typing import Any

import numpy as np

from phfmu.studies.bench.precision.candidate import Candidate, CandidateRun, missing
from phfmu.studies.bench.precision.problem import InitialValueProblem

STEPS = (0.02, 0.01, 0.005, 0.002)


def candidates(problem: InitialValueProblem, links: int) -> Iterator[Candidate]:
    if find_spec("mujoco") is None:
        yield missing("MuJoCo", "not installed; pip install mujoco")
        return
    for integrator in ("RK4", "implicitfast"):
        for h in STEPS:
            yield Candidate(
                f"MuJoCo {integrator}", f"h={h:g}", h, lambda i=integrator, h=h: _MuJoCo(problem, links, i, h)
            )


def _xml(links: int, h: float, integrator: str) -> str:
    """Unit point masses at the ends of unit links along x from the origin, hinges about y."""
    bodies = "".join(
        f'<body pos="{min(i, 1)} 0 0"><joint type="hinge" axis="0 1 0"/>'
        '<inertial pos="1 0 0" mass="1" diaginertia="1e-9 1e-9 1e-9"/>'
        for i in range(links)
    )
    return (
        f'<mujoco><option timestep="{h}" integrator="{integrator}" gravity="0 0 -9.81">'
        '<flag contact="disable" constraint="disable"/></option>'
        f"<worldbody>{bodies}{'</body>' * links}</worldbody></mujoco>"
    )


class _MuJoCo:
    """A chain of hinged links stepped by one of MuJoCo's integrators with steps of h [s]."""

    def __init__(self, problem: InitialValueProblem, links: int, integrator: str, h: float):
        problem.require_step(h)
        mujoco: Any = import_module("mujoco")
        self._lib, self._h, self._links = mujoco, h, links
        self._model: Any = mujoco.MjModel.from_xml_string(_xml(links, h, integrator))
        self._data: Any = mujoco.MjData(self._model)

    def __call__(self, times: Sequence[float], watch: bool = False) -> CandidateRun:
        self._lib.mj_resetData(self._model, self._data)
        done, rows = 0, []
        for t in times:
            n = round(t / self._h)
            self._lib.mj_step(self._model, self._data, nstep=n - done)
            done = n
            rows.append(self._state())
        return CandidateRun(np.array(rows), done)

    def _state(self) -> np.ndarray:
        """Positions and velocities of the masses in x and z, as the declaration orders them."""
        self._lib.mj_forward(self._model, self._data)
        velocity = np.zeros((self._links, 6))
        for i in range(self._links):
            self._lib.mj_objectVelocity(self._model, self._data, self._lib.mjtObj.mjOBJ_BODY, i + 1, velocity[i], 0)
        return np.concatenate([self._data.xipos[1:, ::2].ravel(), velocity[:, 3::2].ravel()])
