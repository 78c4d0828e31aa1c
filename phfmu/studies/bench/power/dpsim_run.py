"""One run of DPsim in a process of its own: a network as JSON on standard input, a line of JSON with its times and rows.

DPsim keeps objects of earlier simulations alive, so that a process takes one run.  Nothing but DPsim is imported.
"""

from __future__ import annotations

import csv
import json
import sys
from pathlib import Path
from tempfile import TemporaryDirectory
from time import process_time
from typing import Any


class DPsimTopologies:
    """Topologies of a network for the power flow (`sp`) and for the run in phases (`emt`)."""

    def __init__(self, dpsim: Any, net: dict[str, Any]):
        self.d, self.net, self.off = dpsim, net, dpsim.LogLevel.off

    def flow(self) -> tuple[Any, dict[str, Any]]:
        d, net, sp = self.d, self.net, self.d.sp.ph1
        nodes = {b: d.sp.SimNode(b, d.PhaseType.Single) for b in net["buses"]}
        parts = []
        for m in net["machines"]:
            kind = d.PowerflowBusType.VD if m.get("slack") else d.PowerflowBusType.PV
            g = sp.SynchronGenerator(m["name"], self.off)
            g.set_parameters(
                rated_apparent_power=m["Sn"], rated_voltage=m["Vn"], set_point_active_power=m["P"], set_point_voltage=m["V"],
                powerflow_bus_type=kind, set_point_reactive_power=m.get("Q", 0.0),
            )  # fmt: skip
            g.set_base_voltage(m["Vn"])
            g.modify_power_flow_bus_type(kind)
            g.connect([nodes[m["bus"]]])
            parts.append(g)
        if "grid" in net:
            s = sp.NetworkInjection("grid", self.off)
            s.set_parameters(net["grid"]["V"])
            s.set_base_voltage(net["grid"]["V"])
            s.modify_power_flow_bus_type(d.PowerflowBusType.VD)
            s.connect([nodes[net["grid"]["bus"]]])
            parts.append(s)
        for n, line in enumerate(net["lines"]):
            made = sp.PiLine(f"line{n}", self.off)
            made.set_parameters(line["R"], line["L"], line["C"], line["G"])
            made.set_base_voltage(net["buses"][line["a"]])
            made.connect([nodes[line["a"]], nodes[line["b"]]])
            parts.append(made)
        for n, t in enumerate(net.get("transformers", [])):
            made = sp.Transformer(f"transformer{n}", self.off)
            made.set_parameters(t["Va"], t["Vb"], t["Va"] / t["Vb"], 0.0, 0.0, t["L"])
            made.set_base_voltage(t["Va"])
            made.connect([nodes[t["a"]], nodes[t["b"]]])
            parts.append(made)
        for n, load in enumerate(net.get("loads", [])):
            made = sp.Load(f"load{n}", self.off)
            made.set_parameters(load["P"], load["Q"], net["buses"][load["bus"]])
            made.modify_power_flow_bus_type(d.PowerflowBusType.PQ)
            made.connect([nodes[load["bus"]]])
            parts.append(made)
        system = d.SystemTopology(int(net["f"]), list(nodes.values()), parts)
        run = d.Simulation("flow", self.off)
        run.set_system(system)
        run.set_time_step(1.0)
        run.set_final_time(2.0)
        run.set_domain(d.Domain.SP)
        run.set_solver(d.Solver.NRP)
        run.set_solver_component_behaviour(d.SolverBehaviour.Initialization)
        run.do_init_from_nodes_and_terminals(False)
        run.run()
        return system, {b: [n.single_voltage().real, n.single_voltage().imag] for b, n in nodes.items()}

    def phases(self) -> tuple[Any, list[Any], Any]:
        """The topology in phases, its machines, the fault."""
        d, net, emt, three = self.d, self.net, self.d.emt.ph3, self.d.Math.single_phase_parameter_to_three_phase
        nodes = {b: d.emt.SimNode(b, d.PhaseType.ABC) for b in net["buses"]}
        machines, parts = [], []
        for m in net["machines"]:
            g = getattr(emt, net["model"])(m["name"], self.off)
            if net["model"] == "SynchronGeneratorDQTrapez":
                g.set_parameters_fundamental_per_unit(**m["fundamental"])
            else:
                g.set_operational_parameters_per_unit(**m["operational"])
            g.connect([nodes[m["bus"]]])
            machines.append(g)
        for n, line in enumerate(net["lines"]):
            made = emt.PiLine(f"line{n}", self.off)
            made.set_parameters(*(three(line[x]) for x in "RLCG"))
            made.connect([nodes[line["a"]], nodes[line["b"]]])
            parts.append(made)
        for n, t in enumerate(net.get("transformers", [])):
            made = emt.Transformer(f"transformer{n}", self.off)
            made.set_parameters(t["Va"], t["Vb"], t["Sn"], t["Va"] / t["Vb"], 0.0, three(0.0), three(t["L"]))
            made.connect([nodes[t["a"]], nodes[t["b"]]])
            parts.append(made)
        power = d.Math.single_phase_power_to_three_phase
        for n, load in enumerate(net.get("loads", [])):
            made = emt.RXLoad(f"load{n}", self.off)
            made.set_parameters(power(load["P"]), power(load["Q"]), net["buses"][load["bus"]])
            made.connect([nodes[load["bus"]]])
            parts.append(made)
        if "grid" in net:
            made = emt.NetworkInjection("grid", self.off)
            made.connect([nodes[net["grid"]["bus"]]])
            parts.append(made)
        fault = emt.Switch("fault", self.off)
        fault.set_parameters(three(1e9), three(net["fault"]["R"]))
        fault.open()
        fault.connect([d.emt.SimNode.gnd, nodes[net["fault"]["bus"]]])
        return d.SystemTopology(int(net["f"]), list(nodes.values()), [*machines, *parts, fault]), machines, fault


