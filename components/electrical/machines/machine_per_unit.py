"""Synchronous machines from the data that books and grid files give: equivalent circuits and reactances in per unit.

The equivalent circuit of an axis is the stator leakage xl, the magnetising reactance xa and a branch (r, x) for each
rotor winding, all in per unit of the machine's base with reciprocal mutual inductances.  Reactances and time constants
follow the definitions of the models GENROU, GENSAL and GENCLS, in which a damper is neglected where the transient
values are defined and the field resistance where the subtransient ones are:

    xd' = xl + xad x_f/(xad + x_f),   Td0' = (xad + x_f)/(omega r_f),
    xd'' = xl + (xd' - xl) x_k/(xd' - xl + x_k),   Td0'' = (x_k + xd' - xl)/(omega r_k),

and the same on q.  Source: Kundur, Power System Stability and Control, 1994, chapters 3 and 4; IEEE Std 1110.
"""

from __future__ import annotations

import warnings
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from math import isfinite, pi, sqrt
from typing import Any

import numpy as np

from phfmu import Problem, meant
from phfmu.components.electrical.machines.machine_data import MachineData, MachineDataError, Wrong, machine_set
from phfmu.components.electrical.machines.main_flux import Saturation

#: a rotor winding in the circuit: resistance and leakage reactance
Branch = tuple[float, float]
#: turns of a damper winding in those of a stator phase; what a machine does at its ports does not depend on it
DAMPER_TURNS = 1.5
#: what each model needs beside xl and H; xd1 stands for xd', xd2 for xd''
NEEDED = {
    "GENROU": ("xd", "xq", "xd1", "xq1", "xd2", "Td10", "Td20", "Tq10", "Tq20"),
    "GENSAL": ("xd", "xq", "xd1", "xd2", "Td10", "Td20", "Tq20"),
    "GENCLS": ("xd1",),
}
CIRCUIT = ("xad", "xaq", "rotor_d", "rotor_q")
BESIDE = ("ra", "xl", "x0", "xq2", "D")


@dataclass(frozen=True)
class EquivalentCircuit:
    """Both axes of a machine: ra, xl, x0 of the stator, xad and xaq, and a branch (r, x) for each rotor winding.

    All are in per unit, or all in ohm and H where `from_inductances` makes it, numbers or expressions; `d` begins with the field.
    """

    ra: Any
    xl: Any
    x0: Any
    xad: Any
    xaq: Any
    d: tuple[tuple[Any, Any], ...]
    q: tuple[tuple[Any, Any], ...]


def from_per_unit(
    name: str,
    model: str | None = None,
    *,
    Sn: float,
    Vn_rms_ll: float,
    fn: float,
    H: float | None = None,
    J: float | None = None,
    pole_pairs: int = 1,
    no_load_field_current: float | None = None,
    saturation: Saturation | None = None,
    **data: Any,
) -> MachineData:
    """A machine set from per-unit data on the base of the machine (Sn [VA], Vn_rms_ll [V], fn [Hz]).

    The data are of one of two kinds, and which one is seen from their names:

    circuit:     xad, xaq, rotor_d = [(r, x), ..] field first, rotor_q = [(r, x), ..]; xl.  The numbers of windings on d and q
                 name the models of IEEE Std 1110: 1.0 has the field alone, then 1.1, 2.1, 2.2
    reactances:  xd, xq, xd1 (xd'), xd2 (xd''), xq1, xq2 (default: xd2), Td10 (Td0') [s], Td20, Tq10, Tq20; xl.
                 `model` says which are needed: GENROU (2.2, default), GENSAL (2.1: no transient values on q),
                 GENCLS (a constant flux behind xd1, on both axes; no damper)

    H [s] is the inertia constant, or J [kg m2] the inertia of the shaft.  Beside them: ra (default 0), x0 (default xl),
    D (friction torque in per unit at rated speed, on the whole speed).  no_load_field_current [A] gives rated voltage on
    the air-gap line and fixes the units of the field's port; without it the field has 1.5 times the turns of a phase.
    `saturation` of the main flux, behind xl; none with GENCLS, whose flux is constant.
    A winding that the data give no room, xq' = xq or xd'' = xd', is left out with a UserWarning.
    MachineDataError lists all data that are missing, unknown or contradict themselves, with the numbers.
    """
    entry = f"machine '{name}'"
    model = model or ("GENROU" if not any(k in data for k in CIRCUIT) else None)
    if model is not None and model not in NEEDED:
        raise MachineDataError(entry, f"no model '{model}'", meant(model, NEEDED))
    needed = CIRCUIT if model is None else NEEDED[model]
    problems = _entries(needed, data, H, J, Sn, Vn_rms_ll, fn)
    values = _numbers(data, problems)
    if not problems and model is not None:
        problems += _ordered(model, values)
    if problems:
        raise MachineDataError.of([Problem("", entry, *p) for p in problems])
    if saturation is not None and model == "GENCLS":
        raise MachineDataError(entry, "saturates, but the flux of a GENCLS is constant", "leave saturation out")
    omega = 2.0 * pi * fn
    circuit = _given(values, data) if model is None else _circuit(name, model, values, omega)
    inertia = 2.0 * H * Sn / (omega / pole_pairs) ** 2 if J is None and H is not None else J
    return _machine(
        name, circuit, Vn_rms_ll**2 / Sn, omega, no_load_field_current,
        Sn=Sn, Vn_rms_ll=Vn_rms_ll, fn=fn, J=inertia, pole_pairs=pole_pairs, saturation=saturation,
        d=values.get("D", 0.0) * Sn / (omega / pole_pairs) ** 2,
    )  # fmt: skip


