"""Schemes by the names users know."""

from __future__ import annotations

from phfmu.declare.phdae import PHDAE
from phfmu.gradients.gradient_names import GRADIENTS
from phfmu.schemes.collocated import Collocated
from phfmu.schemes.dirac_dissipative import DiracDissipative
from phfmu.schemes.gradient_pair import GradientPair
from phfmu.schemes.midpoint import Midpoint
from phfmu.schemes.radau import Radau
from phfmu.schemes.scheme import Scheme
from phfmu.schemes.scheme_names import CLOSURES, ORDERS, SCHEMES
from phfmu.schemes.semi_explicit import SemiExplicit
from phfmu.schemes.two_level import TwoLevel
from phfmu.terms.term import DeclarationError

#: schemes of order 2 only, and what to use for more
ONE_NODE = ("gradient-pair", "dirac-dissipative")


def named_scheme(
    declaration: PHDAE,
    name: str = "auto",
    order: int | None = None,
    gradient: str = "per-term",
    closure: str | None = None,
) -> Scheme:
    """The scheme `name` of `order` for a declaration; DeclarationError says what fits instead.

    auto:               two-level with holonomic constraints, collocated else
    collocated:         k = order/2 Gauss nodes;  semi-explicit is its name for holonomic models (scheme (44) of the seed)
    two-level:          position and velocity constraints both exact; holonomic models, order 2 or 6
    gradient-pair:      discrete gradient pair (Ebar, zbar), order 2
    dirac-dissipative:  discrete gradient on the Dirac structure, costate as unknown, order 2
    midpoint:           the baseline without energy exactness: gradients at the midpoint, order 2
    radau:              Radau IIA, orders 1, 3, 5: damps stiff decay and books the damping; no holonomic constraints
    order None:         2, for radau 3
    closure:            where algebraic variables belong: "end" | "start" | "midpoint" (order 2 of collocated, semi-explicit,
                        gradient-pair, dirac-dissipative), "minimal" (dirac-dissipative); None = the default of the scheme
    """
    order = order if order is not None else 3 if name == "radau" else 2
    _require_known(order, gradient, closure)
    if name == "radau":
        return _radau(declaration, order, gradient, closure)
    if order % 2:
        raise DeclarationError(f"scheme {name} has the orders 2, 4 and 6; order {order} is one of --scheme radau")
    holonomic = bool(declaration.constraints)
    if name == "auto":
        name = "two-level" if holonomic else "collocated"
    if name in ONE_NODE and order != 2:
        raise DeclarationError(f"scheme {name} has order 2 only; use --scheme collocated for order {order}")
    if name == "gradient-pair":
        if closure == "minimal":
            raise DeclarationError("closure minimal is for --scheme dirac-dissipative; use --closure midpoint or end")
        return GradientPair(gradient, closure or "midpoint")
    if name == "dirac-dissipative":
        return DiracDissipative(closure or "midpoint", gradient=gradient)
    if closure is not None and name not in ("collocated", "semi-explicit"):
        fits = "semi-explicit, gradient-pair or dirac-dissipative"
        raise DeclarationError(f"scheme {name} has no closure; leave out --closure, or use --scheme {fits}")
    if closure == "minimal":
        raise DeclarationError("closure minimal is for --scheme dirac-dissipative")
    if name == "midpoint":
        if order != 2 or gradient != "per-term":
            raise DeclarationError(
                "scheme midpoint has order 2 and no discrete gradient; leave out --order and --gradient"
            )
        return Midpoint()
    if name == "two-level":
        if not holonomic:
            raise DeclarationError(f"{declaration.name} has no holonomic constraints; use --scheme collocated")
        if order == 4:
            raise DeclarationError("the two-level scheme has odd stages only; use --order 2 or 6")
        return TwoLevel(order // 2, gradient)
    if name in ("collocated", "semi-explicit"):
        if closure is None:
            return Collocated(order // 2, gradient, name)
        if order != 2:
            raise DeclarationError(
                f"closure {closure} of {name} is for order 2 only; use --order 2, or leave out --closure"
            )
        return SemiExplicit(closure, gradient, name)
    raise DeclarationError(f"unknown scheme '{name}'; choose from {', '.join(SCHEMES)}")


def _require_known(order: int, gradient: str, closure: str | None) -> None:
    for what, value, known in (("order", order, ORDERS), ("gradient", gradient, GRADIENTS)):
        if value not in known:
            raise DeclarationError(f"{what} {value} is not offered; choose from {', '.join(map(str, known))}")
    if closure is not None and closure not in CLOSURES:
        raise DeclarationError(f"closure {closure} is not offered; choose from {', '.join(CLOSURES)}")


def _radau(declaration: PHDAE, order: int, gradient: str, closure: str | None) -> Scheme:
    if order % 2 == 0:
        raise DeclarationError(f"scheme radau has the orders 1, 3 and 5; order {order} is one of --scheme collocated")
    if gradient != "per-term" or closure is not None:
        raise DeclarationError("scheme radau takes gradients and algebraic variables at its nodes; leave out --gradient and "
                               "--closure")  # fmt: skip
    if declaration.constraints:
        raise DeclarationError(
            f"{declaration.name}: Radau nodes let the holonomic constraints drift; use --scheme two-level"
        )
    return Radau((order + 1) // 2)
