"""Schemes by the names users know."""

from __future__ import annotations

from phfmu.declare.phdae import PHDAE
from phfmu.discretise.collocated import Collocated
from phfmu.discretise.scheme import Scheme
from phfmu.discretise.scheme_names import ORDERS, SCHEMES
from phfmu.discretise.terms import DeclarationError


def named_scheme(declaration: PHDAE, name: str = "auto", order: int = 2, gradient: str = "per-term") -> Scheme:
    """The scheme `name` of `order` for a declaration; DeclarationError says what fits instead.

    auto:           two-level with holonomic constraints, collocated else
    collocated:     k = order/2 Gauss nodes;  semi-explicit is its name for holonomic models (scheme (44) of the seed)
    two-level:      position and velocity constraints both exact; holonomic models, order 2 or 6
    midpoint:       the baseline without energy exactness: gradients at the midpoint, order 2
    """
    if order not in ORDERS:
        raise DeclarationError(f"order {order} is not offered; choose from {', '.join(map(str, ORDERS))}")
    holonomic = bool(declaration.constraints)
    if name == "auto":
        name = "two-level" if holonomic else "collocated"
    if name == "midpoint":
        if order != 2 or gradient != "per-term":
            raise DeclarationError(
                "scheme midpoint has order 2 and no discrete gradient; leave out --order and --gradient"
            )
        return Collocated(1, gradient="nodal", name="midpoint")
    if name == "two-level":
        if not holonomic:
            raise DeclarationError(f"{declaration.name} has no holonomic constraints; use --scheme collocated")
        if order == 4:
            raise DeclarationError("the two-level scheme has odd stages only; use --order 2 or 6")
        return Collocated(order // 2, gradient=gradient, name=name, two_level=True)
    if name in ("collocated", "semi-explicit"):
        return Collocated(order // 2, gradient=gradient, name=name)
    raise DeclarationError(f"unknown scheme '{name}'; choose from {', '.join(SCHEMES)}")
