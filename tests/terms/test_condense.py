"""Junction variables condensed out of a step: the same motion, values and ledger as with them, in fewer unknowns."""

from __future__ import annotations

from dataclasses import replace
from functools import cache
from typing import Any

import numpy as np
import pytest

from phfmu import (
    PHDAE,
    Collocated,
    GradientPair,
    Midpoint,
    NativeInstance,
    Network,
    PythonInstance,
    Radau,
    build_model,
    export,
)
from phfmu.components.electrical.infinite_bus import infinite_bus
from phfmu.components.electrical.resistor import transformer
from phfmu.components.electrical.rl_line import rl_line
from phfmu.components.electrical.rlc_load import rlc_load
from phfmu.components.electrical.switch import fault_resistor
from phfmu.components.mechanical.four_particle import four_particle
from phfmu.components.scenes.electrical.smib import smib
from phfmu.fmu.importer.reader import FMUInstance
from phfmu.schemes.scheme import Scheme
from phfmu.terms.condense import CondensedVariables, condensed
from phfmu.terms.extraction.extract import extract
from tests.wide import wide

H = 1e-4
SCHEMES: dict[str, Scheme] = {
    "2": Collocated(1), "4": Collocated(2), "6": Collocated(3), "mean-value": Collocated(2, "mean-value"),
    "midpoint": Midpoint(), "radau": Radau(2), "carried": GradientPair(),
}  # fmt: skip


@cache
def grid(free: bool = False) -> PHDAE:
    """Two buses with capacitance, one without, a transformer with an inner node, a fault; `free`: a port is left."""
    v, w = 1000.0, 377.0
    net = Network("grid")
    net.add("source", infinite_bus(v, frequency=60.0))
    for name in ("feeder", "line", "spur"):
        net.add(name, rl_line(0.1, 5e-3, v=v, rated=300.0))
    net.add("leakage", rl_line(0.0, 2e-3, v=v, rated=300.0))
    net.add("unit", transformer(0.5, size=3, v=v, i=300.0))
    net.add("near", rlc_load(20.0, None, 5e-5, nominal=v))
    net.add("far", rlc_load(5.0, 20.0 / w, 2e-5, nominal=v))
    net.add("end", rl_line(3.0, 4e-3, v=v, rated=300.0))
    net.add("fault", fault_resistor(nominal=v))
    net.connect("source.terminal", "feeder.a", name="grid")
    net.junction("bus1", ["feeder.b", "near.terminal", "line.a", "unit.a"])
    net.connect("unit.b", "leakage.a", name="inside")
    net.junction("bus2", ["line.b", "far.terminal", "spur.a", "fault.terminal"])
    net.junction("bus3", ["spur.b", "end.a", "leakage.b"])
    if not free:
        net.add("far_source", infinite_bus(0.9 * v, frequency=60.0))
        net.connect("end.b", "far_source.terminal", name="other")
    return net.compose()


def with_unknowns(declaration: PHDAE) -> PHDAE:
    """The same equations as if written by hand: not known to be junctions, their variables stay unknowns."""
    return replace(declaration, junctions=())


def stepped(declaration: PHDAE, scheme: Scheme, engine: Any, n: int = 40) -> Any:
    """After n steps, with the fault from the tenth to the thirtieth."""
    instance = engine(build_model(declaration, scheme))
    names = [name for v in declaration.parameters for name in v.names()]
    for i in range(n):
        if i in (10, 30):
            p = instance.parameters.copy()
            p[[j for j, name in enumerate(names) if name.startswith("fault.G")]] = float(i == 10)
            instance.set_parameters(p)
        instance.do_step(i * H, H)
    return instance


def interpreted(model: Any) -> NativeInstance:
    return NativeInstance(model, kernels="interpreted")


ENGINES = {"python": PythonInstance, "native": NativeInstance, "interpreted": interpreted}


def test_all_variables_but_those_of_the_bare_node_are_condensed() -> None:
    terms = extract(grid())
    left = set(range(terms.na)) - set(condensed(terms).found(CondensedVariables).variables)
    assert [terms.algebraic_names[a] for a in sorted(left)] == ["bus3.v[1]", "bus3.v[2]", "bus3.v[3]"]


EVERY = [(s, e) for s in SCHEMES for e in ENGINES]
TELLING = ("2", "python"), ("2", "interpreted"), ("4", "native"), ("radau", "native")


@pytest.mark.parametrize(("scheme", "engine"), wide(EVERY, *TELLING))
def test_motion_values_and_ledger_are_those_of_all_unknowns(scheme: str, engine: str) -> None:
    few, many = (stepped(d, SCHEMES[scheme], ENGINES[engine]) for d in (grid(), with_unknowns(grid())))
    carried = scheme == "carried"
    assert (few.model.step.nw == many.model.step.nw) if carried else (few.model.step.nw < 0.6 * many.model.step.nw)
    assert few.model.step.na == many.model.step.na  # all are told
    for block, values in many.signals().items():
        size = np.abs(values).max(initial=0.0)
        bound = 1e-9 if block == "residual" else 1e-12 * size
        np.testing.assert_allclose(few.signals()[block], values, rtol=0.0, atol=bound, err_msg=block)
    np.testing.assert_allclose(
        few.ledger()["pairs"], many.ledger()["pairs"], rtol=0.0, atol=1e-12 * np.abs(few.ledger()["pairs"]).max()
    )


@pytest.mark.parametrize("k", [1, 2])
def test_sensitivities_of_a_free_port_are_those_of_all_unknowns(k: int) -> None:
    few, many = (stepped(d, Collocated(k), NativeInstance) for d in (grid(free=True), with_unknowns(grid(free=True))))
    S = many.sensitivity()
    np.testing.assert_allclose(few.sensitivity(), S, rtol=0.0, atol=1e-12 * np.abs(S).max())


@pytest.mark.slow
def test_a_unit_steps_as_the_instance_does(tmp_path: Any) -> None:
    model = build_model(grid(free=True), Collocated(1))
    (path,) = export(model, tmp_path, versions=("3.0",), step=H)
    unit, instance = FMUInstance(path), NativeInstance(model)
    for i in range(10):
        unit.do_step(i * H, H)
        instance.do_step(i * H, H)
    np.testing.assert_array_equal(unit.output(), instance.output())


def test_a_restored_state_goes_on_bit_for_bit() -> None:
    for engine in (PythonInstance, NativeInstance):
        instance = stepped(grid(), Collocated(2), engine, 12)
        kept = instance.get_state()
        rows = []
        for _ in range(2):
            instance.set_state(kept)
            instance.do_step(12 * H, H)
            rows.append(instance.row())
        np.testing.assert_array_equal(*rows)


def test_models_that_are_no_networks_keep_their_plans() -> None:
    terms = extract(four_particle())
    assert condensed(terms) is terms


@pytest.mark.slow
def test_a_machine_at_an_infinite_bus_keeps_its_motion() -> None:
    d = smib().declaration()
    few, many = (stepped(x, Collocated(2), NativeInstance, 60) for x in (d, with_unknowns(d)))
    assert few.model.step.nw < many.model.step.nw
    np.testing.assert_allclose(few.x, many.x, rtol=0.0, atol=1e-12 * np.abs(many.x).max())
