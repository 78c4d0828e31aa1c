"""Expressions of the three-phase machine: Park matrix, inductances, magnetic energy, L(theta)."""

from __future__ import annotations

from dataclasses import dataclass
from math import cos, sin

import casadi as ca

from phfmu import Variable, parameter
from phfmu.components.electrical.machines.machine_data import COUPLING, MachineData
from phfmu.components.electrical.machines.main_flux import Curve
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
    """Inductances of a machine as parameters, named Ld, Lq, L0, M_f, .., L_ff, L_fkd, ..

    M: with each rotor winding; rotor: (i, j) -> L_ij of two windings on one axis, i <= j.  `line`: inductance per phase
    in series with the stator; it adds to Ld, Lq and L0, because it is the same in all frames.  With saturation `leakage` is
    Ll, `curve` the no-load curve and `rated` [Wb] the main flux of its 1 in orthonormal coordinates.
    """

    Ld: Variable
    Lq: Variable
    L0: Variable
    M: tuple[Variable, ...]
    rotor: dict[tuple[int, int], Variable]
    axis: tuple[str, ...]
    line: Variable | None = None
    leakage: Variable | None = None
    curve: Curve | None = None
    rated: float = 1.0

    @property
    def parameters(self) -> tuple[Variable, ...]:
        iron = () if self.curve is None or self.leakage is None else (self.leakage, *self.curve.parameters)
        series = () if self.line is None else (self.line,)
        return (self.Ld, self.Lq, self.L0, *self.M, *self.rotor.values(), *series, *iron)

    @property
    def stator(self) -> tuple[ca.SX, ca.SX, ca.SX]:
        """Inductances d, q, 0 of the stator with what is in series."""
        line = ca.SX(0) if self.line is None else self.line.sx
        return self.Ld + line, self.Lq + line, self.L0 + line

    def rotor_entry(self, i: int, j: int) -> ca.SX:
        """L_ij of rotor windings i and j; 0 across the axes."""
        v = self.rotor.get((min(i, j), max(i, j)))
        return ca.SX(0) if v is None else v.sx

    def axis_block(self, axis: str) -> tuple[list[int], ca.SX]:
        """Positions in (d, q, 0, rotor) of the windings on `axis` and their inductance matrix."""
        rotor = [j for j, a in enumerate(self.axis) if a == axis]
        L = ca.SX(1 + len(rotor), 1 + len(rotor))
        L[0, 0] = self.stator[0 if axis == "d" else 1]
        for a, i in enumerate(rotor):
            L[0, 1 + a] = L[1 + a, 0] = COUPLING * self.M[i].sx
            for b, j in enumerate(rotor):
                L[1 + a, 1 + b] = self.rotor_entry(i, j)
        return [0 if axis == "d" else 1, *(3 + j for j in rotor)], L


def inductances(data: MachineData, line: Variable | None = None) -> Inductances:
    """Parameters with the values of `data`; `line`: inductance in series with the stator."""
    names = data.windings
    same = [(i, j) for i in range(len(names)) for j in range(i, len(names)) if data.axis[i] == data.axis[j]]
    return Inductances(
        parameter("Ld", data.Ld, unit="H", positive=True, description="synchronous inductance, d axis"),
        parameter("Lq", data.Lq, unit="H", positive=True, description="synchronous inductance, q axis"),
        parameter("L0", data.L0, unit="H", positive=True, description="zero-sequence inductance"),
        tuple(
            parameter(f"M_{n}", m, unit="H", description=f"peak mutual inductance of a phase with winding {n}")
            for n, m in zip(names, data.M_stator_rotor, strict=True)
        ),
        {
            (i, j): parameter(
                f"L_{names[i]}{names[j]}", data.L_rotor[i][j], unit="H", positive=i == j, description="rotor inductance"
            )
            for i, j in same
        },
        data.axis,
        line,
        *_iron(data),
    )


def _iron(data: MachineData) -> tuple[Variable | None, Curve | None, float]:
    """Leakage, no-load curve and rated main flux of a machine that saturates."""
    if data.saturation is None or data.Ll is None:
        return None, None, 1.0
    leakage = parameter("Ll", data.Ll, unit="H", positive=True, description="leakage inductance of the stator")
    return leakage, data.saturation.curve(), data.Vn_rms_ll / data.omega


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
    Lmd = L.Ld - L.leakage.sx
    for axis in ("d", "q"):
        where, block = L.axis_block(axis)
        Lm = (L.Ld if axis == "d" else L.Lq) - L.leakage.sx
        turns = [ca.SX(1), *(COUPLING * L.M[i - 3].sx / Lm for i in where[1:])]
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
    """What a saturated machine with the fluxes (d, q, 0, rotor) stores beyond `magnetic_energy`; None for a linear one."""
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
            m = L.M[j].sx * (ca.cos(theta - a) if axis == "d" else -ca.sin(theta - a))
            first[i, 3 + j] = first[3 + j, i] = m
    for (i, j), v in L.rotor.items():
        constant[3 + i, 3 + j] = constant[3 + j, 3 + i] = v.sx
    return constant, first, second


def sinc(x: ca.SX) -> ca.SX:
    """sin(x)/x, with its Taylor polynomial for |x| < 0.05 (error below 1e-20); all derivatives are finite."""
    small = ca.fabs(x) < 0.05
    safe = ca.if_else(small, 1.0, x)
    s = x * x
    series = 1 - s / 6 * (1 - s / 20 * (1 - s / 42 * (1 - s / 72)))
    return ca.if_else(small, series, ca.sin(safe) / safe)
