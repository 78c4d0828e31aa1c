"""Schemes by name: what does not exist, what does not fit, and the command line."""

from __future__ import annotations

import pytest

from phfmu import (
    Collocated,
    DeclarationError,
    DiracDissipative,
    GradientPair,
    build_model,
)
from phfmu.cli import main
from phfmu.schemes.named import named_scheme
from tests.schemes.linear import linear, linear_descriptor


@pytest.mark.parametrize(
    ("arguments", "said"),
    [
        ({"name": "gradient-pair", "order": 4}, "order 2 only; use --scheme collocated"),
        ({"name": "dirac-dissipative", "order": 6}, "order 2 only; use --scheme collocated"),
        ({"name": "gradient-pair", "closure": "minimal"}, "dirac-dissipative"),
        ({"name": "collocated", "closure": "minimal"}, "dirac-dissipative"),
        ({"name": "midpoint", "closure": "end"}, "has no closure; .* semi-explicit, gradient-pair"),
        ({"closure": "middle"}, "choose from end, start, midpoint, minimal"),
        ({"gradient": "gonzales"}, "choose from per-term"),
    ],
)
def test_a_scheme_that_does_not_exist_says_what_does(arguments, said):
    with pytest.raises(DeclarationError, match=said):
        named_scheme(linear(), **arguments)


@pytest.mark.parametrize(
    ("scheme", "said"),
    [
        (Collocated(1), "no discrete pair; give ebar and zbar, or use --scheme dirac-dissipative"),
        (GradientPair(), "no discrete pair; give ebar and zbar, or use --scheme dirac-dissipative"),
        (DiracDissipative("midpoint"), "rank 1 of 2 at the start.*--closure minimal"),
        (DiracDissipative("minimal", at="start"), "structurally singular"),
        (DiracDissipative(lambda x, new, f: new), "gives 2 x 1 rows, but 1 are open.*give 1"),
        (DiracDissipative("middle"), "closure 'middle' is not known; choose from end, start, midpoint"),
    ],
)
def test_a_model_that_a_scheme_cannot_take_says_what_can(scheme, said):
    with pytest.raises(DeclarationError, match=said):
        build_model(linear_descriptor(), scheme)


def test_closures_that_leave_something_open_are_refused():
    with pytest.raises(DeclarationError, match="x2 would occur in no equation.*--closure midpoint or end"):
        build_model(linear(), GradientPair(closure="start"))
    with pytest.raises(DeclarationError, match="closure midpoint of collocated: is for order 2 only"):
        named_scheme(linear(), "collocated", 4, closure="midpoint")


@pytest.mark.parametrize(
    "words", ["gradient-pair", "dirac-dissipative --closure end", "dirac-dissipative --closure minimal"]
)
def test_schemes_at_the_command_line(words, capsys):
    assert main(f"run drive --engine python --stop 0.001 --scheme {words}".split()) == 0
    assert words.split()[0] in capsys.readouterr().out


def test_the_command_line_refuses_what_does_not_fit(capsys):
    assert main("run drive --engine python --scheme gradient-pair --closure start".split()) == 2
    assert "--closure midpoint or end" in capsys.readouterr().err
