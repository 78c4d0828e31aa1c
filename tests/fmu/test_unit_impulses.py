"""Units with impulses and derivatives at the nodes of a step: all that a master of order 2k needs, and only where asked for."""

from __future__ import annotations

import zipfile
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from phfmu import Collocated, Model, NativeInstance, StepFailure, build_model, export
from phfmu.components.library import build
from phfmu.components.mechanical.translational import spring
from phfmu.fmu.export.variables import FMUError
from phfmu.fmu.importer.reader import FMUInstance
from phfmu.fmu.importer.refusal import UnitFailure
from tests.engine.test_impulses import body, stiffening
from tests.wide import wide

pytestmark = pytest.mark.usefixtures("compiler")

VERSIONS = ("2.0", "3.0")
STEP = 5e-4


@pytest.fixture(scope="module")
def units(tmp_path_factory) -> Any:
    """(declaration, k, version, options) -> path of a unit."""
    made: dict[Any, dict[str, Path]] = {}

    def get(name: str, k: int, version: str, step: float = STEP, **options: Any) -> Path:
        key = (name, k, step, *sorted(options.items()))
        if key not in made:
            paths = export(model_of(name, k), tmp_path_factory.mktemp("unit"), VERSIONS, step=step, **options)
            made[key] = dict(zip(VERSIONS, paths, strict=True))
        return made[key][version]

    return get


MODELS: dict[Any, Model] = {}


def model_of(name: str, k: int) -> Model:
    if (name, k) not in MODELS:
        own = {"body": body, "stiffening": stiffening}.get(name)
        MODELS[name, k] = build_model(own() if own else build(name), Collocated(k))
    return MODELS[name, k]


def drawn(model: Model, n: int, seed: int = 0) -> tuple[np.ndarray, np.ndarray]:
    """Inputs at the nodes, impulses at both ends."""
    rng = np.random.default_rng(seed)
    return model.u0 + 100 * rng.normal(size=(model.step.k, model.step.nu)), rng.normal(size=(2, n))


@pytest.mark.parametrize("version", VERSIONS)
@pytest.mark.parametrize("k", wide([1, 2], 2))
def test_steps_energies_and_derivatives_are_those_of_the_engine(units: Any, version: str, k: int) -> None:
    """Over one and several internal steps, with impulses, to rounding."""
    model = model_of("synchronous_machine", k)
    native = NativeInstance(model)
    with FMUInstance(units("synchronous_machine", k, version, impulses=True)) as unit:
        at, t = unit.at_nodes, 0.0
        assert [(p.port, p.kind, p.linear) for p in at.impulse_ports] == [
            (p.port, p.kind, p.linear) for p in native.impulse_ports
        ]
        for step, parts in enumerate((1, 3, 2)):
            h = parts * STEP
            U, s = drawn(model, 5, step)
            for one in (at, native):
                one.set_node_inputs(U)
                one.set_impulses(*s)
            unit.do_step(t, h)
            native.do_step(t, h, parts)
            t += h
            assert np.array_equal(at.node_output(), native.node_output())
            assert np.array_equal(unit.end_output(), native.signal("y_end")[:5])
            np.testing.assert_allclose(at.jump(), native.jump(), rtol=1e-13, atol=1e-12)
            found, expected = (i.node_sensitivity([0, 3], impulses=True, end=True) for i in (at, native))
            assert np.array_equal(found.nodes, expected.nodes) and np.array_equal(found.end, expected.end)
            book, own = unit.ledger(), native.ledger()
            assert np.array_equal(book["pairs"], own["pairs"][:5])
            for row in ("stored", "dissipated", "supplied", "moved"):
                assert book[row] == own[row].sum()
        assert abs(unit.gap()) <= 1e-12 * np.abs(unit.energies()).sum()


@pytest.mark.parametrize("version", VERSIONS)
def test_derivatives_are_the_differences_of_steps(units: Any, version: str) -> None:
    """Three internal steps of order 4; inputs at nodes, impulses at both ends; outputs at nodes and at the end."""
    with FMUInstance(units("body", 2, version, step=0.1, node_inputs=True)) as unit:
        at, h = unit.at_nodes, 0.3
        U, s = np.array([[0.4], [-0.7]]), np.array([[0.05], [-0.02]])
        start = unit.get_state()

        def outputs(x: np.ndarray) -> np.ndarray:
            unit.set_state(start)
            at.set_node_inputs(x[:2, None])
            at.set_impulses(x[2:3], x[3:])
            unit.do_step(0.0, h)
            return np.concatenate([at.node_output().ravel(), unit.end_output()])

        x, e = np.concatenate([U.ravel(), s.ravel()]), 1e-4
        columns = [
            (8 * (outputs(x + e * d) - outputs(x - e * d)) - outputs(x + 2 * e * d) + outputs(x - 2 * e * d)) / (12 * e)
            for d in np.eye(4)
        ]
        outputs(x)
        found = at.node_sensitivity(impulses=True, end=True)
        everything = np.concatenate([found.nodes.reshape(2, 4), found.end])
        np.testing.assert_allclose(everything, np.array(columns).T, rtol=0, atol=1e-10 * np.abs(everything).max())


