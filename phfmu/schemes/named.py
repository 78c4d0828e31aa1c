"""Schemes by the names users know."""

from __future__ import annotations

from phfmu.declare.error import DeclarationError
from phfmu.declare.phdae import PHDAE
from phfmu.declare.problem import Problem
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
        raise DeclarationError(
            f"scheme {name}", "has the orders 2, 4 and 6", f"order {order} is one of --scheme radau", "order"
        )
    holonomic = bool(declaration.constraints)
    if name == "auto":
        name = "two-level" if holonomic else "collocated"
    if name in ONE_NODE and order != 2:
        raise DeclarationError(
            f"scheme {name}", "has order 2 only", f"use --scheme collocated for order {order}", "order"
        )
    if name == "gradient-pair":
        if closure == "minimal":
            raise DeclarationError(
                "closure minimal", "is for --scheme dirac-dissipative", "use --closure midpoint or end", "closure"
            )
        return GradientPair(gradient, closure or "midpoint")
    if name == "dirac-dissipative":
        return DiracDissipative(closure or "midpoint", gradient=gradient)
    if closure is not None and name not in ("collocated", "semi-explicit"):
        fits = "semi-explicit, gradient-pair or dirac-dissipative"
        raise DeclarationError(
            f"scheme {name}", "has no closure", f"leave out --closure, or use --scheme {fits}", "closure"
        )
    if closure == "minimal":
        raise DeclarationError(
            "closure minimal", "is for --scheme dirac-dissipative", "use that, or --closure midpoint or end", "closure"
        )
    if name == "midpoint":
        if order != 2 or gradient != "per-term":
            raise DeclarationError(
                "scheme midpoint", "has order 2 and no discrete gradient", "leave out --order and --gradient", "order"
            )
        return Midpoint()
    if name == "two-level":
        if not holonomic:
            raise DeclarationError(
                declaration.name, "has no holonomic constraints", "use --scheme collocated", "constraint"
            )
        if order == 4:
            raise DeclarationError("scheme two-level", "has odd stages only", "use --order 2 or 6", "stages")
        return TwoLevel(order // 2, gradient)
    if name in ("collocated", "semi-explicit"):
        if closure is None:
            return Collocated(order // 2, gradient, name)
        if order != 2:
            raise DeclarationError(
                f"closure {closure} of {name}", "is for order 2 only", "use --order 2, or leave out --closure", "order"
            )
        return SemiExplicit(closure, gradient, name)
    raise DeclarationError(f"scheme '{name}'", "is unknown", f"choose from {', '.join(SCHEMES)}")


def _require_known(order: int, gradient: str, closure: str | None) -> None:
    offered = (("order", order, ORDERS), ("gradient", gradient, GRADIENTS), ("closure", closure, (None, *CLOSURES)))
    found = [
        Problem(
            "", f"{what} {value}", "is not offered", f"choose from {', '.join(str(k) for k in known if k is not None)}"
        )
        for what, value, known in offered
        if value not in known
    ]
    if found:
        raise DeclarationError.of(found)


def _radau(declaration: PHDAE, order: int, gradient: str, closure: str | None) -> Scheme:
    if order % 2 == 0:
        raise DeclarationError(
            "scheme radau", "has the orders 1, 3 and 5", f"order {order} is one of --scheme collocated", "order"
        )
    if gradient != "per-term" or closure is not None:
        raise DeclarationError("scheme radau", "takes gradients and algebraic variables at its nodes",
                               "leave out --gradient and --closure", "gradient")  # fmt: skip
    if declaration.constraints:
        raise DeclarationError(
            declaration.name, "Radau nodes let the holonomic constraints drift", "use --scheme two-level", "drift"
        )
    return Radau((order + 1) // 2)
