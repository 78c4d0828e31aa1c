"""Table of contents: name -> (kind, where, one line).  Nothing is imported before it is asked for."""

from __future__ import annotations

from collections.abc import Callable
from importlib import import_module
from typing import Any

from phfmu import meant

_E, _M, _S = "phfmu.components.electrical.", "phfmu.components.mechanical.", "phfmu.components.scenes."
_SE, _SM = _S + "electrical.", _S + "mechanical."
_C, _B = "phfmu.components.control.", "phfmu.components.mechanical.mechanisms."

LIBRARY: dict[str, tuple[str, str, str]] = {
    "synchronous_machine": (
        "component",
        _E + "machines.synchronous_machine",
        "field and damper windings, abc terminals",
    ),
    "machine_at_bus": (
        "component",
        _E + "machines.synchronous_machine",
        "machine with its line folded in: no bare node",
    ),
    "induction_machine": (
        "component",
        _E + "machines.induction_machine",
        "squirrel-cage machine with any number of cages",
    ),
    "rl_line": ("component", _E + "rl_line", "three-phase series line"),
    "infinite_bus": ("component", _E + "infinite_bus", "stiff three-phase grid"),
    "rlc_load": ("component", _E + "rlc_load", "three-phase parallel R, L, C to ground"),
    "coupled_line": ("component", _E + "network.lines", "mutually coupled series line of sequence data"),
    "pi_line": ("component", _E + "network.lines", "line with charging at its ends, of sequence data"),
    "series_compensated_line": ("component", _E + "network.lines", "line with series capacitors, of sequence data"),
    "two_winding_transformer": (
        "component",
        _E + "network.transformers",
        "three-phase transformer: vector group, leakage, tap, core",
    ),
    "load": ("component", _E + "network.loads", "constant impedance of given P and Q, parallel or series"),
    "shunt": ("component", _E + "network.loads", "reactor or capacitor of given Q"),
    "capacitor_bank": ("component", _E + "network.loads", "capacitors of given Q, detuned or not"),
    "rlc_branch": ("component", _E + "network.loads", "three-phase series R, L, C to ground"),
    "saturating_reactor": ("component", _E + "network.saturation", "reactor of a measured magnetisation curve"),
    "thevenin_source": ("component", _E + "network.thevenin", "grid of given short-circuit power"),
    "fault": ("component", _E + "network.shunts", "fault of any kind, switched by events: feedthrough"),
    "surge_arrester": ("component", _E + "network.shunts", "resistor of a power law to ground: feedthrough"),
    "constant_power_load": ("component", _E + "network.shunts", "three-phase load of constant power: feedthrough"),
    "grid_following_inverter": (
        "component",
        _E + "network.inverter",
        "current source with a phase-locked loop and a limit: not passive",
    ),
    "fault_resistor": ("component", _E + "switch", "three-phase shunt conductance, switched by events"),
    "field_source": ("component", _E + "field_source", "voltage set by a signal"),
    "breaker": ("component", _E + "breaker", "series R-L line whose poles open at their current zeros"),
    "clearing_fault": ("component", _E + "breaker", "fault to ground that clears at the zeros of its currents"),
    "ideal_diode": ("component", _E + "breaker", "ideal diode in series with R and L"),
    "diode": ("component", _E + "switches", "ideal diode between two nodes"),
    "thyristor": ("component", _E + "switches", "ideal thyristor with a gate"),
    "ideal_switch": ("component", _E + "switches", "ideal switch between two nodes"),
    "chopper": ("component", _E + "switches", "ideal switch, pulse-width modulated by a duty"),
    "rectifier_bridge": ("component", _E + "rectifiers", "bridge of four ideal diodes"),
    "six_pulse_bridge": ("component", _E + "rectifiers", "three-phase bridge of six ideal diodes"),
    "rl_branch": ("component", _E + "branches", "inductance and resistance, with a source or not"),
    "rl_link": ("component", _E + "branches", "inductance and resistance between two nodes"),
    "rc_node": ("component", _E + "branches", "capacitor and resistor to ground"),
    "resistor": ("component", _E + "resistor", "resistor to ground: feedthrough, no state"),
    "transformer": ("component", _E + "resistor", "ideal transformer: feedthrough, no state"),
    "dc_motor": ("component", _E + "machines.dc_motor", "permanent-magnet DC motor"),
    "four_particle": ("component", _M + "four_particle", "four particles, two bars, two springs, a damper"),
    "mass_spring": ("component", _M + "mass_spring", "two masses, two springs, singular mass matrix reduced"),
    "chain": ("component", _M + "chain", "ten rigid links that hang from a support"),
    "net": ("component", _M + "net", "sheet of masses and springs, hung at two corners"),
    "pendulum": ("component", _B + "pendulum", "point mass on a bar, from the horizontal"),
    "four_bar": ("component", _M + "four_bar", "two four-bar windows, through flat positions"),
    "andrews": ("component", _B + "andrews", "squeezer: seven bodies, three loops, a motor"),
    "bricard": ("component", _B + "bricard", "five rods, six hinges, one equation too many"),
    "flyball": ("component", _B + "flyball", "governor with stiff springs and dampers"),
    "slider_crank": ("component", _B + "slider_crank", "crank, rod and piston with motor ports"),
    "ur5": ("component", _B + "ur5", "robot arm: six links, six motor ports"),
    "car_axis": ("component", _B + "car_axis", "two bodies on stiff springs over a wavy road"),
    "rope_bridge": ("component", _B + "rope_bridge", "planks between two ropes"),
    "gear_train": ("component", _B + "gear_train", "wheels in mesh and a rack that lift a load"),
    "box_on_floor": (
        "component",
        _B + "box_on_floor",
        "box thrown onto the floor: impacts of its corners, until it rests",
    ),
    "heavy_top": ("component", _M + "heavy_top", "spinning disc on a stem, singular mass matrix"),
    "mass": ("component", _M + "translational", "mass with optional spring and damper to ground"),
    "spring": ("component", _M + "translational", "linear spring between two flanges"),
    "damper": ("component", _M + "translational", "linear damper between two flanges"),
    "end_stop": ("component", _M + "contacts", "hard stop between two flanges"),
    "bumper": ("component", _M + "contacts", "body with a bumper before a wall: restitution, rest, release"),
    "impact_pair": (
        "component",
        _M + "contacts",
        "two bodies that throw each other back: restitution, one body, release",
    ),
    "rotational_inertia": ("component", _M + "rotational", "rotor with viscous friction"),
    "flexible_shaft": ("component", _M + "rotational", "torsional spring with damping"),
    "clutch": ("component", _M + "clutch", "ideal clutch between two shaft ends"),
    "gas_cylinder": ("component", _M + "gas_cylinder", "ideal gas above a piston, with a hot and a cold wall"),
    "torque_source": ("component", _M + "torque_source", "torque set by a signal"),
    "pi_controller": ("component", _C + "pi_controller", "proportional and integral control: signals, no power"),
    "sexs": ("component", _C + "exciters", "simplified excitation system SEXS"),
    "exac1": ("component", _C + "exciters", "AC exciter EXAC1 (AC1A)"),
    "ieeex1": ("component", _C + "exciters", "DC exciter IEEEX1 (DC1A)"),
    "st1a": ("component", _C + "exciters", "static exciter ST1A"),
    "tgov1": ("component", _C + "governors", "steam turbine and governor TGOV1"),
    "hygov": ("component", _C + "governors", "hydro turbine and governor HYGOV"),
    "gast": ("component", _C + "governors", "gas turbine and governor GAST"),
    "pss1a": ("component", _C + "stabilisers", "stabiliser PSS1A"),
    "ieeest": ("component", _C + "stabilisers", "stabiliser IEEEST"),
    "meter": ("component", _C + "meter", "measures voltage, frequency and powers through a lag"),
    "relay": ("component", _C + "relay", "relay with hysteresis: signals, no power"),
    "bouncing_ball": ("scene", _SM + "bouncing_ball", "ball on a hard floor: impacts with restitution, until it rests"),
    "buffer": ("scene", _SM + "stops", "body on a spring with a bumper: impacts, rest, release"),
    "hard_stop": ("scene", _SM + "stops", "a wagon runs onto another, pushes it, lets it go"),
    "clutch_engagement": ("scene", _SM + "clutch_engagement", "two rotors, joined by a clutch and parted again"),
    "two_point_control": ("scene", _SM + "two_point_control", "rotor that a relay keeps between two speeds"),
    "breaker_opening": ("scene", _SE + "breaker_opening", "grid, breaker, load: opened at its current zeros"),
    "short_circuit": ("scene", _SE + "network_events", "fault of any kind at the end of a feeder"),
    "weak_grid": ("scene", _SE + "network_events", "inverter in a weak grid: fault, limit of the current"),
    "inrush": ("scene", _SE + "network_events", "a transformer is energised: its iron saturates"),
    "ferroresonance": ("scene", _SE + "network_events", "a capacitor in series with saturating iron"),
    "rectifier": ("scene", _SE + "rectifier", "single-phase diode bridge with overlap"),
    "six_pulse": ("scene", _SE + "rectifier", "three-phase diode bridge with overlap"),
    "buck": ("scene", _SE + "buck", "step-down converter: chopper, diode, filter; duty step"),
    "bead": ("scene", _SM + "bead", "bead on a cylinder that it leaves where its force is zero"),
    "oscillator": ("scene", _SM + "oscillator", "two masses and three springs, cut in three"),
    "drive": ("scene", _S + "drive", "DC motor, flexible shaft and load inertia"),
    "robot_arm": ("scene", _SM + "robot_arm", "robot arm UR5 that its motors carry, move and stop"),
    "panda": ("scene", _SM + "panda", "robot arm Panda of seven joints, carried, moved and stopped"),
    "speed_control": ("scene", _SM + "speed_control", "rotor with PI speed control by signals, load step"),
    "smib": ("scene", _SE + "smib", "turbo generator at an infinite bus, torque step"),
    "smib_hydro": ("scene", _SE + "smib", "hydro generator at an infinite bus, torque step"),
    "smib_folded": ("scene", _SE + "smib", "smib with the line folded into the machine: full order"),
    "smib_breaker": ("scene", _SE + "smib", "turbo generator, two lines: fault, line opened at its current zeros"),
    "spin_down": ("scene", _SE + "single_machine", "generator without torque brakes on a resistor"),
    "stall_start": ("scene", _SE + "single_machine", "synchronous machine starts from standstill by its dampers"),
    "lossless": ("scene", _SE + "single_machine", "machine without resistance at capacitors: no joule leaves"),
    "motor_start": ("scene", _SE + "motor_start", "induction motor across a line, from rest, then loaded"),
    "ladder": ("scene", _SE + "ladder", "two machines with loads along a line, torque step"),
    "engine": ("scene", _S + "engine", "piston engine with gas, flywheel, shaft, machine, line; load thrown off"),
    "island": ("scene", _SE + "island", "turbine, governor, exciter, stabiliser, machine, line; load step"),
    "smib_exciter": ("scene", _SE + "island", "machine with exciter and governor; fault until the exciter's limit"),
    "wscc9": ("scene", _SE + "wscc9", "nine buses, three machines, from the operating point; three-phase fault"),
    "wscc9_steady": ("scene", _SE + "wscc9", "nine buses, three machines, in steady state"),
    "two_machine": ("scene", _SE + "two_machine", "two machines, line, load, three-phase fault"),
}

