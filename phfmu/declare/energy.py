"""Additive terms of the Hamiltonian and the closed-form pair."""

from __future__ import annotations

from collections.abc import Callable
from collections.abc import Set as AbstractSet
from dataclasses import dataclass, replace
from enum import StrEnum
from typing import Any, Literal

import casadi as ca

from phfmu.declare.expressions.operations import degree
from phfmu.declare.variable import Variable, _sx


class EnergyKind(StrEnum):
    """Kinds of additive terms of the Hamiltonian."""

    QUADRATIC = "quadratic"  # constant Hessian
    STRAIN = "strain"  # phi(C(x)) with quadratic C
    GENERAL = "general"


@dataclass(frozen=True, eq=False)
class Energy:
    """One additive term H_s(x) of the Hamiltonian, in joule.

    kind:       quadratic, strain, general
    invariant:  C(x) for the strain form; `phi` maps a scalar symbol to the energy
    correct:    state symbols that take the directionality correction of a general term (default: all of its states)
    owner:      member of a network the term belongs to ("" in a single component)
    """

    expr: ca.SX
    kind: EnergyKind
    invariant: ca.SX | None = None
    phi: Callable[[ca.SX], ca.SX] | None = None
    correct: tuple[Variable, ...] = ()
    owner: str = ""

    def __post_init__(self) -> None:
        object.__setattr__(self, "kind", EnergyKind(self.kind))  # may be given by its name


def energy(
    expr: Any,
    *,
    kind: Literal["general", "quadratic"] = "general",
    correct: tuple[Variable, ...] = (),
    owner: str = "",
) -> Energy:
    """A term given by its expression; the declaration recognises quadratic terms by their constant Hessian.

    kind: "quadratic" says so, for parts of which a network has thousands: it is then proved once for all that are alike, when
    they are discretised. DeclarationError then for an H that is not.
    """
    return Energy(ca.SX(_sx(expr)), EnergyKind(kind), correct=correct, owner=owner)


def resolve_kind(term: Energy, states: AbstractSet[int]) -> Energy:
    """`term` as quadratic where it has degree 2 at most in the states (given by their element hashes)."""
    if term.kind is not EnergyKind.GENERAL:
        return term
    x = ca.vertcat(*(s for s in ca.symvar(term.expr) if s.element_hash() in states))
    return replace(term, kind=EnergyKind.QUADRATIC) if x.numel() and degree(term.expr, x) in (0, 1, 2) else term


def strain_energy(invariant: Any, phi: Callable[[ca.SX], ca.SX], *, owner: str = "") -> Energy:
    """phi(C(x)) with a quadratic invariant C, e.g. a squared distance: keeps linear and angular momentum."""
    invariant = ca.SX(_sx(invariant))
    return Energy(phi(invariant), EnergyKind.STRAIN, invariant, phi, owner=owner)


@dataclass(frozen=True, eq=False)
class ClosedPair:
    """A gradient pair (E, z) for states whose E depends on x or is singular:  E^T z = grad H.

    With increment d = x' - x its discrete pair has   ebar(x, d) for E d,   zbar(x, d) for z,
    zbar^T ebar = H(x + d) - H(x),   and for small d the limits E d and z.  k = 1 only.
    Without `ebar` and `zbar` only the Dirac-dissipative scheme fits, which needs no discrete pair.
    `hamiltonian`: H(x), depends on `variables` only.  Source: Kinon, Morandin, Schulze 2026, Definitions 1 and 7.
    """

    variables: tuple[Variable, ...]
    hamiltonian: ca.SX
    E: ca.SX
    z: ca.SX
    ebar: Callable[[ca.SX, ca.SX], ca.SX] | None = None
    zbar: Callable[[ca.SX, ca.SX], ca.SX] | None = None
    owner: str = ""