def from_inductances(
    name: str,
    *,
    Sn: float,
    Vn_rms_ll: float,
    fn: float,
    Ra: float,
    Ll: float,
    Lmd: float,
    Lmq: float,
    rotor_d: Sequence[Branch],
    rotor_q: Sequence[Branch] = (),
    L0: float | None = None,
    J: float,
    d: float = 0.0,
    pole_pairs: int = 1,
    no_load_field_current: float | None = None,
    saturation: Saturation | None = None,
) -> MachineData:
    """A machine set from the SI values of its equivalent circuit, referred to the stator.

    Ra [ohm]; Ll, Lmd, Lmq, L0 (default Ll) [H]: leakage, magnetising and zero-sequence inductances of the stator;
    rotor_d, rotor_q: (resistance [ohm], leakage inductance [H]) of each rotor winding, the field first on d;
    J [kg m2], d [N m s/rad] as in `MachineData`.  no_load_field_current and saturation as in `from_per_unit`.
    """
    circuit = EquivalentCircuit(Ra, Ll, Ll if L0 is None else L0, Lmd, Lmq, tuple(rotor_d), tuple(rotor_q))
    return _machine(
        name, circuit, 1.0, 1.0, no_load_field_current,
        Sn=Sn, Vn_rms_ll=Vn_rms_ll, fn=fn, J=J, d=d, pole_pairs=pole_pairs, saturation=saturation,
    )  # fmt: skip


def reactances(machine: str | Mapping[str, Any] | MachineData) -> dict[str, float]:
    """Reactances in per unit and open-circuit time constants in s of a machine set, as the grid models define them.

    xd, xq, x0, ra; with the first winding on an axis xd1, Td10, xq1, Tq10, with the second xd2, Td20, xq2, Tq20
    (1 for transient, 2 for subtransient values).  On an axis whose only rotor winding is a damper, which is q of the
    model 2.1, its values are the subtransient ones.  This is the inverse of `from_per_unit` for up to two windings an axis.
    """
    m = machine_set(machine)
    base = m.Vn_rms_ll**2 / m.Sn
    L, w = m.constant_inductance(), m.omega
    out = {"ra": m.Ra / base, "x0": m.L0 * w / base}
    for row, axis in enumerate("dq"):
        found, windings = out, m.on_axis(axis)
        found[f"x{axis}"] = L[row, row] * w / base
        for n, order in enumerate(orders(m, axis)):
            inner = [3 + j for j in windings[: n + 1]]
            own, others = inner[-1], inner[:-1]
            closed = L[row, row] - L[row, inner] @ np.linalg.solve(L[np.ix_(inner, inner)], L[inner, row])
            alone = L[own, own] - L[own, others] @ np.linalg.solve(L[np.ix_(others, others)], L[others, own])
            found[f"x{axis}{order}"] = float(closed) * w / base
            R = m.R_rotor[windings[n]]
            found[f"T{axis}{order}0"] = float(alone) / R if R else float("inf")
    return out


