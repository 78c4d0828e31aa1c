"""Data sets of synchronous machines: built-in sets by name, checks, and the constant inductance matrix.

L(theta) = T(theta)^T Lhat T(theta) with the orthonormal Park matrix T on the stator, so L is positive
definite at every angle if and only if the constant matrix Lhat (rows d, q, 0, rotor windings) is.
"""

from __future__ import annotations

import json
from collections.abc import Mapping
from dataclasses import MISSING, asdict, dataclass, fields
from functools import lru_cache
from importlib.resources import files
from math import isclose, pi, sqrt
from typing import Any

import numpy as np
from numpy.typing import NDArray

from phfmu import Problem, Refusal, meant
from phfmu.components.electrical.machines.main_flux import Saturation

#: Peak stator-rotor mutual inductances M act as sqrt(3/2) M in orthonormal dq coordinates.
COUPLING = sqrt(1.5)
SINGULAR = 1e-12  # smallest eigenvalue over largest below which a block counts as singular


#: what is wrong, and the remedy
Wrong = tuple[str, str]


class MachineDataError(Refusal):
    """Data that no machine can have: every problem with its remedy."""


@dataclass(frozen=True)
class MachineData:
    """One synchronous machine in SI units, three stator phases and any number of rotor windings.

    Sn [VA], Vn_rms_ll [V], fn [Hz]: ratings.  Ra, R_rotor [ohm].  axis: 'd' or 'q' per rotor winding, the
    first is the field winding.  Ld, Lq, L0 [H]: synchronous and zero-sequence inductances.  M_stator_rotor
    [H]: peak mutual inductance of a phase with each rotor winding.  L_rotor [H]: rotor matrix.  J [kg m2],
    d [N m s/rad]: electrical (one pole pair) unless pole_pairs is given; then mechanical.
    Ll [H]: leakage of the stator, which tells the main flux;  saturation: of it, None for a linear machine; it needs Ll.
    """

    name: str
    Sn: float
    Vn_rms_ll: float
    fn: float
    Ra: float
    R_rotor: tuple[float, ...]
    axis: tuple[str, ...]
    Ld: float
    Lq: float
    L0: float
    M_stator_rotor: tuple[float, ...]
    L_rotor: tuple[tuple[float, ...], ...]
    J: float
    d: float = 0.0
    pole_pairs: int = 1
    Ll: float | None = None
    saturation: Saturation | None = None

    @property
    def omega(self) -> float:
        """Rated electrical angular frequency in rad/s."""
        return 2.0 * pi * self.fn

    @property
    def elements(self) -> tuple[str, ...]:
        """Names of the rotor windings beside those of the stator: the field is fd."""
        return tuple("fd" if n == "f" else n for n in self.windings)

    @property
    def n(self) -> int:
        """Number of windings, stator and rotor."""
        return 3 + len(self.axis)

    @property
    def J_electrical(self) -> float:
        """J/pole_pairs^2: the inertia seen by the electrical angle."""
        return self.J / self.pole_pairs**2

    @property
    def d_electrical(self) -> float:
        """d/pole_pairs^2: the friction seen by the electrical speed."""
        return self.d / self.pole_pairs**2

    @property
    def windings(self) -> tuple[str, ...]:
        """Names of the rotor windings: f, kd, kd2, .. on d and kq, kq2, .. on q."""
        names, count = [], {"d": 0, "q": 0}
        for axis in self.axis:
            count[axis] += 1
            number = count[axis] - (axis == "d")
            names.append(f"k{axis}{number if number > 1 else ''}" if number else "f")
        return tuple(names)

    def on_axis(self, axis: str) -> list[int]:
        """Positions of the rotor windings on one axis."""
        return [j for j, a in enumerate(self.axis) if a == axis]

    def constant_inductance(self) -> NDArray[np.float64]:
        """Lhat (n x n) in H: rows d, q, 0, then the rotor windings."""
        L = np.zeros((self.n, self.n))
        L[:3, :3] = np.diag([self.Ld, self.Lq, self.L0])
        L[3:, 3:] = self.L_rotor
        for j, (axis, m) in enumerate(zip(self.axis, self.M_stator_rotor, strict=True)):
            row = 0 if axis == "d" else 1
            L[row, 3 + j] = L[3 + j, row] = COUPLING * m
        return L


@lru_cache(maxsize=1)
def _file() -> dict[str, dict[str, Any]]:
    sets = json.loads(files("phfmu.components.electrical.machines").joinpath("machines.json").read_text())
    return {name: entry for name, entry in sets.items() if isinstance(entry, dict)}


def machine_names() -> list[str]:
    """Names of the built-in sets."""
    return sorted(_file())