def ran(net: dict[str, Any], folder: str) -> dict[str, Any]:
    """CPU time of the run [s], and with `log` the rows of each machine: currents (3) and speed."""
    import dpsimpy as d  # type: ignore[import-not-found]

    d.Logger.set_log_dir(folder)
    built = DPsimTopologies(d, net)
    flow, voltages = built.flow()
    system, machines, fault = built.phases()
    system.init_with_powerflow(flow, d.Domain.EMT)
    run = d.Simulation("run", built.off)
    run.set_system(system)
    run.set_time_step(net["h"])
    run.set_final_time(net["stop"])
    run.set_domain(d.Domain.EMT)
    if net["model"] != "SynchronGeneratorDQTrapez":
        run.do_system_matrix_recomputation(True)
    if net["log"]:
        log = d.Logger("run")
        for n, g in enumerate(machines):
            log.log_attribute(f"i{n}", "i_intf", g)
            log.log_attribute(f"w{n}", "w_r", g)
        run.add_logger(log)
    for t, closed in ((net["fault"]["on"], True), (net["fault"]["off"], False)):
        if t < net["stop"]:
            run.add_event(d.event.SwitchEvent3Ph(t, fault, closed))
    before = process_time()
    run.run()
    out: dict[str, Any] = {"cpu": process_time() - before, "voltages": voltages}
    if net["log"]:
        every = net["every"]
        path = next(p for p in Path(folder).rglob("*.csv") if p.name.startswith("run"))
        with path.open(newline="") as file:
            rows = csv.reader(file)
            head = [c.strip() for c in next(rows)]
            wanted = [head.index(f"i{n}_{k}") for n in range(len(machines)) for k in range(3)]
            wanted += [head.index(f"w{n}") for n in range(len(machines))]
            # row k is t = k h, of the models with a voltage behind reactance t = (k + 1) h
            first = 0 if net["model"] == "SynchronGeneratorDQTrapez" else every - 1
            out["rows"] = [[float(r[c]) for c in wanted] for n, r in enumerate(rows) if n % every == first % every]
    return out


if __name__ == "__main__":
    with TemporaryDirectory() as where:
        print("JSON" + json.dumps(ran(json.load(sys.stdin), where)))
