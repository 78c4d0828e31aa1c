"""Instances of units: saved states, sensitivities, refusals, foreign units."""

from __future__ import annotations

import gc
import re
import zipfile
from collections.abc import Callable
from pathlib import Path

import fmpy
import numpy as np
import pytest

from phfmu import ELECTRICAL, PHDAE, Port, algebraic, damping, energy, parameter, skew, state
from phfmu.components.mechanical.four_particle import four_particle
from phfmu.components.mechanical.translational import mass
from phfmu.discretise.model import build_model
from phfmu.engine.native.native import NativeInstance
from phfmu.fmu.export.export import export
from phfmu.fmu.export.manifest import PATH, PortMap
from phfmu.fmu.export.variables import FMUError
from phfmu.fmu.importer.reader import FMUInstance
from phfmu.fmu.importer.values import Derivative
from phfmu.fmu.version import VERSIONS as ROWS
from phfmu.outcome.status import Status, StepFailure

VERSIONS = ["2.0", "3.0"]
STEP = 1e-3


def circuit() -> PHDAE:
    """A saturating coil behind a resistor with two ports, one driven by voltage and one by current.

    H = 1/2 a psi^2 + 1/4 b psi^4 + 1/2 Q^2/C;  the node between them is an algebraic variable.
    """
    psi, charge = state("psi", unit="Wb", start=0.2), state("Q", unit="C", start=1e-3, nominal=1e-3)
    a, b, c = parameter("a", 3.0, unit="1/H"), parameter("b", 40.0), parameter("C", 1e-3, unit="F")
    i = algebraic("i", unit="A", description="current of the resistor")
    return PHDAE(
        "circuit",
        states=(psi, charge),
        algebraics=(i,),
        parameters=(a, b, c),
        energies=(energy(0.5 * a * psi**2 + 0.25 * b * psi**4), energy(0.5 * charge**2 / c)),
        structure=(skew(psi, charge, 1.0), skew(i, charge, -1.0)),
        dissipation=(damping(i, 0.7), damping(psi, 2.0)),
        ports=(
            Port("line", ELECTRICAL, "effort", {i: 1.0}, description="behind the resistor"),
            Port("load", ELECTRICAL, "flow", {charge: 1.0}, description="at the capacitor"),
        ),
    )


@pytest.fixture(scope="session")
def circuits(tmp_path_factory: pytest.TempPathFactory):
    """(model, {version: path}) of the circuit."""
    declaration = circuit()
    model = build_model(declaration)
    paths = export(model, tmp_path_factory.mktemp("circuit"), step=STEP, stop=1.0)
    return model, dict(zip(VERSIONS, paths, strict=True))


@pytest.fixture(scope="session")
def particles(tmp_path_factory: pytest.TempPathFactory) -> dict[str, Path]:
    declaration = four_particle()
    paths = export(build_model(declaration), tmp_path_factory.mktemp("particles"), step=0.01)
    return dict(zip(VERSIONS, paths, strict=True))


def drive(unit: FMUInstance, steps: range, u: Callable[[int], list[float]] | None = None) -> None:
    for k in steps:
        if unit.nu:
            unit.set_input(u(k) if u else [5.0 * np.sin(0.1 * k), 0.3 * np.cos(0.07 * k)])
        unit.do_step(k * STEP, STEP)


def bits(unit: FMUInstance) -> bytes:
    return np.array(list(unit.values().values())).tobytes()


@pytest.mark.parametrize("version", VERSIONS)
def test_a_restored_state_continues_bit_by_bit(circuits, version: str) -> None:
    with FMUInstance(circuits[1][version]) as unit:
        drive(unit, range(37))
        state = unit.get_state()
        drive(unit, range(37, 137))
        end = bits(unit)
        ledger = unit.ledger()
        unit.set_state(state)
        assert unit.time == pytest.approx(0.037)
        drive(unit, range(37, 137))
        assert bits(unit) == end
        for key, value in unit.ledger().items():
            np.testing.assert_array_equal(value, ledger[key])


