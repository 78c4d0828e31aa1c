"""What a unit has beside the quantities of its model is a group of variables: it comes last and changes nothing before it."""

from __future__ import annotations

from collections.abc import Iterator
from pathlib import Path

import pytest
from fmpy import read_model_description

from phfmu import Model, build_model
from phfmu.components.electrical.rl_line import rl_line
from phfmu.fmu.export.description import ExportedUnit
from phfmu.fmu.export.sources import interface_text
from phfmu.fmu.export.variables import variables
from phfmu.fmu.version import VERSIONS
from phfmu.signals import Quantity, ordered_ports


def square(model: Model) -> Iterator[Quantity]:
    """Two inputs per scalar pair, and a symmetric matrix of local variables by its lower triangle."""
    ports = [(p, first) for p, first in ordered_ports(model.declaration) if p.external]
    for port, first in ports:
        for j in range(port.n):
            for i in range(2):
                unit = f"{port.input_unit}*s"
                yield Quantity(
                    f"{port.name}.v_impulse[{j + 1},{i + 1}]", "input", "impulse", i * 6 + first + j, 1, 0.0, unit
                )
    for i in range(6):
        for j in range(i + 1):
            yield Quantity(f"impulse.jump[{i + 1},{j + 1}]", "local", "jump", i * (i + 1) // 2 + j, unit="A/(V*s)")


@pytest.fixture(scope="module")
def line() -> Model:
    return build_model(rl_line(0.3, 0.2))


def test_a_group_comes_last(line: Model) -> None:
    plain, more = variables(line), variables(line, (square,))
    assert more[: len(plain)] == plain and len(more) == len(plain) + 12 + 21
    assert [v.first for v in more[-21:]] == list(range(21))
    assert {v.initial for v in more[-21:]} == {"calculated"} and {v.start for v in more[-33:-21]} == {0.0}


def test_repeated_names_of_groups_are_refused(line: Model) -> None:
    with pytest.raises(RuntimeError, match=r"two variables are called 'a.v_impulse\[1,1\]'"):
        variables(line, (square, square))


@pytest.mark.parametrize("row", VERSIONS.values(), ids=list(VERSIONS))
def test_descriptions_of_all_versions_hold_it(line: Model, row, tmp_path: Path) -> None:
    """They fulfil the schema of the standard, units of products included."""
    unit = ExportedUnit(line, 1e-3)
    unit.__dict__["variables"] = variables(line, (square,))
    (tmp_path / "modelDescription.xml").write_bytes(row.description(unit, "{token}"))
    about = read_model_description(str(tmp_path), validate=True, validate_variable_names=True)
    found = {v.name: v for v in about.modelVariables}
    assert (found["b.v_impulse[3,2]"].causality, found["b.v_impulse[3,2]"].unit) == ("input", "V*s")
    assert (found["impulse.jump[6,6]"].causality, found["impulse.jump[6,6]"].variability) == ("local", "continuous")
    assert '_IMPULSE, 11, 1, "b.v_impulse[3,2]"' in interface_text(unit, "{token}")