@pytest.mark.parametrize("version", VERSIONS)
@pytest.mark.parametrize("k", wide([1, 2], 2))
def test_without_impulses_a_unit_gives_the_bits_of_one_that_has_none(units: Any, version: str, k: int) -> None:
    """Never set, and set to the declared 0; through saved states."""
    names = ["terminal.i[1]", "terminal.i_step[2]", "flux[4]", "theta", "energy.stored", "energy.residual"]
    plain = units("synchronous_machine", k, version)
    more = units("synchronous_machine", k, version, impulses=True)
    with FMUInstance(plain) as one, FMUInstance(more) as two, FMUInstance(more) as three:
        for i in range(4):
            u = one.start_inputs() * (1.0 + 0.01 * i)
            three.at_nodes.set_impulses(np.zeros(5), -np.zeros(5))
            for unit in (one, two, three):
                unit.set_state(unit.get_state())
                unit.set_input(u)
                unit.do_step(i * 3 * STEP, 3 * STEP)
            assert one.get(names).tobytes() == two.get(names).tobytes() == three.get(names).tobytes()
        told = [[n for n in u.names if u.variable(n).causality != "input"] for u in (one, two)]
        assert told[0] == told[1]


def test_what_is_not_asked_for_is_not_there(units: Any, tmp_path: Path) -> None:
    """No file, no variable, no line of the manifest; where ports take no impulses, inputs at nodes bring none."""

    def inside(path: Path) -> tuple[set[str], str, str]:
        with zipfile.ZipFile(path) as archive:
            names = {n.removeprefix("sources/") for n in archive.namelist() if n.startswith("sources/")}
            return names, archive.read("sources/interface.c").decode(), archive.read(
                "extra/org.phfmu.ports/fmi-ls-manifest.xml"
            ).decode()  # fmt: skip

    own = {"impulses.c", "impulses.h", "ports.c"}
    files, text, manifest = inside(units("synchronous_machine", 1, "3.0"))
    assert not files & {*own, "fmu_nodes.c"} and "node_map" not in text and "mpulse" not in text + manifest
    files, text, manifest = inside(units("synchronous_machine", 1, "3.0", impulses=True))
    assert files >= {*own, "fmu_nodes.c"} and "terminal.v_impulse[1,2]" in text and 'impulse="pair"' in manifest
    (damped,) = export(build_model(spring(30.0, d=2.0), Collocated(2)), tmp_path, ("3.0",), step=0.1, node_inputs=True)
    files, text, manifest = inside(damped)
    assert "fmu_nodes.c" in files and not files & own and "mpulse" not in text and "impulse=" not in manifest
    with FMUInstance(damped) as unit:
        unit.set_node_inputs([[0.1, 0.0], [0.2, 0.1]])
        unit.do_step(0.0, 0.2)
        assert unit.at_nodes.node_sensitivity().nodes.shape == (2, 2, 4)
        with pytest.raises(StepFailure, match="is not an output at a node"):
            unit.at_nodes.node_sensitivity(end=True)
        with pytest.raises(ValueError, match="export it with --impulses"):
            unit.at_nodes.set_impulses([], [])


def test_impulses_that_no_port_takes_are_refused(tmp_path: Path) -> None:
    for model, words in (
        (build_model(build("resistor")), "no port takes impulses .terminal: it has feedthrough."),
        (build_model(build("rl_line"), Collocated(1, impulses=False)), "no port takes impulses"),
    ):
        with pytest.raises(FMUError, match=words):
            export(model, tmp_path, step=1e-3, impulses=True)


@pytest.mark.parametrize("version", VERSIONS)
def test_impulses_belong_to_the_state(units: Any, version: str) -> None:
    """Saved, serialised, restored; a reset forgets them."""
    path = units("synchronous_machine", 1, version, impulses=True)
    with FMUInstance(path) as unit, FMUInstance(path) as other:
        at = unit.at_nodes
        for i in range(2):
            at.set_impulses(*drawn(unit_model := model_of("synchronous_machine", 1), 5, i)[1])
            unit.do_step(i * STEP, STEP)
        saved = unit.get_state()
        data = unit.serialize(saved)

        def on(one: FMUInstance) -> bytes:
            one.do_step(2 * STEP, STEP)
            found = one.at_nodes.node_sensitivity(impulses=True, end=True)
            return one.get(["flux[1]", "energy.stored"]).tobytes() + found.nodes.tobytes() + found.end.tobytes()

        after = on(unit)
        at.set_impulses(np.ones(5), np.ones(5))
        unit.do_step(3 * STEP, STEP)
        unit.set_state(saved)
        assert on(unit) == after
        other.set_state(other.deserialize(data, saved))
        assert on(other) == after
        unit.reset()
        fresh = NativeInstance(unit_model)
        unit.do_step(0.0, STEP)
        fresh.do_step(0.0, STEP)
        assert np.array_equal(unit.end_output(), fresh.signal("y_end")[:5])


