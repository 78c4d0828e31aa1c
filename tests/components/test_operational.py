"""Machines whose parameters are reactances and time constants."""

from __future__ import annotations

from typing import Any

import casadi as ca
import numpy as np
import pytest

from phfmu import Collocated, NativeInstance, build_model, check
from phfmu.components.electrical import (
    MachineDataError,
    Saturation,
    from_per_unit,
    machine_set,
    reactances,
    synchronous_machine,
)
from phfmu.components.electrical.machines.operational import operational_windings
from tests.components.test_machine_per_unit import GENROU, RATED
from tests.wide import slow


def numbers(**changed: float) -> Any:
    return from_per_unit("m", H=3.0, no_load_field_current=300.0, **RATED, **(GENROU | changed))


def stepped(declaration: Any, order: int = 4) -> np.ndarray:
    """States of a short circuit after 50 ms."""
    model = build_model(declaration) if order == 2 else build_model(declaration, Collocated(order // 2))
    unit = NativeInstance(model)
    unit.set_input(np.concatenate([np.zeros(3), unit.held_input[3:]]))
    unit.run(0.0, 5e-4, 100)
    return unit.x.copy()


@pytest.mark.usefixtures("compiler")
@pytest.mark.parametrize(
    ("data", "coordinates"),
    [(numbers(), "dq-flux"), *map(slow, [(machine_set("krause_hydro325"), "abc-flux"), (numbers(), "current")])],
)
def test_it_is_the_machine_of_the_circuit(data: Any, coordinates: Any) -> None:
    made = [synchronous_machine(data, coordinates=coordinates, parameters=p) for p in ("circuit", "operational")]
    assert check(made[1]) == []
    a, b = (stepped(m, 2 if coordinates == "current" else 4) for m in made)
    # inductances differ by rounding, which 100 steps carry on
    np.testing.assert_allclose(a, b, rtol=1e-9, atol=1e-9 * np.abs(b[:-2]).max())


@pytest.mark.parametrize(
    "name", ["xd", "xd1", "xd2", "xq", "xq1", "xq2", "Td10", "Td20", "Tq10", "Tq20", "xl", "x0", "ra"]
)
def test_a_value_that_is_set_is_that_of_data_with_it(name: str) -> None:
    """Windings at another value are those of data that have it, with the same turns of the dampers and the same M_f."""
    data = GENROU | {"xq2": GENROU["xd2"], "x0": GENROU["xl"], "ra": 0.003}
    other, found = numbers(**(data | {name: 1.03 * data[name]})), operational_windings(numbers(**data))
    pairs = list(found.L.rotor)
    at = ca.Function(
        "at",
        [v.sx for v in found.parameters],
        [ca.vertcat(found.Ra, *found.R, found.L.Ld, found.L.Lq, found.L.L0, *found.L.M, *found.L.rotor.values())],
    )
    values = np.array(at(*(v.start[0] * (1.03 if v.name == name else 1.0) for v in found.parameters))).ravel()
    expected = [other.Ra, *other.R_rotor, other.Ld, other.Lq, other.L0, *other.M_stator_rotor]
    np.testing.assert_allclose(values, [*expected, *(other.L_rotor[i][j] for i, j in pairs)], rtol=1e-11)


def test_saturation_keeps_its_parameters() -> None:
    machine = synchronous_machine("kundur555_1q", parameters="operational", saturation=Saturation(0.1, 0.4))
    names = {p.name for p in machine.parameters}
    assert {"xl", "xd", "A_sat", "B_sat"} <= names and "Ll" not in names and check(machine) == []


def test_values_are_those_of_the_book() -> None:
    values = {p.name: p.start[0] for p in synchronous_machine("kundur555_1q", parameters="operational").parameters}
    assert {n: values[n] for n in reactances("kundur555_1q")} == reactances("kundur555_1q")
    assert values["xl"] == pytest.approx(0.15)


REFUSED = {
    "no leakage": (lambda: machine_set("kundur555_1q", Ll=None), "no leakage Ll"),
    "no resistance": (
        lambda: machine_set("kundur555_1q", R_rotor=[0.0, 0.0196, 0.0164]),
        "winding f without resistance",
    ),
    "another flux": (lambda: machine_set("kundur555_1q", Ll=2e-4), "one main flux an axis"),
}


@pytest.mark.parametrize("case", REFUSED)
def test_sets_that_they_do_not_describe_are_refused(case: str) -> None:
    made, text = REFUSED[case]
    with pytest.raises(MachineDataError, match=text):
        synchronous_machine(made(), parameters="operational")


def test_an_unknown_kind_is_told() -> None:
    with pytest.raises(ValueError, match="parameters 'operation' unknown"):
        synchronous_machine(parameters="operation")  # type: ignore[arg-type]
