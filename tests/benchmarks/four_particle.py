"""Four damped particles: the native engine against CasADi's cvodes at equal error.

The peer in its best form: lambda eliminated, constraints stabilised after Baumgarte (gamma = 20/s), Adams methods.
"""

from __future__ import annotations

import statistics
from pathlib import Path

import casadi as ca
import numpy as np
from common import Run, at_error, medians, quartiles, relative, rounds

from phfmu.components.mechanical.four_particle import four_particle

STOP = 10.0
TARGETS = {2e-4: 6.0, 5e-9: 8.0}
STEPS = {2: (0.0113, 0.01, 0.005), 6: (0.1, 0.07, 0.05, 0.035, 0.025, 0.02, 0.0146, 0.0143, 0.0125, 0.01)}
TOLERANCES = (1e-3, 3e-4, 1e-4, 1e-6, 1e-7, 1e-8, 1e-9)
REFERENCE = Path(__file__).parent.parent / "reference" / "four_particle.csv"


def ode() -> tuple[ca.SX, ca.SX]:
    """State (q, v) and its rate."""
    q, v = ca.SX.sym("q", 12), ca.SX.sym("v", 12)
    p = [q[3 * i : 3 * i + 3] for i in range(4)]
    u = [v[3 * i : 3 * i + 3] for i in range(4)]
    mass = np.repeat([1.0, 3.0, 2.3, 1.7], 3)
    potential = 25.0 * (ca.sumsqr(p[2] - p[0]) - 1) ** 2 + 250.0 * (ca.sumsqr(p[3] - p[1]) - 1) ** 2
    drag = (1 + 0.5 * ca.sumsqr(p[2] - p[1])) * (u[2] - u[1])
    force = -ca.gradient(potential, q) + ca.vertcat(ca.SX(3, 1), drag, -drag, ca.SX(3, 1))
    g = ca.vertcat(ca.sumsqr(p[1] - p[0]) - 1, ca.sumsqr(p[3] - p[2]) - 1) / 2
    rows = ca.jacobian(g, q)
    gamma = 20.0
    w = ca.mtimes(rows, v)
    turning = ca.mtimes(ca.jacobian(w, q), v)
    schur = ca.mtimes(rows, (rows / ca.repmat(ca.DM(mass).T, 2, 1)).T)
    right = ca.mtimes(rows, force / mass) + turning + 2 * gamma * w + gamma**2 * g
    det = schur[0, 0] * schur[1, 1] - schur[0, 1] * schur[1, 0]
    lam = (
        ca.vertcat(schur[1, 1] * right[0] - schur[0, 1] * right[1], schur[0, 0] * right[1] - schur[1, 0] * right[0])
        / det
    )
    return ca.vertcat(q, v), ca.vertcat(v, (force - ca.mtimes(rows.T, lam)) / mass)


def main() -> None:
    rows = [line for line in REFERENCE.read_text().splitlines() if not line.startswith("#")]
    exact = next(r for r in np.loadtxt(rows[1:], delimiter=",") if r[0] == 1.0)[1:13]
    declaration = four_particle()
    start = np.concatenate([declaration.states[0].start, declaration.states[1].start])
    x, rate = ode()
    errors, jobs = {}, {}
    for tolerance in TOLERANCES:
        options = {"linear_multistep_method": "adams", "reltol": tolerance, "abstol": 1e-2 * tolerance}
        problem = {"x": x, "ode": rate}
        short = ca.integrator("short", "cvodes", problem, 0.0, 1.0, options | {"max_num_steps": 100000})
        whole = ca.integrator("whole", "cvodes", problem, 0.0, STOP, options | {"max_num_steps": 100000})
        name = f"cvodes {tolerance:g}"
        errors[name] = relative(np.array(short(x0=start)["xf"]).ravel()[:12], exact)
        jobs[name] = lambda whole=whole: whole(x0=start)
    for order, steps in STEPS.items():
        for h in steps:
            run = Run(declaration, order, h)
            name = f"order {order} h {h:g}"
            errors[name], jobs[name] = relative(run.positions(1.0), exact), run.job(STOP)
            run.instance.reset()
    found = rounds(jobs, 41)
    for name, t in medians(found).items():
        print(f"{name:18} error {errors[name]:8.1e}   {1e3 * t / STOP:7.4f} ms/s")
    for target, asked in TARGETS.items():
        costs = [equal(errors, cost, target) for cost in found]
        ours, peer = (1e3 * statistics.median(c) / STOP for c in zip(*costs, strict=True))
        ratio = quartiles([p / o for o, p in costs])
        print(f"error {target:g}: {ours:.4f} against {peer:.4f} ms/s, ratio {ratio} (asked {asked:g})")


def equal(errors: dict[str, float], cost: dict[str, float], target: float) -> tuple[float, float]:
    """Cost of the engine, in its better order, and of cvodes at one error."""
    peer = at_error([(errors[n], cost[n]) for n in cost if n.startswith("cvodes")], target)
    lines = [[(errors[n], cost[n]) for n in cost if n.startswith(f"order {k}")] for k in STEPS]
    return float(np.nanmin([at_error(line, target) for line in lines])), peer


if __name__ == "__main__":
    main()
