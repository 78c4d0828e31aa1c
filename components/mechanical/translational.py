"""Mass, spring and damper on a line."""

from __future__ import annotations

from phfmu import PHDAE, TRANSLATIONAL, Port, algebraic, block, damping, energy, parameter, skew, state


def mass(m: float = 1.0, *, k: float | None = None, d: float | None = None, q: float = 0.0, v: float = 0.0) -> PHDAE:
    """A mass with an optional spring and damper to ground.

        H = 1/2 m v^2 + 1/2 k q^2,   q' = v,   m v' = -k q - d v + F

    States:      q [m], v [m/s]
    Ports:       flange (force given, velocity out)
    Parameters:  m [kg]; k [N/m] and d [N.s/m] where given
    """
    qs, vs = state("q", unit="m", start=q), state("v", unit="m/s", start=v)
    ms = parameter("m", m, unit="kg")
    parameters, energies, dissipation = [ms], [energy(0.5 * ms * vs.sx**2)], []
    if k is not None:
        ks = parameter("k", k, unit="N/m")
        parameters.append(ks)
        energies.append(energy(0.5 * ks * qs.sx**2))
    if d is not None:
        ds = parameter("d", d, unit="N.s/m")
        parameters.append(ds)
        dissipation.append(damping(vs, ds))
    return PHDAE(
        "mass",
        states=(qs, vs),
        parameters=tuple(parameters),
        energies=tuple(energies),
        E={vs: ms},
        structure=(skew(qs, vs, 1.0),),
        dissipation=tuple(dissipation),
        ports=(Port("flange", TRANSLATIONAL, "effort", {vs: 1.0}, description="force on the mass"),),
        description="mass with optional spring and damper to ground",
    )


def spring(k: float = 1.0, *, d: float | None = None, elongation: float = 0.0) -> PHDAE:
    """A linear spring between two flanges, optionally with a parallel damper.

        H = 1/2 k e^2,   e' = v_b - v_a,   F_b = k e + d e',   F_a = -F_b   (forces on the spring)

    States:      e [m]; `elongation` [m] is its start
    Ports:       a, b (velocity given, force out)
    Parameters:  k [N/m]; d [N.s/m] where given
    """
    e = state("e", unit="m", start=elongation, description="elongation")
    ks = parameter("k", k, unit="N/m")
    if d is None:
        on_a, on_b = {e: -1.0}, {e: 1.0}
        extra = {}
    else:
        # the damper force is algebraic: rows 0 = -w + (v_b - v_a) and 0 = F_d - d w with (F_d, w) = z2
        ds = parameter("d", d, unit="N.s/m")
        f, w = algebraic("damper.force", unit="N"), algebraic("damper.velocity", unit="m/s")
        on_a, on_b = {e: -1.0, f: -1.0}, {e: 1.0, f: 1.0}
        extra = {"algebraics": (f, w), "structure": (skew(f, w, -1.0),), "dissipation": (damping(w, ds),)}
    return PHDAE(
        "spring",
        states=(e,),
        parameters=(ks,) if d is None else (ks, ds),
        energies=(energy(0.5 * ks * e.sx**2),),
        ports=(
            Port("a", TRANSLATIONAL, "flow", on_a, description="left flange"),
            Port("b", TRANSLATIONAL, "flow", on_b, description="right flange"),
        ),
        description="linear spring between two flanges",
        **extra,
    )


def damper(d: float = 1.0) -> PHDAE:
    """A linear damper between two flanges.

        F_b = d (v_b - v_a),   F_a = -F_b;   realised as 0 = F - d w, 0 = -w + v_b - v_a with z2 = (F, w)

    Ports:       a, b (velocity given, force out)
    Parameters:  d [N.s/m]
    """
    f, w = algebraic("force", unit="N"), algebraic("velocity", unit="m/s")
    ds = parameter("d", d, unit="N.s/m")
    return PHDAE(
        "damper",
        algebraics=(f, w),
        parameters=(ds,),
        structure=(skew(f, w, -1.0),),
        dissipation=(block([w], ds),),
        ports=(
            Port("a", TRANSLATIONAL, "flow", {f: -1.0}, description="left flange"),
            Port("b", TRANSLATIONAL, "flow", {f: 1.0}, description="right flange"),
        ),
        description="linear damper between two flanges",
    )
