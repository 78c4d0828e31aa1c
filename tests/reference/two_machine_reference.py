"""Two machines, a line, a parallel RLC load and a fault (scene `two_machine` of scenes.json).

    bus 1   machine 1 and the line only:   i_line + I_1 = 0   (abc; i_line runs from bus 1 to bus 2)
    line    v1 - v2 = R i_line + L i_line'
    bus 2   C v2' = i_line - I_2 - i_L - v2/R_load - (v2/R_fault while the fault is on)
    load    L_load i_L' = v2

The bare bus 1 makes this an index-2 system. i_line = -I_1, so the line is lumped into machine 1
(machine_reference.py with Rx = R, Lx = L, far-end voltage v2), which leaves an ODE:
y = (total flux 1 [6], p1 - J1 w, theta1 - w t, flux 2 [6], p2 - J2 w, theta2 - w t, v2 [3], i_L [3]).
The bus-1 voltage follows exactly: v1 = v2 - R I_1 - L I_1', I_1' = L_1^-1 (psi_1' - omega_1 L_1' I_1).
It depends on the state only, hence it is continuous at the fault and at the clearing (v2' is not):
the right limit given at the events equals the left limit.
Fault time constant R_fault C = 14 us: DOP853 takes steps of some 5 us; Radau is the cross-check (minutes).
"""

import numpy as np
from machine_reference import MachineReference
from reference_tools import RTOL, RTOL_CHECK, agreement, describe, grid, integrate, load, names, write

W = 2.0 * np.pi * 60.0
TIMES = grid(0.0, 0.02, 0.05, 0.1, 0.101, 0.11, 0.15, 0.2, 0.201, 0.21, 0.25, 0.3, 0.4, 0.5, 1.0)
TIMES_EARLY = grid(0.0, 0.01, 0.02, 0.025, 0.03, 0.04, 0.06, 0.065, 0.08, 0.1)
COLUMNS = (
    names("I1", 6)
    + ["p1", "theta1"]
    + names("I2", 6)
    + ["p2", "theta2"]
    + names("v2", 3)
    + names("iL", 3)
    + names("i_line", 3)
    + names("v1", 3)
)
GROUPS = {
    "I1 stator": (slice(0, 3), "relative"),
    "I1 field": (slice(3, 4), "relative"),
    "I1 dampers": (slice(4, 6), "relative"),
    "I2 stator": (slice(8, 11), "relative"),
    "I2 field": (slice(11, 12), "relative"),
    "I2 dampers": (slice(12, 14), "relative"),
    "p1": (slice(6, 7), "relative"),
    "p2": (slice(14, 15), "relative"),
    "theta": ([7, 15], "absolute"),
    "v2": (slice(16, 19), "relative"),
    "iL": (slice(19, 22), "relative"),
    "v1": (slice(25, 28), "relative"),
}
FILES = {"two_machine": (TIMES, None), "two_machine_early": (TIMES_EARLY, (0.02, 0.06))}


def solve(times, events=None, rtol=RTOL, **options):
    """Return the published table; events = (t_on, t_off) of the fault, by default those of the scene."""
    scene = load("scenes")["two_machine"]
    line, loads, inputs, start = (scene[k] for k in ("line", "load", "inputs", "initial"))
    m1 = MachineReference(scene["machine1"], scene["machine1"]["d"], line["R"], line["L"])
    m2 = MachineReference(scene["machine2"], scene["machine2"]["d"])

    def evaluate(t, y):
        v2 = y[16:19]
        one = m1.rhs(y[:6], m1.J * W + y[6], W * t + y[7], v2, inputs["Vf1"], inputs["tau1"])
        two = m2.rhs(y[8:14], m2.J * W + y[14], W * t + y[15], v2, inputs["Vf2"], inputs["tau2"])
        return one, two

    def piece(conductance):
        def rhs(t, y):
            (psi1, p1, _, I1), (psi2, p2, _, I2) = evaluate(t, y)
            v2, iL = y[16:19], y[19:22]
            v2_dot = (-I1[:3] - I2[:3] - iL - conductance * v2) / loads["C"]
            return np.concatenate([psi1, [p1, y[6] / m1.J], psi2, [p2, y[14] / m2.J], v2_dot, v2 / loads["L"]])

        return rhs

    psi1, psi2 = m1.fluxes(start["I1"], start["theta1"]), m2.fluxes(start["I2"], start["theta2"])
    y0 = np.concatenate(
        [
            psi1,
            [start["p1"] - m1.J * W, start["theta1"]],
            psi2,
            [start["p2"] - m2.J * W, start["theta2"]],
            start["v2"],
            start["iL"],
        ]
    )
    scale = np.concatenate(
        [[50.0] * 3, np.abs(psi1[3:]), [m1.J, 1.0], [50.0] * 3, np.abs(psi2[3:]), [m2.J, 1.0], [2e4] * 3, [5e3] * 3]
    )
    on, off = events or (scene["fault"]["t_on"], scene["fault"]["t_off"])
    healthy, faulted = piece(1.0 / loads["R"]), piece(1.0 / loads["R"] + 1.0 / scene["fault"]["R"])
    pieces = ((on, healthy), (off, faulted), (np.inf, healthy))
    rows = []
    for t, y in zip(times, integrate(pieces, y0, times, scale, rtol, **options), strict=False):
        (psi1, _, w1, I1), (_, _, w2, I2) = evaluate(t, y)
        theta1, theta2 = W * t + y[7], W * t + y[15]
        rate = m1.current_rate(psi1, w1, theta1, I1)
        v1 = m1.node_voltage(y[16:19], I1[:3], rate[:3])
        rows.append(np.concatenate([I1, [m1.J * w1, theta1], I2, [m2.J * w2, theta2], y[16:19], y[19:22], -I1[:3], v1]))
    return np.array(rows)


def make(name):
    """Write <name>.csv; return (path, errors)."""
    times, events = FILES[name]
    table = solve(times, events)
    errors = agreement(table, solve(times, events, RTOL_CHECK), GROUPS)
    radau = agreement(table, solve(times, events, RTOL_CHECK, method="Radau"), GROUPS)
    comments = [
        f"accuracy: DOP853 rtol {RTOL:g} against Radau rtol {RTOL_CHECK:g} over all rows: {describe(radau, GROUPS)}; "
        f"against DOP853 rtol {RTOL_CHECK:g}: {describe(errors, GROUPS)}",
        f"{name}: fault on [{events[0] if events else 0.1}, {events[1] if events else 0.2}); I = a b c f kd kq in A "
        "(motor sign), p in kg m2 rad/s, theta in rad (not wrapped), v1 v2 in V, iL load inductor, i_line bus 1 -> 2 "
        "= -I1[1..3]; v1 is the right limit at the events; tests/reference/two_machine_reference.py",
    ]
    errors.update({f"{key} (Radau)": value for key, value in radau.items()})
    return write(name, comments, COLUMNS, times, table), errors
