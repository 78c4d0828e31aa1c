"""The table of observed orders: rates of models, cells, words of refusal, the command."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from phfmu import DeclarationError, build_model
from phfmu.cli import main
from phfmu.components.library import build
from phfmu.schemes.named import named_scheme
from phfmu.studies.bench.orders import Method, measure, methods, span, table, targets
from tests.wide import wide


@pytest.mark.parametrize(("name", "rate"), [("dc_motor", 206.0), ("oscillator", 6 * np.pi)])
def test_runs_last_a_few_radians_of_the_fastest_mode(name, rate):
    """The rate of the motor is |lambda| of [[-R/L, -k], [k/(L J), -d/J]]; junctions of the oscillator do not count."""
    found = build(name)
    model = build_model(found if name == "dc_motor" else found.declaration())
    model = build_model(model.declaration, named_scheme(model.declaration, order=6))
    assert 1.5 <= span(model) * rate <= 15.0


def test_runs_that_are_exact_last_a_second():
    d = build("spring")
    assert span(build_model(d, named_scheme(d, order=6))) == 1.0


@pytest.mark.slow
def test_rows_have_slopes_and_words():
    (row,) = measure(["rl_line"])
    assert float(row.cells[Method("collocated", 2)]) == pytest.approx(2.0, abs=0.05)
    assert float(row.cells[Method("collocated", 6)]) == pytest.approx(6.0, abs=0.2)
    assert row.cells[Method("gradient-pair", 4)] == "order 2"
    assert row.cells[Method("two-level", 2)] == "no constraint"
    assert max(row.ledger.values()) <= 1e-13
    text = table([row])
    assert text.splitlines()[0].startswith("| target | collocated 2 | collocated 4 |")
    assert "two-level" not in text and text.splitlines()[-1].startswith("| worst ledger |")


@pytest.mark.parametrize("name", wide(["dc_motor", "four_particle"], "dc_motor"))
def test_every_refusal_in_the_table_has_a_word(name):
    """A DeclarationError of a new kind would show as `no`: it needs a word in REASONS."""
    from phfmu.studies.bench.orders import REASONS

    declaration = build(name)
    for m in methods():
        try:
            build_model(declaration, named_scheme(declaration, m.scheme, m.order, m.gradient))
        except DeclarationError as e:
            assert e.rule in REASONS, e


def test_targets_are_what_has_states():
    names = [n for n, _ in targets()]
    assert "synchronous_machine" in names and "infinite_bus" not in names and "resistor" not in names


def test_command(capsys, tmp_path: Path):
    file = tmp_path / "orders.md"
    assert main(["bench", "orders", "--families", "spring", "-o", str(file)]) == 0
    assert file.read_text() == capsys.readouterr().out
    assert "| spring | exact |" in file.read_text()
    assert main(["bench", "orders", "--families", "sprig"]) == 2
    assert "did you mean spring" in capsys.readouterr().err