@pytest.mark.parametrize("version", VERSIONS)
@pytest.mark.parametrize("which", ["circuits", "particles"])
def test_a_serialized_state_continues_in_a_second_instance(
    request: pytest.FixtureRequest, which: str, version: str
) -> None:
    found = request.getfixturevalue(which)
    path = (found[1] if isinstance(found, tuple) else found)[version]
    with FMUInstance(path) as one, FMUInstance(path) as two:
        drive(one, range(20))
        state = one.get_state()
        data = one.serialize(state)
        assert len(data) == len(one.serialize(one.get_state()))
        drive(two, range(7))
        two.set_state(two.deserialize(data, state))
        for unit in (one, two):
            drive(unit, range(20, 120))
        assert bits(one) == bits(two)
        with pytest.raises(FMUError, match="is not one of this model"):
            two.deserialize(b"x" * len(data), state)
        with pytest.raises(FMUError, match="bytes given"):
            two.deserialize(data[:-1], state)
        for place in (70, len(data) // 2, len(data) - 1):
            damaged = bytearray(data)
            damaged[place] ^= 1
            with pytest.raises(FMUError, match="the state is damaged"):
                two.deserialize(bytes(damaged), state)


@pytest.mark.parametrize("version", VERSIONS)
def test_a_library_that_cannot_be_loaded_leaves_the_working_directory(circuits, tmp_path: Path, version: str) -> None:
    """FMPy changes to the folder of the library to load it."""
    broken, here = tmp_path / "broken.fmu", Path.cwd()
    with zipfile.ZipFile(circuits[1][version]) as whole, zipfile.ZipFile(broken, "w") as archive:
        for name in whole.namelist():
            archive.writestr(name, b"no library" if name.startswith("binaries/") else whole.read(name))
    with pytest.raises(FMUError, match="load shared library"):
        FMUInstance(broken)
    assert Path.cwd() == here


@pytest.mark.parametrize("version", VERSIONS)
def test_reset_starts_again(circuits, version: str) -> None:
    with FMUInstance(circuits[1][version], starts={"psi": 0.3, "a": 4.0}) as unit:
        start = bits(unit)
        assert unit.get(["psi", "a"]).tolist() == [0.3, 4.0]
        drive(unit, range(30))
        end = bits(unit)
        unit.reset()
        assert bits(unit) == start
        drive(unit, range(30))
        assert bits(unit) == end


@pytest.mark.parametrize("version", VERSIONS)
def test_sensitivity_is_the_derivative_of_the_step_map(circuits, version: str) -> None:
    with FMUInstance(circuits[1][version]) as unit:
        drive(unit, range(25))
        state, u, t = unit.get_state(), np.array([2.0, -0.4]), 25 * STEP

        def outputs(value: np.ndarray) -> np.ndarray:
            unit.set_state(state)
            unit.set_input(value)
            unit.do_step(t, STEP)
            return unit.output()

        difference = np.zeros((2, 2))
        for j, d in enumerate(1e-4 * np.eye(2)):
            difference[:, j] = (outputs(u + d) - outputs(u - d)) / 2e-4
        outputs(u)
        s = unit.sensitivity()
        np.testing.assert_allclose(s, difference, rtol=1e-7, atol=1e-9)
        assert np.linalg.eigvalsh(s + s.T).min() > 0, "a step map of a passive component is monotone"
        native = NativeInstance(circuits[0])
        for k in range(25):
            native.set_input([5.0 * np.sin(0.1 * k), 0.3 * np.cos(0.07 * k)])
            native.do_step(k * STEP, STEP)
        native.set_input(u)
        native.do_step(t, STEP)
        np.testing.assert_array_equal(s, native.sensitivity())


@pytest.mark.parametrize("version", VERSIONS)
def test_directional_derivatives_of_other_pairs_are_refused(circuits, version: str) -> None:
    with FMUInstance(circuits[1][version]) as unit:
        drive(unit, range(2))
        ref = {n: v.reference for n, v in unit.interface.variables.items()}

        def slope(unknowns: list[str], known: str) -> np.ndarray:
            group = unit._slave.references([unit.variable(n) for n in unknowns])
            return unit._slave.derivative(Derivative(group, unit.variable(known), ROWS[version]))

        for unknown, known, words in (
            ("load.i", "line.v", "'load.i' is not an output of an external port"),
            ("line.i_step", "line.i", "'line.i' is not an input of a port"),
            ("line.v", "psi", "'line.v' has no derivative"),
            ("psi", "line.i", "'line.i' is no state, parameter or input to derive by"),
        ):
            with pytest.raises(FMUError, match=words):
                slope([unknown], known)
        end = slope(["line.i", "load.v"], "line.v")
        assert end == pytest.approx([1 / 0.7, 0.0]), "i = (v - v_C) / R at the present time, v_C is a state"
        adjoint = getattr(unit._slave.fmu, "getAdjointDerivative", None)
        if adjoint:
            rows, columns = [ref["line.i_step"], ref["load.v_step"]], [ref["line.v"], ref["load.i"]]
            assert adjoint(rows, columns, [0.0, 1.0]) == pytest.approx(unit.sensitivity()[1].tolist(), rel=1e-15)


@pytest.mark.parametrize("version", VERSIONS)
def test_many_internal_steps_keep_the_power_product_exact(circuits, version: str) -> None:
    model, paths = circuits
    native = NativeInstance(model)
    with FMUInstance(paths[version]) as unit:
        for k in range(20):
            h, u = 3.7 * STEP, [5.0 * np.sin(0.3 * k), 0.2]
            unit.set_input(u)
            native.set_input(u)
            unit.do_step(k * h, h)
            native.do_step(k * h, h, 4)
            book = unit.ledger()
            assert book["pairs"].sum() == pytest.approx(book["supplied"][0], rel=1e-13)
            np.testing.assert_array_equal(unit.output(), native.output())
            np.testing.assert_allclose(unit.sensitivity(), native.sensitivity(), rtol=1e-12)
        assert abs(unit.get(["energy.residual"])[0]) < 1e-15


def test_interleaved_instances_do_not_see_each_other(circuits) -> None:
    paths = circuits[1]

    def alone(version: str, gain: float) -> bytes:
        with FMUInstance(paths[version]) as unit:
            drive(unit, range(60), lambda k: [gain * k, 0.0])
            return bits(unit)

    expected = [alone("2.0", 0.1), alone("3.0", -0.2)]
    with (
        FMUInstance(paths["2.0"]) as one,
        FMUInstance(paths["3.0"]) as two,
        FMUInstance(paths["2.0"]) as other,
    ):
        for k in range(60):
            drive(one, range(k, k + 1), lambda k: [0.1 * k, 0.0])
            drive(two, range(k, k + 1), lambda k: [-0.2 * k, 0.0])
            drive(other, range(k, k + 1))
        assert [bits(one), bits(two)] == expected


@pytest.mark.parametrize("version", VERSIONS)
def test_values_that_are_not_finite_or_not_settable_are_refused_by_name(circuits, version: str) -> None:
    path = circuits[1][version]
    with FMUInstance(path) as unit:
        before = bits(unit)
        reference = unit._values.u
        reference.values[:] = [np.nan, 1.0]
        with pytest.raises(FMUError, match="'line.v' = -?nan is not finite"):
            unit._slave.set(reference)
        assert bits(unit) == before
        with pytest.raises(ValueError, match="2 finite inputs"):
            unit.set_input([np.inf, 0.0])
        with pytest.raises(StepFailure, match="the step starts at t = 1 s, the component is at t = 0 s") as failure:
            unit.do_step(1.0, STEP)
        assert "Step from where the last step ended" in str(failure.value) and "Gauss" not in str(failure.value)
        with pytest.raises(StepFailure, match="must be positive"):
            unit.do_step(0.0, -STEP)
        with pytest.raises(FMUError, match="has no variable 'psy'; did you mean psi"):
            unit.get(["psy"])
    with pytest.raises(FMUError, match="'line.i' is calculated and cannot be set"):
        FMUInstance(path, starts={"line.i": 1.0})
    with FMUInstance(path, stop=2.5 * STEP) as unit:
        drive(unit, range(2))
        with pytest.raises(StepFailure, match="after the stop time"):
            unit.do_step(2 * STEP, STEP)


@pytest.mark.parametrize("version", VERSIONS)
def test_calls_out_of_their_mode_are_refused(circuits, version: str) -> None:
    with FMUInstance(circuits[1][version]) as unit:
        fixed = unit._slave.references([unit.variable("C"), unit.variable("line.v")])
        fixed.values[:] = [2.0, 3.0]
        with pytest.raises(FMUError, match="'C' is fixed after initialization"):
            unit._slave.set(fixed)
        assert unit.get(["line.v"]) == 0.0, "a refused call changes nothing"
        with pytest.raises(FMUError, match="ExitInitializationMode is not allowed in the mode 'Step Mode'"):
            unit._slave.leave()
        unit._slave.call(unit._slave.fmu.terminate)
        assert unit.get(["psi"]) == pytest.approx(0.2)
        with pytest.raises(StepFailure, match="DoStep is not allowed in the mode 'Terminated'"):
            unit.do_step(0.0, STEP)
        unit.reset()
        unit.do_step(0.0, STEP)


@pytest.mark.parametrize("version", VERSIONS)
def test_an_inconsistent_start_is_refused(particles: dict[str, Path], version: str) -> None:
    with pytest.raises(FMUError, match=r"inconsistent: constraint.position.lambda\[1\] = 0.05.*allowed"):
        FMUInstance(particles[version], starts={"q[4]": np.sqrt(1.1)})
    with pytest.raises(FMUError, match=r"inconsistent: constraint.velocity.lambda\[1\] = 0.3"):
        FMUInstance(particles[version], starts={"v[4]": 0.3})


def hard() -> PHDAE:
    """H = -log(1 - q^2): no state at or beyond q = 1, so a strong pull has no solution."""
    q = state("q", unit="m", start=0.5)
    from casadi import log

    return PHDAE(
        "hard", states=(q,), energies=(energy(-log(1.0 - q.sx**2)),),
        ports=(Port("end", ELECTRICAL, "flow", {q: 1.0}),),
    )  # fmt: skip


@pytest.mark.parametrize("version", VERSIONS)
def test_a_refused_step_names_the_equation_and_leaves_the_state(tmp_path: Path, version: str) -> None:
    declaration = hard()
    (path,) = export(build_model(declaration), tmp_path, (version,), step=0.1)
    with FMUInstance(path) as unit:
        unit.set_input([0.1])
        unit.do_step(0.0, 0.1)
        before = unit.get(["q"])
        unit.set_input([1e3])
        with pytest.raises(StepFailure, match=r"Worst: .*back at t = 0.1 s") as failure:
            unit.do_step(0.1, 0.1)
        assert failure.value.status in (Status.NO_CONVERGENCE, Status.NOT_FINITE)
        assert unit.get(["q"]) == before
        unit.set_input([0.1])
        unit.do_step(0.1, 0.1)
        assert unit.get(["q"])[0] == pytest.approx(0.52)


def rewritten(
    source: Path, target: Path, change: Callable[[str, bytes], bytes | None], extra: dict[str, bytes]
) -> Path:
    with zipfile.ZipFile(source) as old, zipfile.ZipFile(target, "w") as new:
        for name in old.namelist():
            data = change(name, old.read(name))
            if data is not None:
                new.writestr(name, data)
        for name, data in extra.items():
            new.writestr(name, data)
    return target


def keep(_: str, data: bytes) -> bytes:
    return data


def in_description(change: Callable[[bytes], bytes]) -> Callable[[str, bytes], bytes]:
    return lambda name, data: change(data) if name == "modelDescription.xml" else data


def entity(data: bytes) -> bytes:
    head, body = data.split(b"\n", 1)
    return head + b'\n<!DOCTYPE x [<!ENTITY e SYSTEM "file:///etc/passwd">]>\n' + body.replace(b"circuit", b"&e;", 1)


@pytest.mark.parametrize("version", VERSIONS)
def test_bad_archives_are_refused_with_one_clear_error(circuits, tmp_path: Path, version: str) -> None:
    good, bad = circuits[1][version], tmp_path / "bad.fmu"
    with pytest.raises(FMUError, match="there is no such file"):
        FMUInstance(bad)
    bad.write_bytes(good.read_bytes()[:-1000])
    with pytest.raises(FMUError, match="not a readable archive"):
        FMUInstance(bad)
    content = bytearray(good.read_bytes())
    content[2000:2400] = bytes(400)
    bad.write_bytes(content)
    with pytest.raises(FMUError, match=re.escape(str(bad))):
        FMUInstance(bad)
    cases: list[tuple[Callable[[str, bytes], bytes | None], dict[str, bytes], str]] = [
        (keep, {"../evil.txt": b""}, "holds the path '../evil.txt'"),
        (keep, {"resources/../../evil.txt": b""}, "leaves its folder"),
        (keep, {"/evil.txt": b""}, "leaves its folder"),
        (lambda n, d: None if n == "modelDescription.xml" else d, {}, "no modelDescription.xml"),
        (lambda n, d: None if n.startswith("binaries/") else d, {"binaries/amiga/circuit.so": b""},
         "no library for this platform .*; the archive has amiga"),
        (in_description(entity), {}, "document type definition"),
        (in_description(lambda d: d[:-20]), {}, "not well formed"),
        (in_description(lambda d: d.decode().encode("utf-16")), {}, "not in UTF-8"),
        (in_description(lambda d: d.replace(b'fmiVersion="%s"' % version.encode(), b'fmiVersion="1.0"')), {},
         "FMI version '1.0'"),
        (in_description(lambda d: d.replace(b"CoSimulation", b"Other")), {}, "no Co-Simulation interface"),
        (in_description(lambda d: re.sub(rb'(guid|Token)="[^"]*"', rb'\1="{0}"', d)), {}, r"token '\{0\}'"),
    ]  # fmt: skip
    for i, (change, extra, words) in enumerate(cases):
        path = rewritten(good, tmp_path / f"bad{i}.fmu", change, extra)
        with pytest.raises(FMUError, match=words):
            FMUInstance(path)
    assert not (tmp_path / "evil.txt").exists() and not (tmp_path.parent / "evil.txt").exists()


def test_a_link_in_the_archive_is_refused(circuits, tmp_path: Path) -> None:
    path = rewritten(circuits[1]["3.0"], tmp_path / "link.fmu", keep, {})
    with zipfile.ZipFile(path, "a") as archive:
        info = zipfile.ZipInfo("resources/link")
        info.external_attr = 0o120777 << 16
        archive.writestr(info, "/etc/passwd")
    with pytest.raises(FMUError, match="holds the link 'resources/link'"):
        FMUInstance(path)


@pytest.mark.parametrize("version", VERSIONS)
def test_a_foreign_unit_is_stepped_with_a_port_map_and_its_ledger_is_an_estimate(
    circuits, tmp_path: Path, version: str
) -> None:
    path = rewritten(circuits[1][version], tmp_path / "foreign.fmu", lambda n, d: None if n == PATH else d, {})
    ports = [
        PortMap("line", ELECTRICAL, "effort", ("line.v",), ("line.i",)),
        PortMap("load", ELECTRICAL, "flow", ("load.i",), ("load.v",), sign=-1.0),
    ]
    with FMUInstance(path) as unit:
        assert unit.nu == 0 and unit.estimated
    with FMUInstance(path, ports) as unit, FMUInstance(circuits[1][version]) as own:
        assert unit.estimated and not own.estimated
        total = exact = 0.0
        for k in range(100):
            for instance in (unit, own):
                drive(instance, range(k, k + 1), lambda k: [5.0 * np.sin(0.02 * k), 0.0])
            total, exact = total + unit.ledger()["supplied"][0], exact + own.ledger()["supplied"][0]
        assert total == pytest.approx(exact, rel=5e-2) and total != exact
        assert unit.energies()[0] == pytest.approx(total)
        unit.set_input([2.0, 0.1])  # the current of the load counts out of the unit, its voltage is the same
        own.set_input([2.0, -0.1])
        assert unit.get(["load.i"])[0] == own.get(["load.i"])[0] == -0.1
        np.testing.assert_array_equal(unit.end_output(), own.end_output())
        with pytest.raises(StepFailure) as failure:
            unit.sensitivity()
        assert failure.value.status is Status.NO_SENSITIVITY
        state = unit.get_state()
        drive(unit, range(100, 110))
        end = unit.output().copy(), unit.energies()
        unit.set_state(state)
        drive(unit, range(100, 110))
        np.testing.assert_array_equal(np.concatenate([unit.output(), unit.energies()]), np.concatenate(end))
    with pytest.raises(FMUError, match="has no input 'line.u'; did you mean"):
        FMUInstance(path, [PortMap("line", ELECTRICAL, "effort", ("line.u",), ("line.i",))])
    with pytest.raises(FMUError, match="'line.i' is no input but output"):
        FMUInstance(path, [PortMap("line", ELECTRICAL, "effort", ("line.i",), ("line.i",))])
    with pytest.raises(FMUError, match="1 inputs but 2 outputs"):
        FMUInstance(path, [PortMap("line", ELECTRICAL, "effort", ("line.v",), ("line.i", "load.v"))])


def test_a_unit_that_cannot_save_says_so(circuits, tmp_path: Path) -> None:
    change = in_description(lambda d: d.replace(b'canGetAndSetFMUState="true"', b'canGetAndSetFMUState="false"'))
    path = rewritten(circuits[1]["3.0"], tmp_path / "forgetful.fmu", change, {})
    with (
        FMUInstance(path) as unit,
        pytest.raises(FMUError, match="cannot save its state, .*step it last .*--coupling gauss-seidel, or export it"),
    ):
        unit.get_state()


@pytest.mark.parametrize("version", VERSIONS)
def test_saved_states_and_instances_are_freed(circuits, version: str, monkeypatch: pytest.MonkeyPatch) -> None:
    from phfmu.fmu.importer.slave import Slave

    freed: list[str] = []
    forget, free = Slave.forget, Slave.free
    monkeypatch.setattr(Slave, "forget", lambda self, h: (freed.append("state"), forget(self, h))[1])
    monkeypatch.setattr(Slave, "free", lambda self: (freed.append("unit"), free(self))[1])
    unit = FMUInstance(circuits[1][version])
    first, second = unit.get_state(), unit.get_state()
    del first
    gc.collect()
    assert freed == ["state"]
    unit.close()
    unit.close()
    del second
    gc.collect()
    assert freed == ["state", "state", "unit"]


def test_what_a_unit_says_about_its_ports(circuits) -> None:
    with FMUInstance(circuits[1]["3.0"], starts={"line.v": 1.5}) as unit:
        assert [(p.name, p.domain, p.given, p.n, p.size) for p in unit.interface.declared_ports()] == [
            ("line", ELECTRICAL, "effort", 1, None),
            ("load", ELECTRICAL, "flow", 1, None),
        ]
        assert unit.inputs == ["line.v", "load.i"]
        assert unit.start_inputs().tolist() == [1.5, 0.0]
        assert unit.variable("line.i_step").unit == "A"
        assert unit.interface.derivatives and unit.interface.saves and unit.interface.step == STEP


def test_fmpy_does_not_see_the_flag_we_read(circuits) -> None:
    """The reason the model description is read here and not by FMPy."""
    about = fmpy.read_model_description(str(circuits[1]["3.0"]))
    assert about.coSimulation is not None
    with FMUInstance(circuits[1]["3.0"]) as unit:
        assert unit.interface.derivatives


def test_a_reference_of_its_own_for_a_mass_with_a_known_solution(tmp_path: Path) -> None:
    """m v' = F - k q: one period later the mass is where it was, to the order of the scheme."""
    declaration = mass(1.0, k=4.0 * np.pi**2, q=1.0)
    (path,) = export(build_model(declaration), tmp_path, ("2.0",), step=1e-3)
    with FMUInstance(path) as unit:
        for k in range(1000):
            unit.do_step(k * 1e-3, 1e-3)
        assert unit.get(["q", "v"]) == pytest.approx([1.0, 0.0], abs=3e-5 * 2 * np.pi)
        assert unit.get(["energy.stored"])[0] == pytest.approx(2 * np.pi**2, rel=1e-13)
