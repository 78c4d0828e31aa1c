"""Lines from positive- and zero-sequence data, or of one phase: series, charged, series-compensated."""

from __future__ import annotations

from dataclasses import dataclass
from math import pi
from typing import Any

import casadi as ca

from phfmu import ELECTRICAL, PHDAE, Energy, Port, Variable, block, damping, energy, observable, parameter, skew, state
from phfmu.components.electrical.phases import Phases


def require_sequences(part: str, name: str, unit: str, positive: float, zero: float, least: str = "positive") -> None:
    """ValueError unless both sequence values, which are the eigenvalues of the phase matrix, are positive (or not negative)."""
    fine = min(positive, zero) > 0 if least == "positive" else min(positive, zero) >= 0
    if not fine:
        own, mutual = (zero + 2 * positive) / 3, (zero - positive) / 3
        raise ValueError(
            f"{part}: {name} = {positive:g} {unit} and {name}0 = {zero:g} {unit} must be {least}: they are the eigenvalues of "
            f"the matrix with {own:g} on and {mutual:g} off the diagonal; give the sequence values, not the self and mutual "
            "ones"
        )


def line_per_unit(
    r: float,
    x: float,
    b: float = 0.0,
    *,
    S: float,
    V: float,
    f: float,
    r0: float | None = None,
    x0: float | None = None,
    b0: float | None = None,
) -> dict[str, float]:
    """R, L, C, R0, L0, C0 in SI of a line given in per unit:  R = r Z,  L = x Z/w,  C = b/(w Z),  Z = V^2/S,  w = 2 pi f.

    `S` [VA] and `V` [V rms, line to line] are the base, `f` [Hz] the frequency, `b` the charging of the whole line.
    C is left out where b = 0.  Zero-sequence values that are not given equal those of the positive sequence.
    ValueError for a base that is not positive, or of a size that kV or MVA have.
    """
    if not (S > 0 and V > 0 and f > 0):
        raise ValueError(
            f"line_per_unit: S = {S:g} VA, V = {V:g} V and f = {f:g} Hz must be positive; give them in SI units"
        )
    if S < 1e4 and V < 1e4:
        raise ValueError(
            f"line_per_unit: S = {S:g} VA and V = {V:g} V look like MVA and kV; give VA and V, such as S=100e6, V=230e3"
        )
    Z, w = V**2 / S, 2.0 * pi * f
    data = {"R": r * Z, "L": x * Z / w}
    data |= {"R0": data["R"] if r0 is None else r0 * Z, "L0": data["L"] if x0 is None else x0 * Z / w}
    return data | ({"C": b / Z / w, "C0": (b if b0 is None else b0) / Z / w} if b else {})


@dataclass(frozen=True)
class _Series:
    """The series part of a line: flux of the phases, its sequence inductances and resistances."""

    phases: Phases
    flux: Variable
    parameters: tuple[Variable, ...]
    energy: Energy
    resistance: Any


def _series(
    part: str, phases: int, R: float, L: float, R0: float | None, L0: float | None, rated: float, **more: float | None
) -> _Series:
    p = Phases.of(part, phases)
    p.no_zero_sequence(part, R0=R0, L0=L0, **more)
    R0, L0 = R if R0 is None else R0, L if L0 is None else L0
    require_sequences(part, "L", "H", L, L0)
    require_sequences(part, "R", "ohm", R, R0, "not negative")
    r = parameter("R", R, unit="ohm", min=0.0, description="positive-sequence resistance")
    l = parameter("L", L, unit="H", positive=True, description="positive-sequence inductance")
    flux = state("flux", unit="Wb", nominal=max(L, L0) * rated, description="flux per phase, a to b", **p.each)
    if p.count == 1:
        return _Series(p, flux, (r, l), p.energy(flux, l.sx, None), damping(flux, r))
    r0 = parameter("R0", R0, unit="ohm", min=0.0, description="zero-sequence resistance")
    l0 = parameter("L0", L0, unit="H", positive=True, description="zero-sequence inductance")
    return _Series(p, flux, (r, l, r0, l0), p.energy(flux, l.sx, l0.sx), block((flux,), p.matrix(r.sx, r0.sx)))


def _ends(p: Phases, on: dict[str, dict[Variable, float]], given: Any, nominal: float) -> tuple[Port, ...]:
    return tuple(
        Port(
            end, ELECTRICAL, given, columns, nominal=nominal, description=f"end {end}; current into the line", **p.each
        )
        for end, columns in on.items()
    )


def _through(p: Phases, flux: Variable) -> Any:
    return observable("i", flux.z, unit="A", description="current from a to b", elements=p.elements)


def coupled_line(
    R: float,
    L: float,
    *,
    R0: float | None = None,
    L0: float | None = None,
    v: float = 1.0,
    rated: float = 1.0,
    phases: int = 3,
) -> PHDAE:
    """Mutually coupled series line between `a` and `b`:  flux' = v_a - v_b - R_abc i,  flux = L_abc i.

    R_abc and L_abc are the symmetric matrices of the sequence values: self (X0 + 2 X)/3, mutual (X0 - X)/3.

    H:  i^T L_abc i / 2;  J: 0;  R: R_abc
    states:      flux (3) [Wb]
    ports:       a, b: voltages given, currents INTO the line out; a.i = i, b.i = -i
    parameters:  R, R0 [ohm], L, L0 [H]: positive and zero sequence; without R0 and L0 the phases are not coupled
    observables: i (3), the current from a to b
    `v`: typical voltage [V];  `rated`: typical current [A];  `phases`: 3, or 1, which has no zero sequence and scalars for (3).
    ValueError for sequence values that are not positive, and for those of the zero sequence of one phase.
    Source: Kundur, Power System Stability and Control, 1994, section 6.1; Dommel, EMTP Theory Book, 1986, chapter 4.
    """
    series = _series("coupled_line", phases, R, L, R0, L0, rated)
    p = series.phases
    return PHDAE(
        "coupled_line",
        states=(series.flux,),
        parameters=series.parameters,
        energies=(series.energy,),
        dissipation=(series.resistance,),
        ports=_ends(p, {"a": {series.flux: 1}, "b": {series.flux: -1}}, "effort", v),
        observables=(_through(p, series.flux),),
        description="mutually coupled three-phase series line" if p.count == 3 else "single-phase series line",
    )


