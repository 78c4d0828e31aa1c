"""Expressions of the three-phase machine: Park matrix, inductances, magnetic energy, L(theta)."""

from __future__ import annotations

from dataclasses import dataclass
from math import cos, sin
from typing import Any

import casadi as ca

from phfmu import Variable, parameter
from phfmu.components.electrical.machines.machine_data import COUPLING, MachineData
from phfmu.components.electrical.machines.main_flux import NoLoadCurve
from phfmu.components.electrical.phases import ALPHA

#: names of the entries of three-phase quantities in the rotor's frame
ROTATING = ("d", "q", "0")


def park_matrix(theta: ca.SX) -> ca.SX:
    """Orthonormal Park matrix T(theta) (3 x 3), rows d, q, 0; q leads d by 90 degrees; T T^T = 1.

    The three angles theta - alpha share one sine and one cosine: they are most of a machine's cost.
    """
    k = (2.0 / 3.0) ** 0.5
    c, s = ca.cos(theta), ca.sin(theta)
    d = ca.horzcat(*(k * (cos(a) * c + sin(a) * s) for a in ALPHA))
    q = ca.horzcat(*(k * (sin(a) * c - cos(a) * s) for a in ALPHA))
    return ca.vertcat(d, q, ca.SX.ones(1, 3) / 3.0**0.5)


@dataclass(frozen=True)
class Inductances:
    """Inductances of a machine in H, as expressions of parameters.

    M: with each rotor winding;  rotor: (i, j) -> L_ij of two windings on one axis, i <= j;  `line`: inductance per phase
    in series with the stator; it adds to Ld, Lq and L0, because it is the same in all frames.  With saturation `leakage` is
    Ll, `curve` the no-load curve and `rated` [Wb] the main flux of its 1 in orthonormal coordinates.
    """

    Ld: ca.SX
    Lq: ca.SX
    L0: ca.SX
    M: tuple[ca.SX, ...]
    rotor: dict[tuple[int, int], ca.SX]
    axis: tuple[str, ...]
    line: ca.SX | None = None
    leakage: ca.SX | None = None
    curve: NoLoadCurve | None = None
    rated: float = 1.0

    @property
    def stator(self) -> tuple[ca.SX, ca.SX, ca.SX]:
        """Inductances d, q, 0 of the stator with what is in series."""
        line = ca.SX(0) if self.line is None else self.line
        return self.Ld + line, self.Lq + line, self.L0 + line

    def rotor_entry(self, i: int, j: int) -> ca.SX:
        """L_ij of rotor windings i and j; 0 across the axes."""
        v = self.rotor.get((min(i, j), max(i, j)))
        return ca.SX(0) if v is None else v

    def axis_block(self, axis: str) -> tuple[list[int], ca.SX]:
        """Positions in (d, q, 0, rotor) of the windings on `axis` and their inductance matrix."""
        rotor = [j for j, a in enumerate(self.axis) if a == axis]
        L = ca.SX(1 + len(rotor), 1 + len(rotor))
        L[0, 0] = self.stator[0 if axis == "d" else 1]
        for a, i in enumerate(rotor):
            L[0, 1 + a] = L[1 + a, 0] = COUPLING * self.M[i]
            for b, j in enumerate(rotor):
                L[1 + a, 1 + b] = self.rotor_entry(i, j)
        return [0 if axis == "d" else 1, *(3 + j for j in rotor)], L


@dataclass(frozen=True)
class Windings:
    """Stator resistance Ra and resistances R of the rotor windings [ohm], inductances: expressions of `parameters`."""

    Ra: ca.SX
    R: tuple[ca.SX, ...]
    L: Inductances
    parameters: tuple[Variable, ...]


def circuit_windings(data: MachineData, line: Variable | None = None) -> Windings:
    """Parameters Ra, R_f, .., Ld, Lq, L0, M_f, .., L_ff, .. with the values of `data`; `line`: inductance in series."""
    names = data.windings
    Ra = parameter("Ra", data.Ra, unit="ohm", min=0.0, description="stator resistance")
    R = [
        parameter(f"R_{n}", r, unit="ohm", description=f"resistance of winding {n}")
        for n, r in zip(names, data.R_rotor, strict=True)
    ]
    Ld = parameter("Ld", data.Ld, unit="H", positive=True, description="synchronous inductance, d axis")
    Lq = parameter("Lq", data.Lq, unit="H", positive=True, description="synchronous inductance, q axis")
    L0 = parameter("L0", data.L0, unit="H", positive=True, description="zero-sequence inductance")
    M = [
        parameter(f"M_{n}", m, unit="H", description=f"peak mutual inductance of a phase with winding {n}")
        for n, m in zip(names, data.M_stator_rotor, strict=True)
    ]
    rotor = {
        (i, j): parameter(
            f"L_{names[i]}{names[j]}", data.L_rotor[i][j], unit="H", positive=i == j, description="rotor inductance"
        )
        for i, j in rotor_pairs(data)
    }
    leakage = None
    if data.saturation is not None and data.Ll is not None:
        leakage = parameter("Ll", data.Ll, unit="H", positive=True, description="leakage inductance of the stator")
    expressions = {
        "Ld": Ld.sx, "Lq": Lq.sx, "L0": L0.sx, "M": tuple(m.sx for m in M), "rotor": {k: v.sx for k, v in rotor.items()},
        "leakage": None if leakage is None else leakage.sx,
    }  # fmt: skip
    L, iron = inductances(data, line, **expressions)
    own = (Ra, *R, Ld, Lq, L0, *M, *rotor.values(), *(() if line is None else (line,)))
    return Windings(Ra.sx, tuple(r.sx for r in R), L, (*own, *(() if leakage is None else (leakage, *iron))))