def machine_set(machine: str | Mapping[str, Any] | MachineData, **changes: Any) -> MachineData:
    """A checked data set: a built-in name, a mapping of `MachineData` entries or a set, with `changes`.

    `pu` and `H` [s] of a data file may stand beside the entries; H must agree with J.
    Stator inductances are (Ld, Lq, L0), or (Laa0, Laa2, Lab0) of L_aa = Laa0 + Laa2 cos 2 theta,
    L_ab = -Lab0 + Laa2 cos(2 theta - 2 pi/3): Ld, Lq = Laa0 + Lab0 +- 1.5 Laa2, L0 = Laa0 - 2 Lab0.
    MachineDataError lists every entry that is missing, unknown, given twice or impossible.
    """
    if isinstance(machine, str):
        if machine not in _file():
            hint = f"{meant(machine, machine_names())}; or give a mapping of its entries"
            raise MachineDataError("machines", f"no machine set '{machine}'", hint)
        machine = _file()[machine]
    base = asdict(machine) if isinstance(machine, MachineData) else dict(machine)
    known = {f.name: f for f in fields(MachineData)}
    problems = [*_unknown(base, known), *_unknown(changes, known), *_twice(base), *_twice(changes)]
    entries = {**_stator(base), **_stator(changes)}
    missing = [k for k, f in known.items() if f.default is MISSING and k not in entries]
    if missing:
        problems.append((f"missing: {', '.join(missing)}", "give them; Ld, Lq, L0 also as Laa0, Laa2, Lab0"))
    data = None
    if "H" in changes:
        problems.append(("H cannot be changed, it follows from J = 2 H Sn / omega^2", "give J"))
    if not problems:
        data = MachineData(**{k: _plain(v) for k, v in entries.items() if k in known})
        problems = machine_problems(data) or _inertia(data, base)
    if problems or data is None:
        entry = f"machine set '{entries.get('name', '?')}'"
        raise MachineDataError.of([Problem("", entry, *problem) for problem in problems])
    return data


def _stator(entries: Mapping[str, Any]) -> dict[str, Any]:
    """Entries with Ld, Lq, L0; computed from Laa0, Laa2, Lab0 where only these are there."""
    out = dict(entries)
    if all(k in out for k in ("Laa0", "Laa2", "Lab0")):
        a0, a2, b0 = (float(out.pop(k)) for k in ("Laa0", "Laa2", "Lab0"))
        out = {"Ld": a0 + b0 + 1.5 * a2, "Lq": a0 + b0 - 1.5 * a2, "L0": a0 - 2.0 * b0} | out
    return out


#: two ways to give the stator inductances
PHASES, AXES = ("Laa0", "Laa2", "Lab0"), ("Ld", "Lq", "L0")
#: entries of data files that a set has no use for: per-unit values for the reader, the inertia constant in s beside J
BESIDE = ("pu", "H")


def _unknown(entries: Mapping[str, Any], known: Mapping[str, Any]) -> list[Wrong]:
    """Entries that would be ignored: names that nobody knows, and some of Laa0, Laa2, Lab0 without the others."""
    names = [*known, *PHASES, *BESIDE]
    out = [(f"unknown entry '{k}'", meant(k, names)) for k in entries if k not in names]
    given = [k for k in PHASES if k in entries]
    if 0 < len(given) < len(PHASES):
        lacks = ", ".join(k for k in PHASES if k not in given)
        out.append((f"{', '.join(given)} without {lacks}", "give all three: they give Ld, Lq, L0 together"))
    return out


def _twice(entries: Mapping[str, Any]) -> list[Wrong]:
    """Ld, Lq or L0 beside what they would be computed from, where the two differ."""
    if not all(k in entries for k in PHASES):
        return []
    computed = _stator({k: entries[k] for k in PHASES})
    return [
        (f"{k} = {float(entries[k]):.9g} H, but {', '.join(PHASES)} give {computed[k]:.9g} H", "leave one of them out")
        for k in AXES
        if k in entries and not isclose(float(entries[k]), computed[k], rel_tol=1e-6)
    ]


def _inertia(data: MachineData, base: Mapping[str, Any]) -> list[Wrong]:
    """H = J omega^2 / (2 Sn) of a mapping that gives both; nothing if J or a rating was changed."""
    if "H" not in base or "J" not in base:
        return []
    own = data.J_electrical * data.omega**2 / (2.0 * data.Sn)
    changed = any(float(base.get(k, v)) != v for k, v in (("J", data.J), ("Sn", data.Sn), ("fn", data.fn)))
    if changed or isclose(float(base["H"]), own, rel_tol=1e-2):
        return []
    return [(f"H = {float(base['H']):.6g} s, but J gives {own:.6g} s", "leave one of them out")]


def _plain(value: Any) -> Any:
    """Nested sequences as tuples, so that a set is frozen; numbers as float."""
    if isinstance(value, (list, tuple, np.ndarray)):
        return tuple(_plain(v) for v in value)
    if isinstance(value, Mapping):
        return Saturation(**{k: _plain(v) for k, v in value.items()})
    return value if value is None or isinstance(value, (str, int, Saturation)) else float(value)


def machine_problems(data: MachineData) -> list[Wrong]:
    """Everything that makes `data` impossible, each with its remedy; empty if it is sound."""
    problems = _sizes(data)
    return problems or [*_signs(data), *_definite(data)] or _saturation(data)