def orders(m: MachineData, axis: str) -> tuple[int, ...]:
    """The kinds of values that the windings of an axis bring, in their order: 1 transient, 2 subtransient."""
    n = len(m.on_axis(axis))
    return (2,) if axis == "q" and n == 1 and len(m.on_axis("d")) > 1 else (1, 2)[:n]


def _entries(
    needed: Sequence[str],
    data: Mapping[str, Any],
    H: float | None,
    J: float | None,
    Sn: float,
    Vn_rms_ll: float,
    fn: float,
) -> list[Wrong]:
    """The data that are missing, unknown or not positive where they must be."""
    known = (*needed, *BESIDE)
    out: list[Wrong] = [(f"unknown entry '{k}'", meant(k, known)) for k in data if k not in known]
    needed = (*(k for k in needed if k != "rotor_q"), *(() if needed == NEEDED["GENCLS"] else ("xl",)))
    if missing := [k for k in needed if data.get(k) is None]:
        out.append((f"missing: {', '.join(missing)}", "give them, in per unit on the machine's base, times in s"))
    out += [
        (f"{k} = {v} must be positive", "give a positive number")
        for k, v in (("Sn", Sn), ("Vn_rms_ll", Vn_rms_ll), ("fn", fn))
        if not (v > 0 and isfinite(v))
    ]
    if (H is None) == (J is None):
        out.append((f"H = {H} s and J = {J} kg m2", "give one of them"))
    return out


def _numbers(data: Mapping[str, Any], problems: list[Wrong]) -> dict[str, float]:
    """The scalar entries as numbers; what is none, or negative, is added to the problems."""
    out = {}
    for key, value in data.items():
        if key in ("rotor_d", "rotor_q") or value is None:
            continue
        try:
            out[key] = float(value)
        except (TypeError, ValueError):
            problems.append((f"{key} = {value!r} is no number", "give a number"))
            continue
        lowest = 0.0 if key in ("ra", "D") else None
        if not isfinite(out[key]) and not key.startswith("T"):
            problems.append((f"{key} = {value} is not finite", "give a finite number"))
        elif not (out[key] > 0 or out[key] == lowest):
            problems.append((f"{key} = {out[key]:g} must be positive", "give a positive number"))
    return out


def _ordered(model: str, v: Mapping[str, float]) -> list[Wrong]:
    """The reactances that contradict xl < x'' <= x' <= x on an axis."""
    if model == "GENCLS":
        return []
    out: list[Wrong] = []
    chains = {
        "d": ("xd", "xd1", "xd2"),
        "q": ("xq", "xq1", "xq2") if model == "GENROU" else ("xq", "xq2"),
    }
    for chain in chains.values():
        found = [(k, v.get(k, v["xd2"])) for k in chain]
        for (above, x), (below, y) in zip(found, found[1:], strict=False):
            if y > x:
                out.append((f"{below} = {y:g} is above {above} = {x:g}", "give x'' <= x' <= x in per unit"))
        if found[-1][1] <= v["xl"]:
            out.append((
                f"{found[-1][0]} = {found[-1][1]:g} is not above the leakage xl = {v['xl']:g}: "
                "the damper's own leakage would be negative",
                "give xl below the subtransient reactances, or the circuit itself (xad, xaq, rotor_d, rotor_q)",
            ))  # fmt: skip
    if v["xd1"] == v["xd"]:
        out.append((f"xd1 = xd = {v['xd']:g} leaves no field winding", "give xd' below xd"))
    return out


def _given(v: Mapping[str, float], data: Mapping[str, Any]) -> EquivalentCircuit:
    """The circuit that the data give as it is."""
    d, q = (tuple((float(r), float(x)) for r, x in data.get(k) or ()) for k in ("rotor_d", "rotor_q"))
    return EquivalentCircuit(v.get("ra", 0.0), v["xl"], v.get("x0", v["xl"]), v["xad"], v["xaq"], d, q)