def rotor_pairs(data: MachineData) -> list[tuple[int, int]]:
    """Rotor windings i <= j on one axis."""
    n = len(data.axis)
    return [(i, j) for i in range(n) for j in range(i, n) if data.axis[i] == data.axis[j]]


def inductances(
    data: MachineData, line: Variable | None, *, leakage: ca.SX | None, **own: Any
) -> tuple[Inductances, tuple[Variable, ...]]:
    """Expressions Ld, Lq, L0, M, rotor with what is in series and the iron of `data`; parameters of its curve."""
    series = None if line is None else line.sx
    if data.saturation is None:
        return Inductances(axis=data.axis, line=series, **own), ()
    curve, rated = data.saturation.curve(), data.Vn_rms_ll / data.omega
    return Inductances(axis=data.axis, line=series, leakage=leakage, curve=curve, rated=rated, **own), curve.parameters


def magnetic_energy(flux: ca.SX, L: Inductances) -> ca.SX:
    """H = 1/2 psi^T Lhat^-1 psi for fluxes (d, q, 0, rotor).

    Per axis: sum y_k^2 / (2 D_k) with the factors L = M D M^T, psi = M y.
    """
    total = flux[2] ** 2 / (2 * L.stator[2])
    for axis in ("d", "q"):
        where, block = L.axis_block(axis)
        (y,), pivots = _eliminated(block, [flux[i] for i in where])
        total += sum(x**2 / (2 * d) for x, d in zip(y, pivots, strict=True))
    return total


def _eliminated(block: ca.SX, *columns: list[ca.SX]) -> tuple[list[list[ca.SX]], list[ca.SX]]:
    """The columns M^-1 x and the pivots D of a symmetric block M D M^T."""
    work, out, n = ca.SX(block), [list(c) for c in columns], block.shape[0]
    for k in range(n):
        for i in range(k + 1, n):
            factor = work[i, k] / work[k, k]
            for y in out:
                y[i] = y[i] - factor * y[k]
            for j in range(k + 1, n):
                work[i, j] = work[i, j] - factor * work[k, j]
    return out, [work[k, k] for k in range(n)]


def main_flux(flux: ca.SX, L: Inductances) -> tuple[list[ca.SX], list[ca.SX], ca.SX]:
    """Main fluxes (d, q) of the linear machine with the fluxes (d, q, 0, rotor), in per unit; their stiffnesses; energy base.

    With the leakages Lambda and the turns n of an axis:  c = 1/Lm + n^T Lambda^-1 n,  mu = n^T Lambda^-1 psi/c,  c in 1/Lmd.
    """
    assert L.leakage is not None
    mu, stiffness = [], []
    Lmd = L.Ld - L.leakage
    for axis in ("d", "q"):
        where, block = L.axis_block(axis)
        Lm = (L.Ld if axis == "d" else L.Lq) - L.leakage
        turns = [ca.SX(1), *(COUPLING * L.M[i - 3] / Lm for i in where[1:])]
        leakages = ca.SX(block)
        for i, a in enumerate(turns):
            for j, b in enumerate(turns):
                leakages[i, j] = block[i, j] - Lm * a * b if i and j else 0
        leakages[0, 0] = block[0, 0] - Lm
        (y, n), pivots = _eliminated(leakages, [flux[i] for i in where], turns)
        c = 1 / Lm + sum(a**2 / d for a, d in zip(n, pivots, strict=True))
        mu.append(sum(a * x / d for a, x, d in zip(n, y, pivots, strict=True)) / (c * L.rated))
        stiffness.append(c * Lmd)
    return mu, stiffness, L.rated**2 / Lmd


def saturation_energy(flux: ca.SX, L: Inductances) -> ca.SX | None:
    """Energy of a saturated machine with the fluxes (d, q, 0, rotor) beyond `magnetic_energy`; None for a linear one."""
    if L.curve is None:
        return None
    mu, stiffness, base = main_flux(flux, L)
    axes = 2 if L.curve.data.axes == "dq" else 1
    return base * L.curve.excess(mu[:axes], stiffness[:axes])


def phase_inductance(theta: ca.SX, L: Inductances) -> tuple[ca.SX, ca.SX, ca.SX]:
    """L(theta) = constant + first + second harmonic (n x n each), order a, b, c, rotor."""
    n = 3 + len(L.axis)
    constant, first, second = (ca.SX(n, n) for _ in range(3))
    Ld, Lq, L0 = L.stator
    mean, saliency = (Ld + Lq) / 2, (Ld - Lq) / 3
    mutual = (mean - L0) / 3
    for i, a in enumerate(ALPHA):
        for j, b in enumerate(ALPHA):
            constant[i, j] = mean - mutual if i == j else -mutual
            second[i, j] = saliency * ca.cos(2 * theta - a - b)
        for j, axis in enumerate(L.axis):
            m = L.M[j] * (ca.cos(theta - a) if axis == "d" else -ca.sin(theta - a))
            first[i, 3 + j] = first[3 + j, i] = m
    for (i, j), v in L.rotor.items():
        constant[3 + i, 3 + j] = constant[3 + j, 3 + i] = v
    return constant, first, second


def sinc(x: ca.SX) -> ca.SX:
    """sin(x)/x, with its Taylor polynomial for |x| < 0.05 (error below 1e-20); all derivatives are finite."""
    small = ca.fabs(x) < 0.05
    safe = ca.if_else(small, 1.0, x)
    s = x * x
    series = 1 - s / 6 * (1 - s / 20 * (1 - s / 42 * (1 - s / 72)))
    return ca.if_else(small, series, ca.sin(safe) / safe)
