"""One machine at an infinite bus behind a series line (scenes `smib`, `smib_hydro` of scenes.json).

    infinite bus   v_x = amp cos(w t + phase - alpha_x),   alpha = (0, 2 pi/3, -2 pi/3)
    line           v_x - v = Rx I_x + Lx I_x'              (line current = stator current, into the machine)
    machine        machine_reference.py with (Rx, Lx) lumped in; V_f constant
    torque         tau = tau0 for t < 0.5 s, tau1 = 1.1 tau0 from then on

Integrated variables: y = (total flux psi [6], p - J w, theta - w t), so that the small deviations from
synchronous rotation are not lost in the rounding of p and theta.
Published: I[1..6] (a b c f kd kq), p, theta (never wrapped) and the machine's terminal voltage
v = v_x - Rx I - Lx I', I' = L^-1 (psi' - omega L' I). All of them are continuous at the torque step.

Check (solve_park): the same circuit in the rotor frame, where the steady state is a fixed point and no 60 Hz
oscillation has to be integrated. With T = (orthonormal Park, rows d q 0) and Lhat = T L T^T constant,

    psi_d' = v_d - R i_d + omega psi_q,   psi_q' = v_q - R i_q - omega psi_d,   torque = psi_d i_q - psi_q i_d
    (v_d, v_q) = sqrt(3/2) amp (cos, sin)(phase - delta),   delta = theta - w t,   v_0 = 0
"""

import numpy as np
from machine_reference import ALPHA, MachineReference
from reference_tools import RTOL, RTOL_CHECK, agreement, describe, grid, integrate, load, names, write

TIMES = grid((0.0, 0.5, 0.05), 0.505, 0.51, (0.55, 1.0, 0.05), (2.0, 5.0, 1.0))
COLUMNS = names("I", 6) + ["p", "theta"] + names("v", 3)
GROUPS = {
    "stator currents": (slice(0, 3), "relative"),
    "field current": (slice(3, 4), "relative"),
    "damper currents": (slice(4, 6), "relative"),
    "p": (slice(6, 7), "relative"),
    "theta": (slice(7, 8), "absolute"),
    "v": (slice(8, 11), "relative"),
}


def solve(name, rtol=RTOL, times=TIMES, **options):
    """Return the published table (rows: times; columns: COLUMNS) of scene `name`."""
    scene, machines = load("scenes")[name], load("machines")
    machine = MachineReference(machines[scene["machine"]], scene["d"], scene["Rx"], scene["Lx"])
    bus, inputs, initial = scene["infinite_bus"], scene["inputs"], scene["initial"]
    w = bus["w"]

    def bus_voltage(t):
        return bus["amp"] * np.cos(w * t + bus["phase"] - ALPHA)

    def evaluate(t, y, tau):
        p, theta = machine.J * w + y[6], w * t + y[7]
        return machine.rhs(y[:6], p, theta, bus_voltage(t), inputs["Vf"], tau) + (theta,)

    def piece(tau):
        def rhs(t, y):
            psi_dot, p_dot, omega, _, _ = evaluate(t, y, tau)
            return np.concatenate([psi_dot, [p_dot, y[6] / machine.J]])

        return rhs

    psi0 = machine.fluxes(initial["I"], initial["theta"])
    y0 = np.concatenate([psi0, [initial["p"] - machine.J * w, initial["theta"]]])
    scale = np.concatenate([[50.0] * 3, np.abs(psi0[3:]), [machine.J], [1.0]])
    pieces = ((scene["torque_step_at"], piece(inputs["tau0"])), (np.inf, piece(inputs["tau1"])))
    rows = []
    for t, y in zip(times, integrate(pieces, y0, times, scale, rtol, **options), strict=False):
        psi_dot, _, omega, I, theta = evaluate(t, y, 0.0)
        rate = machine.current_rate(psi_dot, omega, theta, I)
        v = machine.node_voltage(bus_voltage(t), I[:3], rate[:3])
        rows.append(np.concatenate([I, [machine.J * omega, theta], v]))
    return np.array(rows)


