"""DPsim as a peer: networks in the form that a process of its own runs."""

from __future__ import annotations

import json
import subprocess
import sys
from importlib.util import find_spec
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from phfmu.studies.bench.power import circuit

Array = NDArray[np.float64]
RUN = Path(__file__).with_name("dpsim_run.py")
FULL, FOURTH = "SynchronGeneratorDQTrapez", "SynchronGenerator4OrderVBR"


def obstacle() -> str:
    """Why DPsim cannot be used, with the remedy; empty if it can."""
    return "" if find_spec("dpsimpy") else 'not installed; pip install "phfmu[peers-grid]"'


def run(net: dict[str, Any], h: float, *, log: bool, every: float = 1e-3) -> dict[str, Any]:
    """One run; with `log` the rows of each machine's currents and speed at multiples of `every` [s]; RuntimeError if it ends."""
    given = net | {"h": h, "log": log, "every": round(every / h)}
    done = subprocess.run(
        [sys.executable, str(RUN)], input=json.dumps(given), capture_output=True, text=True, timeout=300
    )
    found = [line for line in done.stdout.splitlines() if line.startswith("JSON")]
    if not found:
        raise RuntimeError((done.stderr.strip().splitlines() or [f"exit status {done.returncode}"])[-1])
    return json.loads(found[0][4:])


def smib(model: str, t_clear: float) -> dict[str, Any]:
    """The circuit of one machine."""
    p, flow = circuit.PU, circuit.power_flow()
    current = abs(flow.power / circuit.SN) / (abs(flow.machine) / circuit.VN)
    peak = float(np.sqrt(2 / 3))
    windings = {k: v for k, v in p.items() if k != "H"}
    fundamental = windings | {
        "nom_power": circuit.SN, "nom_volt": circuit.VN, "nom_freq": circuit.FREQUENCY, "pole_number": 2, "nom_field_cur": 1300,
        "inertia": p["H"], "init_active_power": flow.power.real, "init_reactive_power": flow.power.imag,
        "init_terminal_volt": abs(flow.machine) * peak, "init_volt_angle": float(np.angle(flow.machine)),
        # the copper loss of the stator added, so that the start is steady
        "init_mech_power": flow.power.real + p["Rs"] * current**2 * circuit.SN,
    }  # fmt: skip
    machine = {
        "name": "gen", "bus": "n1", "Sn": circuit.SN, "Vn": circuit.VN, "P": circuit.P, "V": circuit.V1,
        "fundamental": fundamental, "operational": _base(circuit.SN, circuit.VN, p["H"]) | operational(),
    }  # fmt: skip
    line = {"a": "n1", "b": "n2", "R": circuit.R_LINE, "L": circuit.L_LINE, "C": circuit.C_LINE, "G": circuit.G_LINE}
    return {
        "f": circuit.FREQUENCY, "buses": {"n1": circuit.VN, "n2": circuit.VN}, "machines": [machine], "lines": [line],
        "grid": {"bus": "n2", "V": circuit.VN}, "model": model, "stop": circuit.STOP,
        "fault": {"bus": "n1", "R": circuit.R_FAULT, "on": circuit.T_FAULT, "off": t_clear},
    }  # fmt: skip


def operational() -> dict[str, float]:
    """Reactances and time constants of the machine by the classical formulas, for the model of order 4."""
    p = circuit.PU
    Ld_t = p["Ll"] + 1 / (1 / p["Lmd"] + 1 / p["Llfd"])
    Lq_t = p["Ll"] + 1 / (1 / p["Lmq"] + 1 / p["Llkq1"])
    return {
        "Ld": p["Ll"] + p["Lmd"], "Lq": p["Ll"] + p["Lmq"], "L0": p["Ll"], "Ld_t": Ld_t, "Lq_t": Lq_t,
        "Td0_t": (p["Lmd"] + p["Llfd"]) / p["Rfd"] / circuit.W, "Tq0_t": (p["Lmq"] + p["Llkq1"]) / p["Rkq1"] / circuit.W,
    }  # fmt: skip


def _base(Sn: float, Vn: float, H: float) -> dict[str, float]:
    return {"nom_power": Sn, "nom_voltage": Vn, "nom_frequency": 60.0, "H": H}


def nine_buses(t_clear: float, stop: float) -> dict[str, Any]:
    """The nine buses with machines of order 4, fault of 1 ohm at bus 7 from 0.1 s on."""
    from phfmu.components.scenes.electrical.wscc9 import BASE, FREQUENCY, LINES, LOADS, MACHINES, PLANTS, VOLTAGE

    w, Z = 2 * np.pi * FREQUENCY, VOLTAGE**2 / BASE
    buses = {b: VOLTAGE for b in "456789"} | {k: rated for k, (_, _, rated, _, _) in PLANTS.items()}
    machines, transformers = [], []
    for k, (bus, x, rated, share, P) in PLANTS.items():
        m = MACHINES[k]
        # the second winding in q of the model is the damper of the data
        data = {
            "Ld": m["xd"], "Lq": m["xq"], "L0": m["xl"], "Ld_t": m["xd1"], "Lq_t": m["xq2"], "Td0_t": m["Td10"],
            "Tq0_t": m["Tq20"],
        }  # fmt: skip
        machines.append({
            "name": f"gen{k}", "bus": k, "Sn": BASE, "Vn": rated, "P": P or 71.641e6, "V": share * rated, "slack": not P,
            "operational": _base(BASE, rated, m["H"]) | data,
        })  # fmt: skip
        transformers.append({"a": bus, "b": k, "Va": VOLTAGE, "Vb": rated, "Sn": BASE, "L": x * Z / w})
    lines = [
        {"a": n[4], "b": n[5], "R": r * Z, "L": x * Z / w, "C": b / Z / w, "G": 1e-9} for n, (r, x, b) in LINES.items()
    ]
    return {
        "f": FREQUENCY, "buses": buses, "machines": machines, "lines": lines, "transformers": transformers,
        "loads": [{"bus": b, "P": p, "Q": q} for b, (p, q) in LOADS.items()], "model": FOURTH, "stop": stop,
        "fault": {"bus": "7", "R": 1.0, "on": 0.1, "off": t_clear},
    }  # fmt: skip