def test_a_step_that_fails_gives_its_impulse_back(units: Any) -> None:
    """And one with impulses does not end early."""
    with FMUInstance(units("body", 1, "3.0", step=0.1, impulses=True), early_return=True) as unit:
        before = unit.get(["q", "v", "energy.stored", "energy.supplied"]).tobytes()
        unit.at_nodes.set_impulses([1e200], [0.0])
        with pytest.raises((StepFailure, UnitFailure)):
            unit.do_step(0.0, 0.3)
        assert unit.time == 0.0 and unit.get(["q", "v", "energy.stored", "energy.supplied"]).tobytes() == before


@pytest.mark.parametrize("version", VERSIONS)
def test_the_work_of_impulses_is_what_the_states_say(units: Any, version: str) -> None:
    """s0.(y0 + S s0 / 2) + s1.(y1 - S s1 / 2), and sum of pairs = supplied = dH + dissipated."""
    model = model_of("synchronous_machine", 2)
    with FMUInstance(units("synchronous_machine", 2, version, impulses=True)) as unit:
        at, h = unit.at_nodes, 2 * STEP
        U, s = drawn(model, 5)
        at.set_node_inputs(U)
        at.set_impulses(*s)
        y0, S0 = unit.end_output(), at.jump()
        unit.do_step(0.0, h)
        nodes = h * np.einsum("i,ij,ij->j", np.array(unit.interface.weights), U, at.node_output())
        work = s[0] * (y0 + S0 @ s[0] / 2) + s[1] * (unit.end_output() - at.jump() @ s[1] / 2)
        pairs = unit.ledger()["pairs"]
        np.testing.assert_allclose(pairs, nodes + work, rtol=0, atol=1e-12 * np.abs(nodes).max())
        assert pairs.sum() == pytest.approx(unit.ledger()["supplied"][0], rel=1e-13)


def test_ports_that_count_outward_take_their_impulses_outward(units: Any, tmp_path: Path) -> None:
    """The unit's force counts out of it, and so does its impulse; the reader takes both back."""
    model = model_of("body", 2)
    (path,) = export(model, tmp_path, ("3.0",), step=0.1, node_inputs=True, outward=["flange"])
    with FMUInstance(path) as out, FMUInstance(units("body", 2, "3.0", step=0.1, node_inputs=True)) as inward:
        for unit in (out, inward):
            unit.set_node_inputs([[0.3], [0.5]])
            unit.at_nodes.set_impulses([0.1], [-0.2])
            unit.do_step(0.0, 0.1)
        assert np.array_equal(out.get(["flange.force_impulse[1]"]), [-0.1])
        assert np.array_equal(out.get(["q", "v"]), inward.get(["q", "v"]))
        a, b = (u.at_nodes.node_sensitivity(impulses=True, end=True) for u in (out, inward))
        assert np.array_equal(a.nodes, b.nodes) and np.array_equal(a.end, b.end)
        assert np.array_equal(out.ledger()["pairs"], inward.ledger()["pairs"])


def test_derivatives_of_different_kinds_are_not_mixed(units: Any) -> None:
    """Held inputs as ever; the error names the variable."""
    with FMUInstance(units("synchronous_machine", 2, "3.0", impulses=True)) as unit:
        unit.do_step(0.0, STEP)
        at, values = unit.at_nodes, unit._values
        held = unit.sensitivity()
        nodes = at.node_sensitivity().nodes.reshape(2, 5, 2, 5)
        b = np.array(unit.interface.weights)
        np.testing.assert_allclose(np.einsum("i,iajc->ac", b, nodes), held, rtol=1e-10, atol=1e-12 * np.abs(held).max())
        known = replace(values.u.scalars[0])
        with pytest.raises(FMUError, match=r"'terminal.i_node\[1,1\]' is an output at a node"):
            at._slave.derivative(at._derivative(False, values.y_nodes, known))
        with pytest.raises(FMUError, match="is neither an output at a node nor one at the present time"):
            at._slave.derivative(at._derivative(True, values.y_mean, values.u_nodes.scalars[0]))


def test_hardening_ports_offer_the_end_kind(units: Any) -> None:
    """The energy is not quadratic along the impulse: work by a Gauss rule, told in the manifest."""
    with FMUInstance(units("stiffening", 1, "2.0", step=0.1, impulses=True)) as unit:
        (port,) = unit.at_nodes.impulse_ports
        assert (port.kind, port.linear) == ("end", False) and "not quadratic" in port.reason
        unit.at_nodes.set_impulses([0.2], [0.1])
        unit.do_step(0.0, 0.1)
        dH = np.cosh(1.5 * unit.get(["x"])[0]) - np.cosh(1.5 * 0.2)
        assert unit.ledger()["pairs"][0] == pytest.approx(dH, rel=1e-9)