def park(theta):
    """Return the orthonormal Park matrix, rows d q 0, columns a b c."""
    angle = theta - ALPHA
    return np.sqrt(2.0 / 3.0) * np.array([np.cos(angle), -np.sin(angle), [np.sqrt(0.5)] * 3])


def solve_park(name, rtol=RTOL, times=TIMES, **options):
    """Return I, p, theta (the first eight of COLUMNS) from the rotor-frame equations."""
    scene = load("scenes")[name]
    data, bus, inputs, initial = (
        load("machines")[scene["machine"]],
        scene["infinite_bus"],
        scene["inputs"],
        scene["initial"],
    )
    w, J, d = bus["w"], data["J"], scene["d"]
    mean, zero, swing = data["Laa0"] + data["Lab0"], data["Laa0"] - 2.0 * data["Lab0"], 1.5 * data["Laa2"]
    Lhat = np.zeros((6, 6))
    Lhat[:3, :3] = np.diag([mean + swing, mean - swing, zero]) + scene["Lx"] * np.eye(3)
    Lhat[3:, 3:] = data["L_rotor"]
    for k, (axis, M) in enumerate(zip(data["axis"], data["M_stator_rotor"], strict=False)):
        row = "dq".index(axis)
        Lhat[row, 3 + k] = Lhat[3 + k, row] = np.sqrt(1.5) * M
    R = np.array([data["Ra"] + scene["Rx"]] * 3 + data["R_rotor"])
    inverse = np.linalg.inv(Lhat)

    def piece(tau):
        def rhs(t, y):
            I, omega, angle = inverse @ y[:6], w + y[6] / J, bus["phase"] - y[7]
            rate = -R * I
            rate[0] += np.sqrt(1.5) * bus["amp"] * np.cos(angle) + omega * y[1]
            rate[1] += np.sqrt(1.5) * bus["amp"] * np.sin(angle) - omega * y[0]
            rate[3] += inputs["Vf"]
            return np.concatenate([rate, [tau - d * omega + y[0] * I[1] - y[1] * I[0], y[6] / J]])

        return rhs

    I0 = np.concatenate([park(initial["theta"]) @ initial["I"][:3], initial["I"][3:]])
    y0 = np.concatenate([Lhat @ I0, [initial["p"] - J * w, initial["theta"]]])
    scale = np.concatenate([[50.0] * 3, np.abs(y0[3:6]), [J, 1.0]])
    pieces = ((scene["torque_step_at"], piece(inputs["tau0"])), (np.inf, piece(inputs["tau1"])))
    rows = []
    for t, y in zip(times, integrate(pieces, y0, times, scale, rtol, **options), strict=False):
        I, theta = inverse @ y[:6], w * t + y[7]
        rows.append(np.concatenate([park(theta).T @ I[:3], I[3:], [J * w + y[6], theta]]))
    return np.array(rows)


def make(name):
    """Write <name>.csv; return (path, errors)."""
    table = solve(name)
    errors = agreement(table, solve(name, RTOL_CHECK), GROUPS)
    frame = {key: GROUPS[key] for key in list(GROUPS)[:5]}
    other = agreement(table, solve_park(name, max_step=1e-3), frame)
    comments = [
        f"accuracy: DOP853 rtol {RTOL:g} against the rotor-frame equations over all rows: {describe(other, frame)}; "
        f"against rtol {RTOL_CHECK:g}: {describe(errors, GROUPS)}",
        f"{name}: I = a b c f kd kq in A (motor sign), p in kg m2 rad/s, theta in rad (not wrapped), "
        "v = terminal voltage of the machine in V; tests/reference/smib_reference.py",
    ]
    errors.update({f"{key} (rotor frame)": value for key, value in other.items()})
    return write(name, comments, COLUMNS, TIMES, table), errors
