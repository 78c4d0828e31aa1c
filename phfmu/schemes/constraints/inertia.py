"""Masses of the velocities that constraints act on, for the two-level form.

A velocity is light if its mass is 0, or at most `LIGHT` times the largest and fixed by the constraints: dividing by
its mass would lose the solution to rounding.  Its shift is an unknown of its own.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from enum import Enum

import casadi as ca
import numpy as np
from numpy.typing import NDArray

from phfmu.declare.error import DeclarationError
from phfmu.declare.variable import ValueKind
from phfmu.gradients.quadrature import Nodes
from phfmu.plan.address import Address, costate_row, increment, own_costate, row
from phfmu.plan.spec import Arguments, Spec
from phfmu.terms.port_impulses import mass_values
from phfmu.terms.rank import constraint_jacobian, null_vectors
from phfmu.terms.term import CONSTRAINT, EMPTY, ENERGY, JOINT, MASS, Term, Terms
from phfmu.terms.velocities import velocity_of

#: ratio of masses below which one is light: the smallest moments of bodies of robots published nearly without mass are 4e-6
LIGHT = 5e-6
#: ratio of masses from which on constraint forces swing the lighter ones faster than steps that suit the heavier ones
UNEVEN = 1e3
#: ratio of masses from which on the rounding of forces moves the lighter ones
VANISHING = 1e12


class Weight(Enum):
    """The form of a mass term of velocities that constraints act on."""

    LIGHT = "light"


def prepare(terms: Terms) -> Terms:
    """Give every constraint the masses of its velocities and mark the light ones.

    DeclarationError where the form M v' = .., z_v = v is absent, or M is singular on ker Dg.
    """
    constraints, velocity = terms.of(CONSTRAINT), velocity_of(terms)
    shifted = sorted({velocity[q] for t in constraints for q in t.index[ValueKind.STATE]})
    mass = {t.rows[0].index: t for t in terms.of(MASS)}
    require_velocities(terms, shifted)
    light = light_velocities(terms, shifted, mass)
    new = []
    known: dict[tuple, Term] = {}
    for t in terms.terms:
        if t.kind is CONSTRAINT:
            velocities = [velocity[q] for q in t.index[ValueKind.STATE]]
            t = _with_masses(t, [mass.get(v) for v in velocities], np.array([v in light for v in velocities]), known)
        elif t.kind is MASS and t.rows[0].index in light:
            t = replace(t, key=(Weight.LIGHT, t.key), form=Weight.LIGHT)
        new.append(t)
    return replace(terms, terms=new)


def uneven(terms: Terms) -> bool:
    """True if the masses of the velocities that constraints act on, light ones aside, are UNEVEN."""
    values = [m for m in _acted_on(terms, [t for t in terms.of(MASS) if not is_light(t)]) if m > 0]
    return bool(values) and max(values) >= UNEVEN * min(values)


def vanishing(terms: Terms) -> bool:
    """True if one of the masses of the velocities that constraints act on is VANISHING beside another."""
    values = _acted_on(terms, terms.of(MASS))
    return bool(values) and max(values) >= VANISHING * min(values)


def _acted_on(terms: Terms, kept: Sequence[Term]) -> list[float]:
    """Masses of the velocities that constraints act on: those of the mass terms `kept`, and 1 where there is none."""
    velocity = velocity_of(terms)
    shifted = {velocity[q] for t in terms.of(CONSTRAINT) for q in t.index[ValueKind.STATE] if q in velocity}
    unit = shifted - {t.rows[0].index for t in terms.of(MASS)} - set(terms.solved_costates())
    values = mass_values(terms, [t for t in kept if t.rows[0].index in shifted]).values()
    return [*values, *([1.0] if unit else [])]


def _with_masses(term: Term, masses: list[Term | None], light: NDArray[np.bool_], known: dict[tuple, Term]) -> Term:
    """The constraint with the mass expressions as data, its parameters extended by theirs (None = unit mass).

    `known`: by key, what its expressions are, so that they are made once per kind.
    """
    key = ("masses", term.key, tuple(None if m is None else m.key for m in masses), tuple(light.tolist()))
    if key not in known:
        symbols, data = [term.symbols(ValueKind.PARAMETER)], []
        for m in masses:
            local = EMPTY if m is None else m.symbols(ValueKind.PARAMETER)
            fresh = ca.SX.sym("p", local.numel())
            value = ca.SX(1) if m is None else m.data["m"]
            data.append(ca.substitute([value], [local], [fresh])[0] if local.numel() else value)
            symbols.append(fresh)
        p = ca.vertcat(*symbols)
        local = term.local | ({ValueKind.PARAMETER: p} if p.numel() else {})
        known[key] = replace(term, key=key, local=local, data=term.data | {"mass": data, "light": light})
    index = [
        *term.indices(ValueKind.PARAMETER),
        *(i for m in masses if m is not None for i in m.indices(ValueKind.PARAMETER)),
    ]
    return replace(known[key], rows=term.rows, owner=term.owner, index=term.index | {ValueKind.PARAMETER: tuple(index)})


def is_light(term: Term) -> bool:
    """True if a mass is that of a light velocity."""
    return term.form is Weight.LIGHT


def light(terms: Terms) -> list[int]:
    """The light velocities: their costates are unknowns."""
    return sorted(t.rows[0].index for t in terms.of(MASS) if is_light(t))


def specs(term: Term, nd: Nodes) -> list[Spec]:
    """Rows of a light velocity: m D_i as ever; for its costates equal increments, and its shift in the mean,

    sum_i b_i m (z_i - v_i) = sum_i b_i S_i^T mu.
    """
    args = Arguments(term, nd.k)
    d, v, z, m = args.matrix(increment, 1), term.local[ValueKind.STATE], args.matrix(own_costate, 1), term.data["m"]
    shift = sum((nd.b[i] * (z[i] - v - ca.mtimes(d, ca.DM(nd.a[i]))) for i in range(nd.k)), ca.SX(0))
    out = [(Address(row, 0, i), 0, m * d[i]) for i in range(nd.k)]
    out += [(Address(costate_row, 0, i), 0, d[i + 1] - d[i]) for i in range(nd.k - 1)]
    out.append((Address(costate_row, 0, nd.k - 1), 0, m * shift))
    return [Spec(1, v, args.p, args.y, out)]


def light_velocities(terms: Terms, shifted: list[int], mass: dict[int, Term]) -> set[int]:
    """The light ones of the velocities `shifted`; DeclarationError if a massless direction is not constrained."""
    value = dict.fromkeys(shifted, 1.0) | mass_values(terms, list(mass.values()))
    names = [n for v in terms.model.states for n in v.names()]
    negative = [names[v] for v, m in value.items() if not m >= 0]
    if negative:
        raise DeclarationError(
            terms.model.name, f"the mass of {', '.join(negative[:6])} is negative", "give it one from 0", "mass"
        )
    largest = max(value[v] for v in shifted) if shifted else 1.0
    light = [v for v in shifted if value[v] <= LIGHT * largest]
    massless = [v for v, m in value.items() if m == 0.0]
    if not light and not massless:
        return set()
    jacobian = constraint_jacobian(terms)
    free = null_vectors(jacobian[:, massless].toarray())
    if free.shape[1]:
        entries = sorted(range(len(massless)), key=lambda i: -abs(free[i, 0]))
        vector = ", ".join(f"{names[massless[i]]} = {free[i, 0]:.3g}" for i in entries[:6] if abs(free[i, 0]) > 1e-6)
        raise DeclarationError(
            terms.model.name,
            f"M is singular on ker Dg: the direction {vector} has no mass and no constraint at the start",
            "give it a mass, or constrain it",
            "mass",
        )
    return set(light if not null_vectors(jacobian[:, light].toarray()).shape[1] else massless)


def require_velocities(terms: Terms, shifted: list[int]) -> None:
    """Raise DeclarationError unless the costate of every state in `shifted` is that state (kinetic energy with diagonal M)."""
    p, good = _parameters(terms), dict.fromkeys(shifted, 0)
    rng = np.random.default_rng(1)
    known: dict[tuple, NDArray[np.bool_]] = {}
    for t in terms.of(ENERGY, JOINT):
        for j, i in enumerate(r.index for r in t.rows):
            if i in good:
                if t.kind is JOINT:  # all energies in one: judged by the scheme's own gradient
                    good[i] += 1
                    continue
                if t.key not in known:
                    known[t.key] = _is_velocity(t, p, rng)
                good[i] += 1 if known[t.key][j] else 2
    names = [n for v in terms.model.states for n in v.names()]
    solved = terms.solved_costates()
    for v, count in good.items():
        if count != 1 or v in solved:
            raise DeclarationError(
                terms.model.name,
                "the two-level scheme needs velocities as states (M v' = ..., z = v) with a diagonal M; "
                f"'{names[v]}' is not one",
                "use --scheme semi-explicit",
                "velocity",
            )


def _is_velocity(t: Term, p: NDArray[np.float64], rng: np.random.Generator) -> NDArray[np.bool_]:
    """Per state of an energy term: its costate is the state itself."""
    x = t.local[ValueKind.STATE]
    if "z" not in t.data:
        return np.zeros(x.numel(), bool)
    f = ca.Function("z", [x, t.symbols(ValueKind.PARAMETER)], [ca.densify(t.data["z"])])
    at = rng.standard_normal(x.numel())
    z = np.array(f(at, p[list(t.indices(ValueKind.PARAMETER))])).ravel()
    return np.abs(z - at) <= 1e-9 * (1 + np.abs(at))


def _parameters(terms: Terms) -> NDArray[np.float64]:
    return np.array([s for v in terms.model.parameters for s in v.start], float)
