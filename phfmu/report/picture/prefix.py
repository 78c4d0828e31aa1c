"""SI prefixes: which power of 1000 a number is read in."""

import math

#: units that take a prefix; kg, rad/s and other compounds do not
PREFIXED = frozenset("W J V A Wb N N.m Pa Hz F H C S T ohm VA var s m".split())
_LETTERS = {-15: "f", -12: "p", -9: "n", -6: "µ", -3: "m", 0: "", 3: "k", 6: "M", 9: "G", 12: "T"}


_RAISED = str.maketrans("-0123456789", "⁻⁰¹²³⁴⁵⁶⁷⁸⁹")
#: sizes that read well as they are where a unit takes no prefix
_PLAIN = (1e-2, 1e5)


def scaled(largest: float, unit: str | None) -> tuple[float, str]:
    """Factor and unit in which values up to `largest` read well: (1e-6, "MW"), (1e-6, "10⁶ kg"), (1.0, "rad/s")."""
    plain = unit if unit and unit != "1" else ""
    if not math.isfinite(largest) or largest <= 0.0:
        return 1.0, plain
    exponent = 3 * math.floor(math.log10(largest * (1.0 + 5.003e-4)) / 3.0)
    if unit in PREFIXED:
        exponent = min(max(exponent, min(_LETTERS)), 0 if unit == "s" else max(_LETTERS))
        return 10.0**-exponent, _LETTERS[exponent] + plain
    if _PLAIN[0] <= largest < _PLAIN[1]:
        return 1.0, plain
    return 10.0**-exponent, f"10{str(exponent).translate(_RAISED)} {plain}".rstrip()


def engineering(value: float, unit: str) -> str:
    """`2.47 GJ`: three digits and a prefix; plain exponents beyond the prefixes."""
    if not math.isfinite(value):
        return f"{value} {unit}"
    factor, text = scaled(abs(value), unit)
    number = value * factor
    digits = f"{number:.3g}" if value == 0.0 or 1e-3 <= abs(number) < 999.5 else f"{number:.2e}"
    return f"{digits} {text}".rstrip()
