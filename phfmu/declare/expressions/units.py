"""Units: a small parser from unit text to SI exponents and factor.

A unit is a product of symbols with integer exponents, e.g. `kg.m2/s`, `N.m`, `V.s/rad`, `kN`, `1/s`.
`rad` is kept as its own exponent (FMI does the same) and counts as 1 in power checks.
"""

from __future__ import annotations

import re
from collections.abc import Sequence
from dataclasses import dataclass
from fractions import Fraction
from functools import cache
from math import pi

BASE = ("kg", "m", "s", "A", "K", "mol", "cd", "rad")

# symbol -> (factor to SI, exponents of BASE)
_SYMBOLS: dict[str, tuple[float, dict[str, int]]] = {
    "1": (1.0, {}),
    "kg": (1.0, {"kg": 1}),
    "g": (1e-3, {"kg": 1}),
    "m": (1.0, {"m": 1}),
    "s": (1.0, {"s": 1}),
    "A": (1.0, {"A": 1}),
    "K": (1.0, {"K": 1}),
    "mol": (1.0, {"mol": 1}),
    "cd": (1.0, {"cd": 1}),
    "rad": (1.0, {"rad": 1}),
    "deg": (pi / 180.0, {"rad": 1}),
    "rev": (2.0 * pi, {"rad": 1}),
    "rpm": (2.0 * pi / 60.0, {"rad": 1, "s": -1}),
    "min": (60.0, {"s": 1}),
    "h": (3600.0, {"s": 1}),
    "Hz": (1.0, {"s": -1}),
    "N": (1.0, {"kg": 1, "m": 1, "s": -2}),
    "J": (1.0, {"kg": 1, "m": 2, "s": -2}),
    "W": (1.0, {"kg": 1, "m": 2, "s": -3}),
    "var": (1.0, {"kg": 1, "m": 2, "s": -3}),
    "VA": (1.0, {"kg": 1, "m": 2, "s": -3}),
    "Pa": (1.0, {"kg": 1, "m": -1, "s": -2}),
    "bar": (1e5, {"kg": 1, "m": -1, "s": -2}),
    "V": (1.0, {"kg": 1, "m": 2, "s": -3, "A": -1}),
    "ohm": (1.0, {"kg": 1, "m": 2, "s": -3, "A": -2}),
    "S": (1.0, {"kg": -1, "m": -2, "s": 3, "A": 2}),
    "F": (1.0, {"kg": -1, "m": -2, "s": 4, "A": 2}),
    "C": (1.0, {"s": 1, "A": 1}),
    "Wb": (1.0, {"kg": 1, "m": 2, "s": -2, "A": -1}),
    "T": (1.0, {"kg": 1, "s": -2, "A": -1}),
    "H": (1.0, {"kg": 1, "m": 2, "s": -2, "A": -2}),
}
_PREFIXES = {"G": 1e9, "M": 1e6, "k": 1e3, "c": 1e-2, "m": 1e-3, "u": 1e-6, "n": 1e-9}
_TOKEN = re.compile(r"([A-Za-z]+|1)(-?\d+)?$")


class UnitError(ValueError):
    """The text is not a unit this package knows."""


@dataclass(frozen=True)
class PhysicalUnit:
    """`factor` times the product of BASE symbols to `exponents` (same order as BASE)."""

    text: str
    factor: float
    exponents: tuple[int, ...]

    def without_angle(self) -> tuple[int, ...]:
        """Exponents with rad counted as 1, for power and connection checks."""
        return self.exponents[:-1]


WATT_EXPONENTS = (1, 2, -3, 0, 0, 0, 0)


def _symbol(text: str, token: str) -> tuple[float, dict[str, int]]:
    if token in _SYMBOLS:
        return _SYMBOLS[token]
    if len(token) > 1 and token[0] in _PREFIXES and token[1:] in _SYMBOLS:
        factor, exponents = _SYMBOLS[token[1:]]
        return _PREFIXES[token[0]] * factor, exponents
    raise UnitError(f"unknown unit symbol '{token}' in '{text}'; known: {', '.join(_SYMBOLS)}")


@cache
def parse_unit(text: str) -> PhysicalUnit:
    """Parse `text` (factors separated by `.`, `*` or `/`; everything after a `/` divides until the next one)."""
    exponents: dict[str, int] = dict.fromkeys(BASE, 0)
    factor = 1.0
    parts = re.split(r"(/)", text.replace("*", ".").replace(" ", "").replace("(", "").replace(")", ""))
    sign = 1
    for part in parts:
        if part == "/":
            sign = -1
            continue
        for token in filter(None, part.split(".")):
            match = _TOKEN.match(token)
            if not match:
                raise UnitError(f"cannot read '{token}' in unit '{text}'; write e.g. 'kg.m2/s'")
            power = sign * int(match.group(2) or 1)
            value, exps = _symbol(text, match.group(1))
            factor *= value**power
            for base, exponent in exps.items():
                exponents[base] += power * exponent
    return PhysicalUnit(text, factor, tuple(exponents[b] for b in BASE))


def unit_text(exponents: Sequence[Fraction | int], factor: float) -> str:
    """A unit with these exponents (of BASE without rad) and this factor: a symbol if there is one, else a product."""
    for symbol, (value, exps) in _SYMBOLS.items():
        if tuple(exps.get(b, 0) for b in BASE[:-1]) != tuple(exponents) or symbol == "rad":
            continue
        for prefix, scale in {"": 1.0, **_PREFIXES}.items():
            if abs(scale * value / factor - 1.0) < 1e-9:
                return prefix + symbol
    up = [f"{b}{e if e != 1 else ''}" for b, e in zip(BASE, exponents, strict=False) if e > 0]
    down = [f"{b}{-e if e != -1 else ''}" for b, e in zip(BASE, exponents, strict=False) if e < 0]
    text = "/".join([".".join(up) or "1", *down])
    return text if factor == 1.0 else f"{factor:.6g} {text}"


def is_power(effort: str, flow: str) -> bool:
    """True if effort times flow is a power: dimension and factor of the watt."""
    e, f = parse_unit(effort), parse_unit(flow)
    product = tuple(a + b for a, b in zip(e.without_angle(), f.without_angle(), strict=True))
    return product == WATT_EXPONENTS and abs(e.factor * f.factor - 1.0) < 1e-12
