"""Runs of OpenSim in a process of its own: an assembly as a line of JSON, then accuracies, each answered with time and points.

OpenSim wants another NumPy, and cannot be imported beside CasADi: it lives in an environment of its own, with nothing but itself.
"""

from __future__ import annotations

import json
import sys
from math import asin, atan2
from time import process_time
from typing import Any


class OpenSimModel:
    """Bodies whose frames have the axes of the world at the start and their origin in the joint of the tree."""

    def __init__(self, opensim: Any, given: dict[str, Any]):
        self.o, self.given = opensim, given
        self.model = opensim.Model()
        self.model.setGravity(self.vector(given["gravity"]))
        ground = self.model.getGround()
        self.bodies, self.origins, self.rates = {-1: ground}, {-1: [0.0, 0.0, 0.0]}, {}
        for link in given["tree"]:
            self.origins[link["b"]] = link["at"]
        for i, b in enumerate(given["bodies"]):
            made = opensim.Body(f"b{i}", b["mass"], self.local(i, b["centre"]), opensim.Inertia(*b["inertia"]))
            self.model.addBody(made)
            self.bodies[i] = made
        for link in given["tree"]:
            self.joint(link)
        for n, link in enumerate(given["loops"]):
            self.loop(n, link)
        for n, strut in enumerate(given["struts"]):
            self.strut(n, strut)
        self.model.finalizeConnections()

    def vector(self, x: list[float]) -> Any:
        return self.o.Vec3(*map(float, x))

    def local(self, body: int, at: list[float]) -> Any:
        return self.vector([x - y for x, y in zip(at, self.origins[body], strict=True)])

    def joint(self, link: dict[str, Any]) -> None:
        """A pin about z or a slider along x of a frame turned by body-fixed angles about x, y, z."""
        f = link["frame"]
        turn = self.vector([atan2(-f[1][2], f[2][2]), asin(max(-1.0, min(1.0, f[0][2]))), atan2(-f[0][1], f[0][0])])
        kind = self.o.PinJoint if link["kind"] == "revolute" else self.o.SliderJoint
        a, b, name = link["a"], link["b"], f"j{link['b']}"
        at = link["at"]
        made = kind(name, self.bodies[a], self.local(a, at), turn, self.bodies[b], self.local(b, at), turn)
        coordinate = made.updCoordinate()
        coordinate.setName(f"q{b}")
        self.rates[b] = (coordinate, link["rate"])
        self.model.addJoint(made)
        expression = f"{link['torque']!r} - {link['damping']!r}*qdot"
        if link["torque"] or link["damping"]:
            self.model.addForce(self.o.ExpressionBasedCoordinateForce(f"q{b}", expression))

    def loop(self, n: int, link: dict[str, Any]) -> None:
        """A point held, in space two points along the axis of a hinge."""
        for k, at in enumerate(link["points"]):
            made = self.o.PointConstraint(
                self.bodies[link["a"]], self.local(link["a"], at), self.bodies[link["b"]], self.local(link["b"], at)
            )
            made.setName(f"loop{n}_{k}")
            self.model.addConstraint(made)

    def strut(self, n: int, s: dict[str, Any]) -> None:
        a, b = self.bodies[s["a"]], self.bodies[s["b"]]
        ends = self.local(s["a"], s["at_a"]), self.local(s["b"], s["at_b"])
        made = self.o.PointToPointSpring(a, ends[0], b, ends[1], s["stiffness"], s["length"])
        made.setName(f"spring{n}")
        self.model.addForce(made)

    def run(self, accuracy: float) -> dict[str, Any]:
        """CPU time from the start to the end [s], and the places of the points there."""
        state = self.model.initSystem()
        for coordinate, rate in self.rates.values():
            coordinate.setSpeedValue(state, rate)
        manager = self.o.Manager(self.model)
        manager.setIntegratorMethod(self.o.Manager.IntegratorMethod_RungeKuttaMerson)
        manager.setIntegratorAccuracy(accuracy)
        manager.setWriteToStorage(False)
        manager.setPerformAnalyses(False)
        before = process_time()
        manager.initialize(state)
        end = manager.integrate(self.given["stop"])
        spent = process_time() - before
        self.model.realizePosition(end)
        points = [self.bodies[i].findStationLocationInGround(end, self.local(i, at)) for i, at in self.given["points"]]
        return {"cpu": spent, "points": [float(p.get(k)) for p in points for k in range(3)]}


def main() -> None:
    import opensim  # type: ignore[import-not-found]

    opensim.Logger.setLevelString("Off")
    model = OpenSimModel(opensim, json.loads(sys.stdin.readline()))
    for line in sys.stdin:
        try:
            answer = model.run(float(line))
        except Exception as failure:  # the process goes on with the next accuracy
            answer = {"error": str(failure).strip().splitlines()[0]}
        print("JSON" + json.dumps(answer), flush=True)


if __name__ == "__main__":
    main()
