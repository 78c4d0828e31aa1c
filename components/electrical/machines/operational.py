"""Windings of a machine whose parameters are reactances and time constants, in the definitions of the grid models.

The inductances and resistances of the circuit are expressions of them (`branches`, `referred`), so that derivatives and fits
of runs are by reactances and time constants.  Turns of the dampers are those of the set; the field's follow from M_f, the peak
mutual inductance with a phase, which no-load field current and rated voltage tell: M_f = sqrt(2/3) Vn/(omega i_f).

Source: Kundur, Power System Stability and Control, 1994, chapter 4; IEEE Std 115.
"""

from __future__ import annotations

import casadi as ca
import numpy as np

from phfmu import Variable, parameter
from phfmu.components.electrical.machines.machine_data import MachineData, MachineDataError
from phfmu.components.electrical.machines.machine_per_unit import (
    EquivalentCircuit,
    branches,
    orders,
    reactances,
    referred,
)
from phfmu.components.electrical.machines.park import Inductances, Windings, inductances, rotor_pairs

#: largest relative difference between the inductances of a set and those that its reactances and time constants give
SAME = 1e-9
STAGE = {1: "transient", 2: "subtransient"}


def operational_windings(data: MachineData, line: Variable | None = None) -> Windings:
    """Parameters ra, xl, x0, xd, xd1, .., xq, .. [1, per unit], Td10, .. [s] and M_f [H] with the values of `data`.

    MachineDataError for a set that they do not describe: without leakage Ll, with more than two windings on an axis, with a
    winding without resistance, or with windings of an axis that are coupled by more than one main flux.
    """
    _require_described(data)
    values = reactances(data) | {"xl": (data.Ll or 0.0) * data.omega / (data.Vn_rms_ll**2 / data.Sn)}
    found = {"ra": parameter("ra", values["ra"], unit="1", min=0.0, description="stator resistance in per unit")}
    found |= {n: _positive(n, values[n], text) for n, text in (("xl", "leakage"), ("x0", "zero-sequence"))}
    windings = {}
    for axis in "dq":
        found[f"x{axis}"] = _positive(f"x{axis}", values[f"x{axis}"], f"synchronous, {axis} axis")
        names = [(f"x{axis}{o}", f"T{axis}{o}0", STAGE[o]) for o in orders(data, axis)]
        for x, T, stage in names:
            found[x] = _positive(x, values[x], f"{stage}, {axis} axis")
            text = f"{stage} open-circuit time constant, {axis} axis"
            found[T] = parameter(T, values[T], unit="s", positive=True, description=text)
        windings[axis] = [(found[x].sx, found[T].sx) for x, T, _ in names]
    M_f = parameter(
        "M_f", data.M_stator_rotor[0], unit="H", description="peak mutual inductance of a phase with the field"
    )
    Z, p = data.Vn_rms_ll**2 / data.Sn, {n: v.sx for n, v in found.items()}
    Lb = Z / data.omega
    c = EquivalentCircuit(
        p["ra"], p["xl"], p["x0"], p["xd"] - p["xl"], p["xq"] - p["xl"],
        *(branches(p["xl"], p[f"x{axis}"], windings[axis], data.omega) for axis in "dq"),
    )  # fmt: skip
    k = [c.xad * Lb / M_f.sx, *_turns(data)[1:]]
    rotor = referred(c, k, Z, data.omega)
    L, iron = inductances(
        data, line, Ld=p["xd"] * Lb, Lq=p["xq"] * Lb, L0=p["x0"] * Lb, M=tuple(ca.SX(m) for m in rotor.M),
        rotor={(i, j): ca.SX(rotor.L[i][j]) for i, j in rotor_pairs(data)}, leakage=p["xl"] * Lb,
    )  # fmt: skip
    parameters = (*found.values(), M_f)
    _require_same(data, L, rotor.R, parameters)
    series = () if line is None else (line,)
    return Windings(p["ra"] * Z, tuple(ca.SX(r) for r in rotor.R), L, (*parameters, *series, *iron))


def _positive(name: str, value: float, text: str) -> Variable:
    return parameter(name, value, unit="1", positive=True, description=f"{text} reactance in per unit")


def _turns(data: MachineData) -> list[float]:
    """Turns of each rotor winding in those of a phase."""
    main = {"d": data.Ld - (data.Ll or 0.0), "q": data.Lq - (data.Ll or 0.0)}
    return [main[axis] / m for axis, m in zip(data.axis, data.M_stator_rotor, strict=True)]


def _require_described(data: MachineData) -> None:
    entry, wrong = f"machine '{data.name}'", ""
    if data.Ll is None:
        wrong = "has no leakage Ll, from which its main flux is told"
    elif many := [axis for axis in "dq" if len(data.on_axis(axis)) > 2]:
        wrong = (
            f"has {len(data.on_axis(many[0]))} windings on {many[0]}; reactances and time constants are of two at most"
        )
    elif without := [n for n, r in zip(data.windings, data.R_rotor, strict=True) if not r]:
        wrong = f"has a winding {without[0]} without resistance, whose time constant is infinite"
    elif uncoupled := [n for n, m in zip(data.windings, data.M_stator_rotor, strict=True) if not m]:
        wrong = f"has a winding {uncoupled[0]} that no flux couples with the stator"
    if wrong:
        raise MachineDataError(entry, wrong, "take parameters='circuit'")


def _require_same(data: MachineData, L: Inductances, R: list[ca.SX], parameters: tuple[Variable, ...]) -> None:
    """MachineDataError where the circuit of the reactances and time constants is another one than that of the set."""
    pairs = list(L.rotor)
    given = [data.Ld, data.Lq, data.L0, *data.M_stator_rotor, *data.R_rotor, *(data.L_rotor[i][j] for i, j in pairs)]
    made = ca.vertcat(L.Ld, L.Lq, L.L0, *L.M, *R, *(L.rotor[ij] for ij in pairs))
    at = ca.Function("at", [v.sx for v in parameters], [made])
    found = np.array(at(*(v.start[0] for v in parameters))).ravel()
    off = np.abs(found - given) / np.abs(given)
    if off.max() > SAME:
        names = [
            "Ld",
            "Lq",
            "L0",
            *(f"{kind}_{n}" for kind in "MR" for n in data.windings),
            *(f"L_rotor{ij}" for ij in pairs),
        ]
        i = int(off.argmax())
        raise MachineDataError(
            f"machine '{data.name}'",
            f"has {names[i]} = {given[i]:.6g}, but one main flux an axis with its reactances gives {found[i]:.6g}",
            "take parameters='circuit'",
        )