def pi_line(
    R: float,
    L: float,
    C: float,
    *,
    R0: float | None = None,
    L0: float | None = None,
    C0: float | None = None,
    v: float = 1.0,
    rated: float = 1.0,
    phases: int = 3,
) -> PHDAE:
    """Line with half of its charging at each end:  flux' = v_a - v_b - R_abc i,  q_a' = a.i - i,  q_b' = b.i + i.

    flux = L_abc i,  q_a = C_abc v_a/2,  q_b = C_abc v_b/2, symmetric matrices of the sequence values.

    H:  i^T L_abc i/2 + v_a^T C_abc v_a/4 + v_b^T C_abc v_b/4;  J: J[flux, q_a] = 1, J[flux, q_b] = -1 (skew);  R: R_abc
    states:      flux (3) [Wb], q_a (3), q_b (3) [C]
    ports:       a, b: currents INTO the line given, voltages out
    parameters:  R, R0 [ohm], L, L0 [H], C, C0 [F] of the whole line: positive and zero sequence (as positive where not given)
    observables: i (3), the current from a to b
    Where charged ends meet at one bus their capacitors are one: use `coupled_line` and one `shunt` per bus there.
    `v`: typical voltage [V];  `rated`: typical current [A];  `phases`: 3, or 1, which has no zero sequence and scalars for (3).
    ValueError for sequence values that are not positive, and for those of the zero sequence of one phase.
    Source: Kundur, Power System Stability and Control, 1994, section 6.1.
    """
    given, C0 = C0, C if C0 is None else C0
    require_sequences("pi_line", "C", "F", C, C0)
    series = _series("pi_line", phases, R, L, R0, L0, rated, C0=given)
    p = series.phases
    c = parameter("C", C, unit="F", positive=True, description="positive-sequence charging of the whole line")
    c0 = parameter("C0", C0, unit="F", positive=True, description="zero-sequence charging of the whole line")
    ends = [
        state(f"q_{end}", unit="C", nominal=C * v / 2, description=f"charge per phase of end {end}", **p.each)
        for end in "ab"
    ]
    return PHDAE(
        "pi_line",
        states=(series.flux, *ends),
        parameters=(*series.parameters, c, *(() if p.count == 1 else (c0,))),
        energies=(series.energy, *(p.energy(q, c / 2, c0 / 2) for q in ends)),
        structure=tuple(skew(series.flux, q, sign) for q, sign in zip(ends, (1, -1), strict=True)),
        dissipation=(series.resistance,),
        ports=_ends(p, {end: {q: 1} for end, q in zip("ab", ends, strict=True)}, "flow", rated),
        observables=(_through(p, series.flux),),
        description=f"{p.word} line with charging at its ends",
    )


def series_compensated_line(
    R: float,
    L: float,
    C: float,
    *,
    R0: float | None = None,
    L0: float | None = None,
    v: float = 1.0,
    rated: float = 1.0,
    phases: int = 3,
) -> PHDAE:
    """Line with a capacitor in series in each phase:  flux' = v_a - v_b - R_abc i - charge/C,  charge' = i,  flux = L_abc i.

    H:  i^T L_abc i/2 + |charge|^2/(2 C);  J: J[flux, charge] = -1 (skew);  R: R_abc
    states:      flux (3) [Wb], charge (3) [C]
    ports:       a, b: voltages given, currents INTO the line out; a.i = i, b.i = -i
    parameters:  R, R0 [ohm], L, L0 [H]: positive and zero sequence;  C [F] per phase, in series
    observables: i (3), the current from a to b;  v_C (3), the voltage over the capacitors
    `v`: typical voltage [V];  `rated`: typical current [A];  `phases`: 3, or 1, which has no zero sequence and scalars for (3).
    ValueError for values that are not positive, and for those of the zero sequence of one phase.
    Source: IEEE Subsynchronous Resonance Task Force, first benchmark model, IEEE Trans. PAS-96 (1977).
    """
    if not C > 0:
        raise ValueError(f"series_compensated_line: C = {C:g} F must be positive; without a capacitor use coupled_line")
    series = _series("series_compensated_line", phases, R, L, R0, L0, rated)
    p = series.phases
    c = parameter("C", C, unit="F", positive=True, description="capacitance in series per phase")
    charge = state("charge", unit="C", nominal=C * v, description="charge per phase of the capacitors", **p.each)
    return PHDAE(
        "series_compensated_line",
        states=(series.flux, charge),
        parameters=(*series.parameters, c),
        energies=(series.energy, energy(ca.sumsqr(charge.sx) / (2 * c))),
        structure=(skew(series.flux, charge, -1),),
        dissipation=(series.resistance,),
        ports=_ends(p, {"a": {series.flux: 1}, "b": {series.flux: -1}}, "effort", v),
        observables=(
            _through(p, series.flux),
            observable("v_C", charge.z, unit="V", description="voltage over the capacitors", elements=p.elements),
        ),
        description=f"{p.word} line with series capacitors",
    )
