"""Transformers of two windings, of three phases or one: vector group, leakage, tap, magnetising branch."""

from __future__ import annotations

from collections.abc import Sequence
from math import pi, sqrt
from typing import Any

import casadi as ca
import numpy as np

from phfmu import ELECTRICAL, PHDAE, Port, block, damping, energy, observable, parameter, state
from phfmu.components.electrical.network.saturation import MagnetisationCurve
from phfmu.components.electrical.phases import Phases

#: what the phases of a side put on the limbs: each with ground, each with a neutral that floats, between two phases
GROUNDED = np.eye(3)
FLOATING = np.eye(3) - 1.0 / 3.0
#: differences of phases over sqrt(3), which turn a balanced voltage by 30 degrees forwards and backwards
FORWARDS = (np.eye(3) - np.roll(np.eye(3), 1, axis=1)) / sqrt(3.0)
BACKWARDS = FORWARDS.T


def limbs(group: str) -> tuple[np.ndarray, np.ndarray]:
    """Incidence of the sides of a vector group on its limbs (3 x 3 each): W_a v_a/n = W_b v_b without load.

    A star beside one whose neutral floats has no zero sequence either: its mmf would find no counterpart.
    The hour counts from side a to side b: at hour 11 the voltages of b lead by 30 degrees, at 1 they lag.
    Ii0 and Ii6 are those of one phase (1 x 1 each).  Raises ValueError for an unknown group, such as an odd hour between two
    stars.
    """
    if group in ("Ii0", "Ii6"):
        return np.array([[1.0 if group == "Ii0" else -1.0]]), np.eye(1)
    sides = group.rstrip("0123456789")
    hour = group[len(sides) :]
    a = next((s for s in ("YN", "Y", "D") if sides.startswith(s)), "")
    b = sides[len(a) :]
    if a and b in ("yn", "y", "d") and hour and int(hour) < 12:
        k = int(hour)
        both_star, both_delta = a != "D" and b != "d", a == "D" and b == "d"
        hours = (0, 6) if both_star or both_delta else (1, 5, 7, 11)
        if k in hours:
            sign = -1.0 if k in (5, 6, 7) else 1.0
            forwards = (k + 6 * (sign < 0)) % 12 == 11
            turn = FORWARDS if forwards else BACKWARDS
            star = FLOATING if a == "Y" or b == "y" else GROUNDED
            left = star if a != "D" else (FORWARDS if both_delta else turn)
            right = star if b != "d" else (FORWARDS if both_delta else turn.T)
            return sign * left, right
    raise ValueError(
        f"two_winding_transformer: no vector group '{group}'; give YN, Y or D, then yn, y or d, then the hour: 0 or 6 between "
        "equal kinds, 1, 5, 7 or 11 between a star and a delta, such as YNyn0, Dyn1, Dyn11, YNd11; with one phase Ii0 or Ii6"
    )


