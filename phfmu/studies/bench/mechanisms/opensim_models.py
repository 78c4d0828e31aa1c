"""OpenSim on any assembly of hinges and sliders: joint coordinates, loops closed by point constraints, Runge-Kutta-Merson.

The interpreter of its environment is named by PHFMU_OPENSIM: `python -m venv E && E/bin/pip install opensim`.
"""

from __future__ import annotations

import json
import os
import subprocess
from collections.abc import Iterator, Sequence
from pathlib import Path
from typing import Any

import numpy as np

from phfmu.studies.bench.mechanisms.assembly import Array, BodyJoint, RigidBodySystem, frame_along
from phfmu.studies.bench.mechanisms.case import MechanismCase
from phfmu.studies.bench.mechanisms.mujoco_models import anchors
from phfmu.studies.bench.precision.candidate import Candidate, CandidateRun, NotAvailable, missing

RUN = Path(__file__).with_name("opensim_run.py")
VARIABLE = "PHFMU_OPENSIM"


def candidates(case: MechanismCase) -> Iterator[Candidate]:
    if not case.steps.opensim or case.assembly is None:
        return
    python = os.environ.get(VARIABLE)
    if not python:
        yield missing(
            "OpenSim", f"no interpreter; pip install opensim into an environment of its own, {VARIABLE}=its python"
        )
        return
    process: list[Process] = []
    for accuracy in case.steps.opensim:
        yield Candidate(
            "OpenSim Runge-Kutta-Merson", f"accuracy={accuracy:g}", accuracy,
            lambda a=accuracy: _OpenSim(case, _started(process, python, case), a),
        )  # fmt: skip


def _started(kept: list[Process], python: str, case: MechanismCase) -> Process:
    if not kept:
        kept.append(Process(python, case))
    return kept[0]


def described(assembly: RigidBodySystem, stop: float) -> dict[str, Any]:
    """An assembly as OpenSim's process takes it."""

    def link_of(link: BodyJoint) -> dict[str, Any]:
        z = frame_along(link.axis)
        frame = z if link.kind == "revolute" else z[:, [2, 0, 1]]
        return {
            "kind": link.kind, "a": link.a, "b": link.b, "at": link.at.tolist(), "frame": frame.tolist(),
            "rate": float(link.axis @ assembly.rate(link)), "torque": link.torque, "damping": link.damping,
        }  # fmt: skip

    if any(link.kind == "spherical" for link in assembly.links):
        raise NotAvailable("balls are not described here")
    six = ([0, 1, 2, 0, 0, 1], [0, 1, 2, 1, 2, 2])
    return {
        "gravity": assembly.gravity.tolist(), "stop": stop, "tree": [link_of(x) for x in assembly.tree],
        "bodies": [
            {"mass": b.mass, "centre": b.centre.tolist(), "inertia": b.inertia[six].tolist()} for b in assembly.bodies
        ],
        "loops": [
            {"a": x.a, "b": x.b, "points": [p.tolist() for p in anchors(assembly, x)]} for x in assembly.loops
        ],
        "struts": [
            {"a": s.a, "b": s.b, "at_a": s.at_a.tolist(), "at_b": s.at_b.tolist(), "stiffness": s.stiffness,
             "length": s.length}
            for s in assembly.struts
        ],
        "points": [[i, x.tolist()] for i, x in assembly.points],
    }  # fmt: skip


class Process:
    """OpenSim's interpreter with one model."""

    def __init__(self, python: str, case: MechanismCase):
        assert case.assembly is not None
        try:
            self._process = subprocess.Popen(
                [python, str(RUN)], stdin=subprocess.PIPE, stdout=subprocess.PIPE, stderr=subprocess.DEVNULL, text=True
            )
        except OSError as failure:
            raise NotAvailable(f"{VARIABLE}={python}: {failure.strerror}") from failure
        self._said: list[str] = []
        self._write(json.dumps(described(case.assembly, case.stop)))

    def _write(self, line: str) -> None:
        assert self._process.stdin is not None
        self._process.stdin.write(line + "\n")
        self._process.stdin.flush()

    def run(self, accuracy: float) -> tuple[float, Array]:
        """CPU time [s] and points; RuntimeError with what it said."""
        try:
            self._write(repr(accuracy))
        except OSError as failure:
            raise NotAvailable(f"its process ended: {failure}") from failure
        assert self._process.stdout is not None
        for line in self._process.stdout:
            if line.startswith("JSON"):
                found = json.loads(line[4:])
                if "error" in found:
                    raise RuntimeError(found["error"])
                return found["cpu"], np.array(found["points"])
        raise NotAvailable("its process ended; is opensim installed in it?")


class _OpenSim:
    """Runs of OpenSim's process at an accuracy."""

    def __init__(self, case: MechanismCase, process: Process, accuracy: float):
        self._case, self._process, self._accuracy = case, process, accuracy

    def __call__(self, times: Sequence[float], watch: bool = False) -> CandidateRun:
        cpu, points = self._process.run(self._accuracy)
        return CandidateRun(self._case.flat(points[None]), cpu=cpu)