#: Scenes of large grids, which what is done with all of the library leaves out.
GRIDS: dict[str, tuple[str, str, str]] = {
    "wscc9_trip": ("scene", _SE + "wscc9", "nine buses: three-phase fault, line 5-7 opened at its current zeros"),
    "ieee39": ("scene", _SE + "grids", "39 buses, ten machines: three-phase fault, lines that trip"),
    "new_england": ("scene", _SE + "grids", "39 buses of New England, two-axis machines: three-phase fault"),
    "wecc240": ("scene", _SE + "grids", "243 buses, 111 machines, 91 plants: three-phase fault"),
    "grid": ("scene", _SE + "grids", "generated grid of any size: three-phase fault"),
}
TABLE = LIBRARY | GRIDS

#: Arguments of components without defaults, or other than these, so that each can be inspected and stepped by name.
EXAMPLES: dict[str, dict[str, Any]] = {
    "rl_line": {"R": 0.02, "L": 8e-4},
    "infinite_bus": {"amplitude": 18.7e3},
    "meter": {"Vn": 24e3},
    "breaker": {"R": 0.5, "L": 0.01},
    "chopper": {"f": 1e3},
    "rl_branch": {"R": 0.5, "L": 0.01},
    "rl_link": {"R": 0.5, "L": 0.01},
    "rc_node": {"R": 10.0, "C": 1e-4},
    "clearing_fault": {"R": 0.05, "L": 5e-5, "there": True},
    "ideal_diode": {"R": 0.5, "L": 0.01, "conducts": True},
    "coupled_line": {"R": 0.5, "L": 0.01, "R0": 1.5, "L0": 0.03},
    "pi_line": {"R": 0.5, "L": 0.01, "C": 1e-5, "R0": 1.5, "L0": 0.03, "C0": 6e-6},
    "series_compensated_line": {"R": 0.5, "L": 0.01, "C": 2e-3, "R0": 1.5, "L0": 0.03},
    "two_winding_transformer": {
        "Sn": 1e6,
        "Va": 20e3,
        "Vb": 400.0,
        "r": 0.01,
        "x": 0.06,
        "group": "Dyn11",
        "i0": 0.02,
        "p0": 0.005,
    },
    "load": {"P": 1e5, "Q": 3e4, "V": 400.0},
    "shunt": {"Q": 3e4, "V": 400.0},
    "capacitor_bank": {"Q": 3e4, "V": 400.0, "detuning": 0.07},
    "saturating_reactor": {"points": ((1.0, 0.1), (1.2, 1.0), (1.3, 4.0)), "R": 0.1},
    "thevenin_source": {"V": 400.0, "S_sc": 1e6},
    "surge_arrester": {"V": 600.0},
    "grid_following_inverter": {"P": 1e4, "Q": 3e3, "V": 400.0, "S": 2e4},
    "constant_power_load": {"P": 1e4, "Q": 3e3, "V": 400.0},
    "rlc_branch": {"R": 2.0, "L": 0.01, "C": 1e-3},
    "ladder": {"n": 2},
    "net": {"n": 3},
    "rlc_load": {"R": 0.96, "L": 0.0102, "C": 2.76e-4},
}

