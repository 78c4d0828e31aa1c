"""The induction machine with any number of rotor cages, in the stator's frame."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from math import pi, sqrt

import casadi as ca

from phfmu import (
    ELECTRICAL,
    PHDAE,
    ROTATIONAL,
    Block,
    DeclarationError,
    Port,
    Variable,
    block,
    damping,
    energy,
    observable,
    parameter,
    state,
)
from phfmu.components.electrical.phases import PHASES

#: orthonormal Clarke matrix: phases a, b, c -> alpha, beta, 0
CLARKE = ca.DM([[1.0, -0.5, -0.5], [0.0, sqrt(0.75), -sqrt(0.75)], [sqrt(0.5)] * 3]) * sqrt(2.0 / 3.0)


def induction_machine(
    R_s: float = 0.087, L_s: float = 0.8e-3, L_m: float = 34.7e-3, cages: Sequence[tuple[float, float]] = ((0.228, 0.8e-3),),
    J: float = 1.662, *, d: float = 0.0, pole_pairs: int = 2, L_0: float | None = None, speed: float = 0.0, v: float = 375.6,
    f: float = 60.0, i: float = 80.0,
) -> PHDAE:  # fmt: skip
    """Three-phase induction machine with squirrel cages, all stator transients, in motor sign.

    psi_s' = v - R_s i_s,  psi_k' = -R_k i_k + pole_pairs omega (-psi_k,beta, psi_k,alpha),  p' = tau + Te - d omega,  omega = p/J

    H:  sum of |psi_k - psi_m|^2 / (2 L_k) over stator and cages + |psi_m|^2 / (2 L_m) + psi_0^2 / (2 L_0) + p^2 / (2 J), with
        the magnetising flux psi_m = (sum psi_k / L_k) / (1/L_m + sum 1/L_k) in alpha, beta;  all cages link this flux alone
    J:  J[psi_k, p] = pole_pairs (-psi_k,beta, psi_k,alpha) (skew), so that Te = pole_pairs sum (psi_k,beta i_k,alpha - ..)
    R:  R_s on the stator, R_k on each cage, d on p
    states:      psi_s (a, b, c), psi_1, psi_2, .. (alpha, beta) [Wb], p [kg.m2/s], the angular momentum of the shaft
    ports:       terminal: phase voltages given, currents INTO the machine out; shaft: torque given, speed out (mechanical)
    parameters:  R_s, L_s, L_m, L_0 [ohm, H], R_1, L_1, .. of the cages, referred to the stator, J [kg.m2], d [N.m.s/rad]
    observables: Te [N.m], i (a, b, c) [A], slip of the shaft to a field of frequency f

    R_s, L_s: resistance and leakage inductance of the stator;  L_m: magnetising inductance, 3/2 of the peak mutual inductance of
    two phases;  L_0: zero-sequence inductance (default L_s);  cages: (resistance, leakage inductance) each;
    speed [rad/s]: of the shaft at the start, where all fluxes are zero;  v [V], f [Hz], i [A]: rated peak phase voltage,
    frequency, peak current.
    A second cage makes deep bars or a double cage.  No angle is a state: a round rotor does not tell one.
    Defaults: 50 hp, 460 V, 60 Hz, four poles.  Source: Krause, Wasynczuk, Sudhoff, Pekarek, Analysis of Electric
    Machinery and Drive Systems, 2013, chapter 6.
    """
    _require(R_s, L_s, L_m, cages, J, pole_pairs)
    w = 2.0 * pi * f
    stator_R, stator_L, mutual, zero = _stator(R_s, L_s, L_m, L_s if L_0 is None else L_0)
    inertia = parameter("J", J, unit="kg.m2", positive=True, description="inertia of the shaft")
    friction = parameter("d", d, unit="N.m.s/rad", description="friction torque per speed of the shaft")
    psi = state("psi_s", 3, unit="Wb", nominal=v / w, description="stator fluxes", elements=PHASES)
    rotor = [Cage.of(k, R, L, sqrt(1.5) * v / w, pole_pairs) for k, (R, L) in enumerate(cages, 1)]
    speed_nominal = w / pole_pairs
    p = state(
        "p", unit="kg.m2/s", start=J * speed, nominal=J * speed_nominal, description="angular momentum of the shaft"
    )
    stator = ca.mtimes(CLARKE, psi.sx)
    stored = _magnetic([stator[:2], *(c.psi.sx for c in rotor)], [stator_L.sx, *(c.L.sx for c in rotor)], mutual.sx)
    slip = 1 - pole_pairs * p.z / w
    return PHDAE(
        "induction_machine",
        states=(psi, *(c.psi for c in rotor), p),
        parameters=(stator_R, stator_L, mutual, zero, *(x for c in rotor for x in (c.R, c.L)), inertia, friction),
        energies=(energy(stored + stator[2] ** 2 / (2 * zero.sx)), energy(p**2 / (2 * inertia))),
        structure=tuple(c.speed_voltage(p) for c in rotor),
        dissipation=(damping(psi, stator_R), *(damping(c.psi, c.R) for c in rotor), damping(p, friction)),
        ports=_ports(psi, p, v, 1.5 * v * i / speed_nominal),
        observables=(
            observable("Te", sum((c.torque for c in rotor), ca.SX(0)), unit="N.m", description="electrical torque, accelerating"),
            observable("i", psi.z, unit="A", description="stator currents, into the machine", elements=PHASES),
            observable("slip", slip, description=f"of the shaft to a field of {f:g} Hz"),
        ),
        description=f"induction machine, {2 * pole_pairs} poles, {len(cages)} cage{'s' if len(cages) != 1 else ''}",
    )  # fmt: skip


def _stator(R_s: float, L_s: float, L_m: float, L_0: float) -> tuple[Variable, Variable, Variable, Variable]:
    """The parameters of the stator, and the magnetising inductance."""
    return (
        parameter("R_s", R_s, unit="ohm", min=0.0, description="stator resistance"),
        parameter("L_s", L_s, unit="H", positive=True, description="stator leakage inductance"),
        parameter("L_m", L_m, unit="H", positive=True, description="magnetising inductance"),
        parameter("L_0", L_0, unit="H", positive=True, description="zero-sequence inductance"),
    )


def _ports(psi: Variable, p: Variable, v: float, torque: float) -> tuple[Port, Port]:
    """Terminal and shaft with their typical voltage [V] and torque [N.m]."""
    return (
        Port("terminal", ELECTRICAL, "effort", {psi: 1.0}, size=3, nominal=v, elements=PHASES,
             description="stator phases a, b, c; current into the machine"),
        Port("shaft", ROTATIONAL, "effort", {p: 1.0}, nominal=torque, description="a positive torque accelerates"),
    )  # fmt: skip


@dataclass(frozen=True)
class Cage:
    """A short-circuited rotor winding in alpha and beta: its parameters R and L (leakage), and its fluxes psi."""

    R: Variable
    L: Variable
    psi: Variable
    pole_pairs: int

    @classmethod
    def of(cls, number: int, R: float, L: float, flux: float, pole_pairs: int) -> Cage:
        """The cage with this number; `flux` [Wb]: typical flux."""
        return cls(
            parameter(f"R_{number}", R, unit="ohm", description=f"cage {number}"),
            parameter(f"L_{number}", L, unit="H", positive=True, description=f"leakage inductance of cage {number}"),
            state(f"psi_{number}", 2, unit="Wb", nominal=flux, description=f"fluxes of cage {number}, alpha and beta",
                  elements=("alpha", "beta")),
            pole_pairs,
        )  # fmt: skip

    @property
    def turned(self) -> ca.SX:
        """The rate of the fluxes for each rad/s of the shaft."""
        return self.pole_pairs * ca.vertcat(-self.psi[1], self.psi[0])

    @property
    def torque(self) -> ca.SX:
        """Torque of the cage on the shaft."""
        return -ca.dot(self.turned, self.psi.z)

    def speed_voltage(self, p: Variable) -> Block:
        """The skew block of J that turns the fluxes with the shaft and brakes the shaft with their torque."""
        both = ca.SX(3, 3)
        both[:2, 2], both[2, :2] = self.turned, -self.turned.T
        return block([self.psi, p], both)


def _magnetic(fluxes: Sequence[ca.SX], leakage: Sequence[ca.SX], mutual: ca.SX) -> ca.SX:
    """Energy of windings that share one magnetising flux: the least over it of what the leakages and L_m store.

    Written with the differences psi_k - psi_m, whose squares keep their digits where the leakages are small beside L_m.
    """
    inverse = [1 / x for x in leakage]
    common = sum(f * g for f, g in zip(fluxes, inverse, strict=True)) / (1 / mutual + sum(inverse))
    return sum(ca.sumsqr(f - common) * g / 2 for f, g in zip(fluxes, inverse, strict=True)) + ca.sumsqr(common) / (
        2 * mutual
    )


def _require(
    R_s: float, L_s: float, L_m: float, cages: Sequence[tuple[float, float]], J: float, pole_pairs: int
) -> None:
    """DeclarationError for values that no machine can have."""
    named = {"L_s": L_s, "L_m": L_m, "J": J} | {f"L_{k}": x for k, (_, x) in enumerate(cages, 1)}
    wrong = [f"{name} = {value:g} is not positive" for name, value in named.items() if not value > 0]
    named = {"R_s": R_s} | {f"R_{k}": r for k, (r, _) in enumerate(cages, 1)}
    wrong += [f"{name} = {value:g} ohm is negative" for name, value in named.items() if not value >= 0]
    if not cages:
        wrong.append("there is no cage")
    if not (isinstance(pole_pairs, int) and pole_pairs > 0):
        wrong.append(f"pole_pairs = {pole_pairs} is no positive integer")
    if wrong:
        raise DeclarationError("induction_machine", ", ".join(wrong), "give values referred to the stator, in SI units")