def two_winding_transformer(
    Sn: float,
    Va: float,
    Vb: float,
    *,
    f: float = 50.0,
    r: float = 0.0,
    x: float = 0.1,
    group: str | None = None,
    tap: float = 1.0,
    i0: float | None = None,
    p0: float = 0.0,
    curve: MagnetisationCurve | None = None,
    linkage0: float | Sequence[float] = 0.0,
    phases: int = 3,
) -> PHDAE:
    """Transformer with its leakage on side b:  flux' = W_a v_a/(tap n) - W_b v_b - R i,  i = flux/L,  n = Va/Vb.

    a.i = W_a^T (i + i_m)/(tap n),  b.i = -W_b^T i.  W_a, W_b: what the sides put on the limbs, by the vector group.
    With `i0`:  linkage' = W_a v_a/(tap n),  i_m = linkage/L_m + G_m W_a v_a/(tap n),  beside side a.
    With `curve` instead: i_m = dH/d linkage of the magnetisation curve, flux and current as parts of the rated peaks on side b;
    it begins with the fluxes `linkage0` [1], parts of the rated peak.

    H:  |flux|^2/(2 L) + |linkage|^2/(2 L_m), or that of the curve;  J: 0
    R:  R on each limb, G_m W_a^T W_a/(tap n)^2 as feedthrough of a
    states:      flux (3) [Wb] of the leakage, linkage (3) [Wb] of the core with i0; both as seen from side b
    ports:       a, b: voltages given, currents INTO the transformer out
    parameters:  R [ohm], L [H] of the leakage, L_m [H] and G_m [S] of the core, as seen from side b;  ratio n, tap [1]
    observables: i (3), the current through the limbs, counted from a to b;  i_m (3), that of the core with i0
    Sn [VA], of all phases;  Va, Vb [V]: rated, rms, line to line, or of the windings of one phase;  f [Hz];  r, x, i0, p0 [1]:
    series resistance, leakage, no-load current and no-load loss in per unit of Sn, Vb;  `tap`: turns of side a as a part of the
    rated ones, tunable.
    `phases`: 3, or 1 with scalars for (3);  `group`: the vector group, YNyn0 where it is not given, with one phase Ii0 (or Ii6).
    Where a neutral floats (Y or y) no zero sequence flows on either side.  A delta grounds that of yn or YN over the leakage.
    Raises ValueError for ratings that are not positive, x = 0, and a no-load loss that the no-load current cannot bring.
    Source: IEC 60076-1 (vector groups); Kundur, Power System Stability and Control, 1994, section 6.2.
    """
    if not (Sn > 0 and Va > 0 and Vb > 0 and f > 0 and tap > 0):
        raise ValueError(
            f"two_winding_transformer: Sn = {Sn:g} VA, Va = {Va:g} V, Vb = {Vb:g} V, f = {f:g} Hz, tap = {tap:g} must be positive"
        )
    if not (x > 0 and r >= 0):
        remedy = "for an ideal one use transformer"
        raise ValueError(f"two_winding_transformer: x = {x:g} must be positive and r = {r:g} not negative; {remedy}")
    if curve is not None and (i0 is not None or p0):
        raise ValueError(
            f"two_winding_transformer: a curve and i0 = {i0}, p0 = {p0:g} both say what the core takes; give one of them"
        )
    if p0 and (i0 is None or not 0 <= p0 < i0):
        raise ValueError(
            f"two_winding_transformer: a no-load loss p0 = {p0:g} needs a no-load current above it, i0 = {i0}; both in per unit"
        )
    p = Phases.of("two_winding_transformer", phases)
    group = group or ("YNyn0" if p.count == 3 else "Ii0")
    left, right = (ca.DM(w) for w in limbs(group))
    if left.shape[0] != p.count:
        raise ValueError(
            f"two_winding_transformer: vector group '{group}' with phases = {phases}; Ii0 and Ii6 have one, all others 3"
        )
    Z, w = Vb**2 / Sn, 2.0 * pi * f
    peak, rated = Vb * p.peak, p.peak * Sn / Vb
    resistance = parameter("R", r * Z, unit="ohm", description="resistance per limb, seen from side b")
    leakage = parameter("L", x * Z / w, unit="H", positive=True, description="leakage per limb, seen from side b")
    ratio = parameter("ratio", Va / Vb, unit="1", positive=True, description="rated ratio Va / Vb")
    position = parameter("tap", tap, unit="1", positive=True, description="turns of side a, relative to the rated ones")
    seen = left / (ratio * position)
    flux = state("flux", unit="Wb", nominal=x * Z / w * rated, description="leakage flux of the limbs", **p.each)
    linkage = state(
        "linkage",
        unit="Wb",
        start=p.start(peak / w, linkage0),
        nominal=peak / w,
        description="flux linkage of the core",
        **p.each,
    )
    told = observable("i_m", linkage.z, unit="A", description="magnetising current", elements=p.elements)
    on: dict[Any, Any] = {flux: seen}
    more: dict[str, tuple[Any, ...]] = {"states": (), "parameters": (), "energies": (), "told": ()}
    if i0 is not None:
        if not i0 > 0:
            raise ValueError(
                f"two_winding_transformer: i0 = {i0:g} must be positive; leave it out for a core without current"
            )
        magnetising = parameter(
            "L_m", Z / sqrt(i0**2 - p0**2) / w, unit="H", positive=True, description="inductance of the core"
        )
        on[linkage] = seen
        more = {
            "states": (linkage,), "parameters": (magnetising,), "told": (told,),
            "energies": (energy(ca.sumsqr(linkage.sx) / (2 * magnetising)),),
        }  # fmt: skip
    if curve is not None:
        on[linkage] = seen
        iron = curve.scaled(peak / w, rated)
        parts = tuple(energy(iron.energy(part)) for part in ca.vertsplit(linkage.sx))
        more = {"states": (linkage,), "parameters": (), "told": (told,), "energies": parts}
    a = Port(
        "a",
        ELECTRICAL,
        "effort",
        on,
        nominal=Va * p.peak,
        description="side a; current into the transformer",
        **p.each,
    )
    b = Port(
        "b",
        ELECTRICAL,
        "effort",
        {flux: -right},
        nominal=peak,
        description="side b; current into the transformer",
        **p.each,
    )
    lost = (damping(flux, resistance),)
    if p0:
        core = parameter("G_m", p0 / Z, unit="S", min=0.0, description="conductance of the losses of the core")
        more["parameters"] += (core,)
        lost += (block((a,), core.sx * seen.T @ seen),)
    return PHDAE(
        "two_winding_transformer",
        states=(flux, *more["states"]),
        parameters=(resistance, leakage, ratio, position, *more["parameters"]),
        energies=(energy(ca.sumsqr(flux.sx) / (2 * leakage)), *more["energies"]),
        dissipation=lost,
        ports=(a, b),
        observables=(
            observable("i", flux.z, unit="A", description="current through the limbs, a to b", elements=p.elements),
            *more["told"],
        ),
        description=f"{p.word} transformer {group} with leakage",
    )
