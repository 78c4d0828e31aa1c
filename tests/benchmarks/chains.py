"""Planar pendulum chains, horizontal at the start: the native engine against MuJoCo's RK4 (tree of hinges) at equal error.

n links of 1 m on a support, point masses of 1 kg, gravity 9.81 m/s2.  Errors at t = 1 s against DOP853 in link angles.
"""

from __future__ import annotations

import statistics

import numpy as np
from common import Run, at_error, medians, quartiles, relative, rounds
from scipy.integrate import solve_ivp

from phfmu import PHDAE
from phfmu.components.mechanical.multibody import Multibody

#: links: (error asked, ratio asked, simulated time, steps of the engine, steps of the peer)
CASES = {
    10: (1e-8, 12.0, 10.0, (0.04, 1 / 26, 1 / 28, 1 / 30), (0.01, 0.005, 0.0025)),
    50: (3e-9, 15.0, 2.0, (0.04, 1 / 28, 1 / 30, 1 / 32), (0.01, 0.005, 0.0025)),
}
GRAVITY = 9.81


def chain(n: int) -> PHDAE:
    """The chain in Cartesian coordinates (x, z)."""
    body = Multibody("chain", dim=2)
    body.gravity((0.0, -GRAVITY))
    points = [body.support((0.0, 0.0)), *(body.particle(1.0, (i + 1.0, 0.0)) for i in range(n))]
    for a, b in zip(points, points[1:], strict=False):
        body.bar(a, b)
    return body.build()


def exact(n: int) -> np.ndarray:
    """Positions at t = 1 from the equations in absolute angles a_i: link i points to (cos a_i, sin a_i)."""
    count = np.arange(n, 0, -1.0)
    weight = np.minimum.outer(count, count)  # masses beyond both links

    def rate(_: float, y: np.ndarray) -> np.ndarray:
        a, w = y[:n], y[n:]
        d = a[:, None] - a[None, :]
        right = -(weight * np.sin(d)) @ w**2 - GRAVITY * count * np.cos(a)
        return np.concatenate([w, np.linalg.solve(weight * np.cos(d), right)])

    y = solve_ivp(rate, (0.0, 1.0), np.zeros(2 * n), "DOP853", rtol=1e-13, atol=1e-13).y[:n, -1]
    return np.column_stack([np.cumsum(np.cos(y)), np.cumsum(np.sin(y))]).ravel()


class Hinges:
    """MuJoCo's fourth-order Runge-Kutta on a tree of hinges."""

    def __init__(self, n: int, h: float):
        import mujoco

        body = ""
        for i in reversed(range(n)):
            place = f"{float(i > 0)} 0 0"
            body = (
                f'<body pos="{place}"><joint type="hinge" axis="0 -1 0"/>'
                f'<inertial pos="1 0 0" mass="1" diaginertia="1e-9 1e-9 1e-9"/>{body}</body>'
            )
        text = (
            f'<mujoco><option timestep="{h!r}" gravity="0 0 -{GRAVITY}" integrator="RK4"><flag contact="disable"/></option>'
            f"<worldbody>{body}</worldbody></mujoco>"
        )
        self.model = mujoco.MjModel.from_xml_string(text)
        self.data = mujoco.MjData(self.model)
        self.reset, self.step, self.h, self.n = mujoco.mj_resetData, mujoco.mj_step, h, n

    def run(self, stop: float) -> None:
        self.reset(self.model, self.data)
        self.step(self.model, self.data, round(stop / self.h))

    def positions(self) -> np.ndarray:
        self.run(1.0)
        a = np.cumsum(self.data.qpos)
        return np.column_stack([np.cumsum(np.cos(a)), np.cumsum(np.sin(a))]).ravel()


def main() -> None:
    for n, (target, asked, stop, steps, others) in CASES.items():
        reference, declaration, errors, jobs = exact(n), chain(n), {}, {}
        for h in others:
            peer = Hinges(n, h)
            errors[f"mujoco h {h:g}"] = relative(peer.positions(), reference)
            jobs[f"mujoco h {h:g}"] = lambda peer=peer, stop=stop: peer.run(stop)
        for h in steps:
            run = Run(declaration, 6, h)
            errors[f"order 6 h {h:.4f}"], jobs[f"order 6 h {h:.4f}"] = (
                relative(run.positions(1.0), reference),
                run.job(stop),
            )
            count = run.instance.counts
            print(f"n {n} h {h:.4f}: {count['sweeps'] / count['steps']:.1f} sweeps, {count['restarts']} restarts, "
                  f"{count['iterations']} Newton iterations")  # fmt: skip
        found, costs = rounds(jobs, 11), []
        for name, t in medians(found).items():
            print(f"n {n} {name:18} error {errors[name]:8.1e}   {1e3 * t / stop:8.4f} ms/s")
        for cost in found:
            lines = [[(errors[k], cost[k]) for k in cost if k.startswith(kind)] for kind in ("mujoco", "order")]
            costs.append([at_error(line, target) for line in lines])
        peer, ours = (1e3 * statistics.median(c) / stop for c in zip(*costs, strict=True))
        ratio = quartiles([p / o for p, o in costs])
        print(f"n {n} error {target:g}: {ours:.4f} against {peer:.4f} ms/s, ratio {ratio} (asked {asked:g})")


if __name__ == "__main__":
    main()