#: Customary stop and step in seconds of components whose motion 1 s at 1 ms does not suit; scenes have their own.
RUNS: dict[str, tuple[float, float]] = {
    "four_particle": (10.0, 0.01),
    "synchronous_machine": (0.1, 1e-4),
    "pendulum": (10.0, 0.01),
    "four_bar": (20.0, 0.005),
    "andrews": (0.03, 1e-4),
    "bricard": (10.0, 0.01),
    "flyball": (10.0, 0.01),
    "car_axis": (3.0, 1e-3),
    "rope_bridge": (5.0, 0.005),
    "ur5": (1.0, 2e-3),
    "gas_cylinder": (0.1, 1e-3),
    "gear_train": (0.5, 1e-3),
    "box_on_floor": (3.0, 0.002),
}


#: those with switches: stepped by `SwitchedInstance`, in no unit
SWITCHED = (
    *("diode", "thyristor", "ideal_switch", "chopper", "rectifier_bridge", "six_pulse_bridge"),
    *("rectifier", "six_pulse", "buck", "bead"),
    *("end_stop", "clutch", "hard_stop", "clutch_engagement"),
)


def builder(name: str) -> Callable[..., Any]:
    """The function that builds the component or scene `name`; KeyError lists close names."""
    if name not in TABLE:
        there = f"there are: {', '.join(TABLE)}"
        raise KeyError(f"no component or scene '{name}' in the library; {meant(name, TABLE, there)}")
    return getattr(import_module(TABLE[name][1]), name)


def build(name: str, **values: Any) -> Any:
    """The component (PHDAE) or scene (Scene) `name` with `values`, its default or example arguments where there are none."""
    return builder(name)(**(EXAMPLES.get(name, {}) | values))