def _sizes(data: MachineData) -> list[Wrong]:
    m = len(data.axis)
    out: list[Wrong] = []
    if m == 0:
        return [("axis is empty", "a synchronous machine has at least the field winding: axis = ['d']")]
    if any(a not in ("d", "q") for a in data.axis):
        return [(f"axis = {list(data.axis)}", "put every rotor winding on 'd' or on 'q'")]
    if data.axis[0] != "d":
        out.append(("axis starts with 'q'", "list the field winding first: it lies on 'd'"))
    for name in ("R_rotor", "M_stator_rotor"):
        found = len(getattr(data, name))
        if found != m:
            out.append((f"{name} has {found} entries for {m} rotor windings (axis)", "give one for each winding"))
    if len(data.L_rotor) != m or any(np.size(row) != m for row in data.L_rotor):
        sizes = [np.size(row) for row in data.L_rotor]
        out.append(
            (f"L_rotor has rows of {sizes} entries, expected {m} x {m}", "give a row and a column for each winding")
        )
    if not isinstance(data.pole_pairs, int) or data.pole_pairs < 1:
        out.append((f"pole_pairs = {data.pole_pairs}", "give a positive integer"))
    return out


def _signs(data: MachineData) -> list[Wrong]:
    out = []
    for name in ("Sn", "Vn_rms_ll", "fn", "J"):
        value = getattr(data, name)
        if not (value > 0 and np.isfinite(value)):
            hint = "; without inertia p is no state" if name == "J" else ""
            out.append((f"{name} = {value} must be positive", f"give a positive number{hint}"))
    for name, value in [
        ("Ra", data.Ra),
        ("d", data.d),
        *((f"R_rotor[{j + 1}]", r) for j, r in enumerate(data.R_rotor)),
    ]:
        if not (value >= 0 and np.isfinite(value)):
            out.append((f"{name} = {value} must not be negative", "give one from 0: a negative one creates energy"))
    return out


def _definite(data: MachineData) -> list[Wrong]:
    L = data.constant_inductance()
    out: list[Wrong] = []
    if not np.isfinite(L).all():
        return [("an inductance is not finite", "give finite numbers")]
    rotor = L[3:, 3:]
    if np.max(np.abs(rotor - rotor.T)) > 1e-12 * np.max(np.abs(rotor)):
        out.append(("L_rotor is not symmetric", "give each mutual inductance once on each side of the diagonal"))
    across = [(i, j) for i in data.on_axis("d") for j in data.on_axis("q") if rotor[i, j] or rotor[j, i]]
    out += [
        (f"L_rotor[{i + 1},{j + 1}] couples a d with a q winding", "make it 0: the axes are orthogonal")
        for i, j in across
    ]
    if not data.L0 > SINGULAR * max(abs(data.Ld), abs(data.Lq)):
        out.append(
            (
                f"L0 = {data.L0:.6g} H makes L singular (L0 = Laa0 - 2 Lab0; book data often have Lab0 = Laa0/2)",
                "give L0 > 0, e.g. the stator leakage inductance",
            )
        )
    for axis, row in (("d", 0), ("q", 1)):
        where = [row, *(3 + j for j in data.on_axis(axis))]
        values = np.linalg.eigvalsh(L[np.ix_(where, where)])
        if not values[0] > SINGULAR * values[-1]:
            names = ", ".join([f"L{axis}", *(data.windings[j - 3] for j in where[1:])])
            out.append(
                (
                    f"the {axis}-axis block of L ({names}) is not positive definite (eigenvalues "
                    f"{values[0]:.3g} .. {values[-1]:.3g} H): a mutual inductance is too large for its self inductances",
                    f"check M_stator_rotor, L_rotor and L{axis}",
                )
            )
    return out


def _saturation(data: MachineData) -> list[Wrong]:
    """Problems that keep the main flux from saturating: no leakage, leakages that are negative, a curve that is not convex."""
    if data.saturation is None:
        return []
    if data.Ll is None:
        return [("saturation without Ll", "give the leakage Ll [H] of the stator: the main flux is what it leaves")]
    if not 0 < data.Ll < min(data.Ld, data.Lq):
        smaller = min(data.Ld, data.Lq)
        return [
            (f"Ll = {data.Ll:g} H is not between 0 and min(Ld, Lq) = {smaller:g} H", "give the stator's leakage in H")
        ]
    out = data.saturation.problems()
    for axis, L in (("d", data.Ld), ("q", data.Lq)):
        where = data.on_axis(axis)
        M = COUPLING * np.array([data.M_stator_rotor[j] for j in where])
        leakage = np.array(data.L_rotor)[np.ix_(where, where)] - np.outer(M, M) / (L - data.Ll)
        values = np.linalg.eigvalsh(leakage) if where else np.ones(1)
        if not values[0] > 0:
            text = (
                f"Ll = {data.Ll:g} H leaves the rotor windings on {axis} leakages with the eigenvalue {values[0]:.3g} H: the "
                "energy is not convex in the main flux"
            )
            out.append((text, "give the leakage that belongs to M_stator_rotor and L_rotor"))
    return out
