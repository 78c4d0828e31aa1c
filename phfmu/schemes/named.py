"""Schemes by the names users know."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace

from phfmu.declare.error import DeclarationError, Problem
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


@dataclass(frozen=True)
class SchemeRequest:
    """A scheme asked for by names from the lists; closure None = the default of the scheme."""

    name: str
    order: int
    gradient: str
    closure: str | None


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
    if name not in MAKERS:
        raise DeclarationError(f"scheme '{name}'", "is unknown", f"choose from {', '.join(SCHEMES)}")
    if name != "radau" and order % 2:
        raise DeclarationError(
            f"scheme {name}", "has the orders 2, 4 and 6", f"order {order} is one of --scheme radau", "order"
        )
    return MAKERS[name](declaration, SchemeRequest(name, order, gradient, closure))


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


def _require_order_2(a: SchemeRequest) -> None:
    if a.order != 2:
        raise DeclarationError(
            f"scheme {a.name}", "has order 2 only", f"use --scheme collocated for order {a.order}", "order"
        )


def _require_no_closure(a: SchemeRequest) -> None:
    if a.closure is not None:
        fits = "semi-explicit, gradient-pair or dirac-dissipative"
        remedy = f"leave out --closure, or use --scheme {fits}"
        raise DeclarationError(f"scheme {a.name}", "has no closure", remedy, "closure")


def _require_not_minimal(a: SchemeRequest, remedy: str) -> None:
    if a.closure == "minimal":
        raise DeclarationError("closure minimal", "is for --scheme dirac-dissipative", remedy, "closure")


def _auto(declaration: PHDAE, a: SchemeRequest) -> Scheme:
    name = "two-level" if declaration.constraints else "collocated"
    return MAKERS[name](declaration, replace(a, name=name))


def _collocated(declaration: PHDAE, a: SchemeRequest) -> Scheme:
    del declaration
    _require_not_minimal(a, "use that, or --closure midpoint or end")
    if a.closure is None:
        return Collocated(a.order // 2, a.gradient, a.name)
    if a.order != 2:
        remedy = "use --order 2, or leave out --closure"
        raise DeclarationError(f"closure {a.closure} of {a.name}", "is for order 2 only", remedy, "order")
    return SemiExplicit(a.closure, a.gradient, a.name)


def _two_level(declaration: PHDAE, a: SchemeRequest) -> Scheme:
    _require_no_closure(a)
    if not declaration.constraints:
        raise DeclarationError(
            declaration.name, "has no holonomic constraints", "use --scheme collocated", "constraint"
        )
    if a.order == 4:
        raise DeclarationError("scheme two-level", "has odd stages only", "use --order 2 or 6", "stages")
    return TwoLevel(a.order // 2, a.gradient)


def _gradient_pair(declaration: PHDAE, a: SchemeRequest) -> Scheme:
    del declaration
    _require_order_2(a)
    _require_not_minimal(a, "use --closure midpoint or end")
    return GradientPair(a.gradient, a.closure or "midpoint")


def _dirac_dissipative(declaration: PHDAE, a: SchemeRequest) -> Scheme:
    del declaration
    _require_order_2(a)
    return DiracDissipative(a.closure or "midpoint", gradient=a.gradient)


def _midpoint(declaration: PHDAE, a: SchemeRequest) -> Scheme:
    del declaration
    _require_no_closure(a)
    if a.order != 2 or a.gradient != "per-term":
        raise DeclarationError(
            "scheme midpoint", "has order 2 and no discrete gradient", "leave out --order and --gradient", "order"
        )
    return Midpoint()


def _radau(declaration: PHDAE, a: SchemeRequest) -> Scheme:
    if a.order % 2 == 0:
        raise DeclarationError(
            "scheme radau", "has the orders 1, 3 and 5", f"order {a.order} is one of --scheme collocated", "order"
        )
    if a.gradient != "per-term" or a.closure is not None:
        raise DeclarationError("scheme radau", "takes gradients and algebraic variables at its nodes",
                               "leave out --gradient and --closure", "gradient")  # fmt: skip
    if declaration.constraints:
        raise DeclarationError(
            declaration.name, "Radau nodes let the holonomic constraints drift", "use --scheme two-level", "drift"
        )
    return Radau((a.order + 1) // 2)


#: the names of `scheme_names.py`, and what makes the scheme or says why it does not fit
MAKERS: dict[str, Callable[[PHDAE, SchemeRequest], Scheme]] = {
    "auto": _auto,
    "collocated": _collocated,
    "two-level": _two_level,
    "semi-explicit": _collocated,
    "gradient-pair": _gradient_pair,
    "dirac-dissipative": _dirac_dissipative,
    "midpoint": _midpoint,
    "radau": _radau,
}