def _circuit(name: str, model: str, v: Mapping[str, float], omega: float) -> EquivalentCircuit:
    """The circuit whose reactances and time constants are those of `v`."""
    if model == "GENCLS":
        # a winding without resistance keeps its flux: xd1 on d, whatever xd and xl are; xq = xd1 needs none
        xl = v.get("xl", v["xd1"] / 2.0)
        xa = v["xd1"] - xl
        return EquivalentCircuit(v.get("ra", 0.0), xl, v.get("x0", xl), 2.0 * xa, xa, ((0.0, 2.0 * xa),), ())
    xl, subtransient = v["xl"], v.get("xq2", v["xd2"])
    d = _lowered(name, "d", v["xd"], [(v["xd1"], v["Td10"]), (v["xd2"], v["Td20"])])
    steps = [(subtransient, v["Tq20"])]
    if model == "GENROU":
        steps.insert(0, (v["xq1"], v["Tq10"]))
    q = _lowered(name, "q", v["xq"], steps)
    return EquivalentCircuit(
        v.get("ra", 0.0), xl, v.get("x0", xl), v["xd"] - xl, v["xq"] - xl,
        branches(xl, v["xd"], d, omega), branches(xl, v["xq"], q, omega),
    )  # fmt: skip


def _lowered(name: str, axis: str, x: float, steps: Sequence[tuple[float, float]]) -> list[tuple[float, float]]:
    """The values and time constants of an axis without those that its windings give no room."""
    out = []
    for lower, time in steps:
        if lower == x:
            text = f"machine '{name}': the {axis} axis has {x:g} pu twice among its reactances; the winding between is left out"
            warnings.warn(text, stacklevel=4)
            continue
        out.append((lower, time))
        x = lower
    return out


def branches(xl: Any, x: Any, steps: Sequence[tuple[Any, Any]], omega: float) -> tuple[tuple[Any, Any], ...]:
    """The rotor windings (r, x) of an axis: each lowers the reactance x to the next value of `steps` with its time constant.

    Reactances in per unit, time constants in s, all of them numbers or expressions.
    """
    out = []
    for lower, time in steps:
        leakage = (x - xl) * (lower - xl) / (x - lower)
        out.append(((x - xl + leakage) / (omega * time), leakage))
        x = lower
    return tuple(out)


@dataclass(frozen=True)
class ReferredWindings:
    """Rotor windings in turns of their own: peak mutual inductances M [H], R [ohm], L(i, j) [H]; numbers or expressions."""

    M: list[Any]
    R: list[Any]
    L: list[list[Any]]


def referred(c: EquivalentCircuit, k: Sequence[Any], Z: float, omega: float) -> ReferredWindings:
    """The rotor windings of a circuit with the turns `k` in those of a phase; Z [ohm]: base of its resistances."""
    Lb, windings = Z / omega, [*(("d", *b) for b in c.d), *(("q", *b) for b in c.q)]
    mutual = {"d": c.xad, "q": c.xaq}
    L = [
        [
            1.5 * (mutual[a] + (x if i == j else 0.0)) * Lb / (k[i] * k[j]) if a == b else 0.0
            for j, (b, _, _) in enumerate(windings)
        ]
        for i, (a, _, x) in enumerate(windings)
    ]
    R = [1.5 * r * Z / k[i] ** 2 for i, (_, r, _) in enumerate(windings)]
    return ReferredWindings([mutual[a] * Lb / k[i] for i, (a, _, _) in enumerate(windings)], R, L)


def _machine(
    name: str, c: EquivalentCircuit, Z: float, omega: float, no_load: float | None, **ratings: Any
) -> MachineData:
    """The set of a circuit; Z [ohm]: base of its resistances, Z/omega [H]: of its inductances."""
    Lb, axis = Z / omega, [*("d" for _ in c.d), *("q" for _ in c.q)]
    k = [DAMPER_TURNS] * len(axis)
    if no_load is not None and axis:
        rated = sqrt(2.0 / 3.0) * ratings["Vn_rms_ll"] / (2.0 * pi * ratings["fn"])  # peak flux of a phase
        k[0] = c.xad * Lb * no_load / rated
    rotor = referred(c, k, Z, omega)
    return machine_set({
        "name": name, **ratings, "Ra": c.ra * Z, "axis": axis, "R_rotor": rotor.R,
        "Ll": c.xl * Lb, "Ld": (c.xl + c.xad) * Lb, "Lq": (c.xl + c.xaq) * Lb, "L0": c.x0 * Lb,
        "M_stator_rotor": rotor.M, "L_rotor": rotor.L,
    })  # fmt: skip
