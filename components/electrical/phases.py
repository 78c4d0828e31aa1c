"""The phases of electrical quantities: their names and angles."""

from __future__ import annotations

from math import pi

#: names of the entries of three-phase quantities
PHASES = ("a", "b", "c")
#: angles by which the phases a, b, c of balanced quantities lag behind phase a
ALPHA = (0.0, 2.0 * pi / 3.0, -2.0 * pi / 3.0)
