"""Exported units: valid, equal to the engines, the same bytes twice, native without an interpreter."""

from __future__ import annotations

import re
import shutil
import subprocess
import sys
import zipfile
from pathlib import Path

import fmpy
import numpy as np
import pytest
from fmpy.validation import validate_fmu
from lxml import etree

from phfmu import (
    PHDAE,
    Domain,
    Holonomic,
    Port,
    algebraic,
    damping,
    energy,
    observable,
    parameter,
    skew,
    state,
)
from phfmu.components.electrical.rl_line import rl_line
from phfmu.components.mechanical.four_particle import four_particle
from phfmu.components.mechanical.translational import mass
from phfmu.discretise.model import Model, build_model
from phfmu.engine.compile import compile
from phfmu.engine.native import NativeInstance
from phfmu.engine.python import PythonInstance
from phfmu.fmu import sources
from phfmu.fmu.description import Unit
from phfmu.fmu.export import PLATFORMS, export
from phfmu.fmu.reader import FMUInstance
from phfmu.fmu.variables import FMUError, variables
from phfmu.network.junctions.network import Network
from phfmu.schemes.collocated import Collocated
from tests.wide import wide

HERE = Path(__file__).parent
SCHEMA = Path(str(fmpy.__file__)).parent / "schema" / "fmi3"


PULL = Domain("pull", "f", "N", "v", "m/s", "flow")


def pendulum() -> PHDAE:
    """A point mass on a rod in the plane, driven by a force: a constraint, a vector port, two observables."""
    q = state("q", 2, unit="m", start=[0.6, -0.8], description="position")
    v = state("v", 2, unit="m/s", description="velocity")
    lam = algebraic("lambda", 1, unit="N/m", description="multiplier of the rod")
    m, g = parameter("m", 1.5, unit="kg"), parameter("g", 9.81, unit="m/s2")
    return PHDAE(
        "pendulum",
        states=(q, v),
        algebraics=(lam,),
        parameters=(m, g),
        energies=(energy(0.5 * m * (v[0] ** 2 + v[1] ** 2)), energy(m.sx * g.sx * q[1])),
        E={v: m},
        structure=(skew(q, v, 1.0),),
        dissipation=(damping(v, 0.1),),
        constraints=(Holonomic(lam, 0.5 * (q[0] ** 2 + q[1] ** 2 - 1.0)),),
        ports=(Port("hand", PULL, "effort", {v: 1.0}, size=2, description="force on the mass"),),
        observables=(
            observable("length", q[0] ** 2 + q[1] ** 2, unit="m2"),
            observable("p", m * v.sx, unit="kg.m/s"),
        ),
        description="pendulum <of> a rod & a mass",
    )


def chain() -> PHDAE:
    """Two lines in series: a composed model with members and a joined port."""
    network = Network("chain")
    network.add("near", rl_line(0.3, 0.2, i=(1.0, -0.5, -0.5)))
    network.add("far", rl_line(0.1, 0.4, i=(1.0, -0.5, -0.5)))
    network.junction("bus", ["near.b", "far.a"])
    return network.compose()


MODELS = {
    "mass": (lambda: mass(2.0, k=100.0, d=0.5, q=0.1), None, 1e-2),
    "line": (lambda: rl_line(0.3, 0.2), Collocated(2), 1e-3),
    "pendulum": (pendulum, None, 5e-3),
    "four_particle": (four_particle, None, 1e-2),
    "chain": (chain, None, 1e-3),
}
#: with parameters, with ports of many entries, with constraints
QUICK = ("mass", "line", "four_particle")


def build(name: str) -> tuple[PHDAE, Model, float]:
    make, scheme, step = MODELS[name]
    declaration = make()
    return declaration, build_model(declaration, scheme), step


@pytest.fixture(scope="session")
def exported(tmp_path_factory: pytest.TempPathFactory):
    """name -> (declaration, model, step, {version: path}); every unit is written once."""
    made: dict[str, tuple[PHDAE, Model, float, dict[str, Path]]] = {}

    def get(name: str):
        if name not in made:
            declaration, model, step = build(name)
            paths = export(model, tmp_path_factory.mktemp(name), step=step, stop=100 * step)
            made[name] = declaration, model, step, dict(zip(("2.0", "3.0"), paths, strict=True))
        return made[name]

    return get


@pytest.mark.parametrize("version", ["2.0", "3.0"])
@pytest.mark.parametrize("name", wide(MODELS, *QUICK))
def test_units_are_valid(exported, name: str, version: str) -> None:
    path = exported(name)[3][version]
    assert validate_fmu(str(path)) == []
    with zipfile.ZipFile(path) as archive:
        parts = {"terminalsAndIcons/terminalsAndIcons.xml": "fmi3TerminalsAndIcons.xsd",
                 "sources/buildDescription.xml": "fmi3BuildDescription.xsd"}  # fmt: skip
        for part, schema in parts.items():
            if part in archive.namelist():
                etree.XMLSchema(file=str(SCHEMA / schema)).assertValid(etree.fromstring(archive.read(part)))
        listed = etree.fromstring(archive.read("sources/buildDescription.xml")).findall(".//SourceFile")
        assert all(f"sources/{f.get('name')}" in archive.namelist() for f in listed)
        assert not [n for n in archive.namelist() if n.endswith(("fmi2Functions.h", "fmi3Functions.h"))]
        terminals = "terminalsAndIcons/terminalsAndIcons.xml" in archive.namelist()
        assert terminals == (exported(name)[1].step.nu > 0), "a unit without ports has no file about them"


@pytest.mark.parametrize("version", ["2.0", "3.0"])
@pytest.mark.parametrize("name", wide(MODELS, *QUICK))
def test_unit_equals_the_engines(exported, name: str, version: str) -> None:
    declaration, model, h, paths = exported(name)
    n, nu = 100, model.step.nu
    inputs = [name for p in declaration.ports if p.external for name in p.input_names()]
    u = np.sin(0.2 * np.arange(n + 1))[:, None] * (1.0 + np.arange(nu))
    signals = np.zeros(n + 1, [("time", float), *((name, float) for name in inputs)])
    signals["time"] = h * np.arange(n + 1)
    for j, column in enumerate(inputs):
        signals[column] = u[:, j]
    states = [name for v in declaration.states for name in v.names()]
    means = [name for p in declaration.ports if p.external for name in p.output_names("_step")]
    names = states + means + ["energy.stored", "energy.dissipated", "energy.residual"]

    python, native = PythonInstance(model), NativeInstance(model)
    rows = []
    # FMPy interpolates inputs, so it is given a table of steps: both engines hold u_k over step k
    with FMUInstance(paths[version]) as unit:
        for k in range(n):
            for instance in (python, native, unit):
                instance.set_input(u[k])
                instance.do_step(k * h, h)
            rows.append(unit.get(names))
            np.testing.assert_array_equal(unit.output(), native.output())
            for key, value in native.ledger().items():
                if key not in ("pairs", "numerical"):  # units do not tell these
                    np.testing.assert_allclose(unit.ledger()[key], value.sum(), rtol=1e-14, atol=1e-300)
        scale = np.abs(rows).max(axis=0) + 1e-9
        signals_now = python.signals()
        expected = np.concatenate([signals_now["x"][: len(states)], python.output(),
                                   [signals_now["H"].sum(), signals_now["dissipated"].sum()]])  # fmt: skip
        np.testing.assert_array_less(np.abs(rows[-1][:-1] - expected) / scale[:-1], 1e-11)
        moved = np.abs(unit.get(["energy.stored", "energy.supplied", "energy.dissipated"])).sum()
        assert abs(rows[-1][-1]) <= 1e-14 * n * (moved + 1.0), "the ledger of the unit closes"


@pytest.mark.parametrize("version", ["2.0", "3.0"])
def test_simulate_fmu_runs_it_with_other_start_values(exported, version: str) -> None:
    _, model, h, paths = exported("mass")
    start = {"q": 0.3, "k": 250.0}
    result = fmpy.simulate_fmu(
        str(paths[version]),
        stop_time=100 * h,
        output_interval=h,
        start_values=start,
        output=["q", "v"],
    )
    native = NativeInstance(model)
    native.set_parameters([2.0, 250.0, 0.5])
    native.set_x(0.0, [0.3, 0.0])
    native.initialise()
    for k in range(100):
        native.do_step(k * h, h)
    assert len(result) == 101
    np.testing.assert_allclose([result["q"][-1], result["v"][-1]], native.x, rtol=1e-11)


def test_same_model_same_bytes(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    def written(folder: str) -> list[bytes]:
        declaration, model, step = build("pendulum")
        return [p.read_bytes() for p in export(model, tmp_path / folder, step=step, stop=1.0)]

    first = written("a")
    assert written("b") == first
    monkeypatch.setenv("SOURCE_DATE_EPOCH", "1700000000")
    dated = written("c")
    assert written("d") == dated != first
    text = zipfile.ZipFile(tmp_path / "c" / "pendulum_fmi3.fmu").read("modelDescription.xml")
    assert b'generationDateAndTime="2023-11-14T22:13:20Z"' in text


def test_token_belongs_to_the_content() -> None:
    declaration, model, step = build("mass")
    token = [
        sources.token(unit, sources.generated(unit))
        for unit in (
            Unit(model, step),
            Unit(model, step),
            Unit(model, 2 * step),
            Unit(build_model(declaration.with_starts({"k": 99.0})), step),
        )
    ]
    assert token[0] == token[1]
    assert len(set(token)) == 3
    assert all(len(t) == 38 for t in token)


def test_names_are_those_of_the_contract(exported) -> None:
    declaration, model, _, _ = exported("pendulum")
    v = {v.name: v for v in variables(model)}
    names = "hand.f[1] hand.v[2] hand.v_step[2] hand.energy lambda[1] lambda_end[1] p[2] energy.residual"
    assert {*names.split(), "constraint.position.lambda[1]", "constraint.velocity.lambda[1]"} <= set(v)
    assert (v["q[1]"].causality, v["q[1]"].initial, v["q[1]"].start) == ("local", "exact", 0.6)
    assert (v["m"].causality, v["m"].variability) == ("parameter", "fixed")
    composed, model, _, _ = exported("chain")
    names = {v.name: v for v in variables(model)}
    assert names["near.energy.stored"].causality == "local"
    assert names["energy.stored"].count == len(model.members)
    assert names["far.a.i_step[3]"].causality == "local", "joined inside"
    assert names["far.b.i_step[3]"].causality == "output"


def test_illegal_and_repeated_names_are_refused_together(tmp_path: Path) -> None:
    q = state("q 1", unit="m", start=1.0)
    declaration = PHDAE("bad", states=(q,), energies=(energy(0.5 * q.sx**2),), parameters=(parameter("time", 1.0),))
    with pytest.raises(FMUError, match="'q 1' is no structured name.*two variables are called 'time'"):
        export(build_model(declaration), tmp_path, step=0.1)
    declaration, model, _ = build("mass")
    with pytest.raises(FMUError, match="step = 0"):
        export(model, tmp_path, step=0.0)
    with pytest.raises(FMUError, match="known: 2.0, 3.0"):
        export(model, tmp_path, versions=("1.0",), step=0.1)
    with pytest.raises(FMUError, match="unknown platform amiga"):
        export(model, tmp_path, step=0.1, platforms=["amiga"])
    assert not list(tmp_path.iterdir())


def test_without_a_step_time_terminals_or_members_nothing_is_written_about_them(exported, tmp_path: Path) -> None:
    declaration, model, _, paths = exported("four_particle")
    (path,) = export(model, tmp_path, ("3.0",), step=0.01)
    text = zipfile.ZipFile(path).read("modelDescription.xml")
    assert b"stopTime" not in text and b"_step[" not in text and b"member" not in text
    names = zipfile.ZipFile(path).namelist()
    assert not [n for n in names if n.startswith(("terminals", "resources")) or "fmi2" in n]
    assert all("fmi3" not in n for n in zipfile.ZipFile(paths["2.0"]).namelist())


def host_libraries(folder: Path) -> tuple[dict[str, object], Path]:
    """Sources of a unit with the headers, and its library before stripping (compiled by hand)."""
    declaration, model, step = build("pendulum")
    unit = Unit(model, step)
    equations = sources.generated(unit)
    code = {**sources.complete(unit, equations, sources.token(unit, equations)), **sources.headers()}
    for name, source in code.items():
        text = source.read_text() if isinstance(source, Path) else source
        (folder / name).write_text(text)
    return code, folder / "unit.so"


MODEL_EXCHANGE = {
    "fmi2EnterEventMode",
    "fmi2NewDiscreteStates",
    "fmi2EnterContinuousTimeMode",
    "fmi2CompletedIntegratorStep",
    "fmi2SetTime",
    "fmi2SetContinuousStates",
    "fmi2GetDerivatives",
    "fmi2GetEventIndicators",
    "fmi2GetContinuousStates",
    "fmi2GetNominalsOfContinuousStates",
}
needs_cc = pytest.mark.skipif(not shutil.which("cc") or sys.platform != "linux", reason="needs cc on Linux")


@needs_cc
@pytest.mark.parametrize("level", wide(["-O0", "-O1"], "-O0"))  # further warnings come of optimisation
def test_no_warnings_no_writable_data_and_only_the_standard_is_exported(tmp_path: Path, level: str) -> None:
    code, library = host_libraries(tmp_path)
    files = sorted(n for n in code if n.endswith(".c"))
    headers = tmp_path / "standard"
    headers.mkdir()
    for name in sources.headers():
        (tmp_path / name).rename(headers / name)
    options = (
        f"-std=c11 -Wall -Wextra -Werror {level} -fvisibility=hidden -DPH_API= -shared -fPIC -I. -isystem standard"
    )
    command = ["cc", *options.split(), *files, "-o", str(library), "-lm"]
    done = subprocess.run(command, cwd=tmp_path, capture_output=True, text=True)
    assert done.returncode == 0, done.stderr
    if not shutil.which("nm"):
        pytest.skip("needs nm")
    table = subprocess.run(["nm", "-f", "sysv", str(library)], capture_output=True, text=True, check=True).stdout
    rows = [[cell.strip() for cell in line.split("|")] for line in table.splitlines() if line.count("|") == 6]
    writable = {r[0] for r in rows if r[6] in (".data", ".bss") and r[3] == "OBJECT"}
    assert writable <= {"__dso_handle", "completed.0", "__TMC_END__"}
    table = subprocess.run(["nm", "-D", "--defined-only", str(library)], capture_output=True, text=True, check=True)
    exported = {line.split()[2] for line in table.stdout.splitlines()}
    declared: set[str] = set()
    for header in ("fmi2Functions.h", "fmi3Functions.h"):
        declared |= set(re.findall(r"FMI[23]_Export fmi\w+TYPE\s+(\w+);", (headers / header).read_text()))
    assert len(declared) > 100 and exported <= declared
    assert not {n for n in declared - exported if n.startswith("fmi3")}, "FMI 3.0: every function"
    exchange = declared - exported
    assert exchange == MODEL_EXCHANGE, "FMI 2.0: all functions but those of Model Exchange"


@needs_cc
@pytest.mark.parametrize("version", ["2.0", "3.0"])
def test_a_host_without_interpreter_runs_it(exported, tmp_path: Path, version: str) -> None:
    declaration, model, h, paths = exported("pendulum")
    with zipfile.ZipFile(paths[version]) as archive:
        library = next(n for n in archive.namelist() if n.startswith("binaries/"))
        (tmp_path / "unit.so").write_bytes(archive.read(library))
    headers = sources.HEADERS
    host = tmp_path / "host"
    subprocess.run(
        ["cc", "-std=c11", "-isystem", str(headers), str(HERE / "fmu_host.c"), "-o", str(host), "-ldl"],
        check=True,
    )
    with FMUInstance(paths[version], starts={"hand.f[1]": 2.5}) as unit:
        about = unit.interface
        names = ["q[1]", "v[2]", "lambda_end[1]", "energy.residual"]
        references = [str(about.variables[n].reference) for n in names]
        drive = str(about.variables["hand.f[1]"].reference)
        command = [
            str(host),
            str(tmp_path / "unit.so"),
            version,
            about.token,
            str(h),
            "50",
            drive,
            "2.5",
            "-",
            *references,
        ]
        done = subprocess.run(command, capture_output=True, text=True)
        assert done.returncode == 0, done.stderr
        for k in range(50):
            unit.do_step(k * h, h)
        assert [float(line) for line in done.stdout.split()] == unit.get(names).tolist()
    needed = subprocess.run(["ldd", str(tmp_path / "unit.so")], capture_output=True, text=True).stdout
    assert "python" not in needed
    command[3] = "{another}"
    wrong = subprocess.run(command, capture_output=True, text=True)
    assert wrong.returncode == 1 and "has the token '{another}'" in wrong.stderr


@pytest.mark.slow
@needs_cc
def test_two_source_units_link_into_one_program(exported, tmp_path: Path) -> None:
    """Compiled with their prefixes, as the standard has it for static libraries; every other name is the model's too."""
    command, objects, expected = [str(tmp_path / "linked")], [], []
    for name, variable in (("pendulum", "q[1]"), ("line", "flux[1]")):
        _, _, h, paths = exported(name)
        folder, prefix = tmp_path / name, paths["3.0"].name.removesuffix("_fmi3.fmu")
        zipfile.ZipFile(paths["3.0"]).extractall(folder)
        files = sorted(folder.glob("sources/*.c"))
        flags = ["-std=c11", "-O0", "-DPH_API=", f"-DFMI3_FUNCTION_PREFIX={prefix}_", "-isystem", str(sources.HEADERS)]
        subprocess.run(["cc", *flags, "-c", *map(str, files)], cwd=folder, check=True)
        objects += sorted(map(str, folder.glob("*.o")))
        listed = subprocess.run(["nm", "-g", "--defined-only", *folder.glob("*.o")], capture_output=True, text=True)
        names = {line.split()[2] for line in listed.stdout.splitlines() if len(line.split()) == 3}
        assert len(names) > 100 and not {n for n in names if not n.startswith(f"{prefix}_")}
        with FMUInstance(paths["3.0"]) as unit:
            command += [unit.interface.token, repr(h), str(unit.interface.variables[variable].reference)]
            for k in range(40):
                unit.do_step(k * h, h)
            expected.append(unit.get([variable])[0])
    host = ["cc", "-std=c11", "-DFIRST=pendulum_", "-DSECOND=rl_line_", "-isystem", str(sources.HEADERS)]
    subprocess.run([*host, str(HERE / "fmu_linked.c"), *objects, "-o", command[0], "-lm"], check=True)
    done = subprocess.run([*command, "40"], capture_output=True, text=True)
    assert done.returncode == 0, done.stderr
    np.testing.assert_allclose([float(line) for line in done.stdout.split()], expected, rtol=1e-11)


@pytest.mark.slow
@pytest.mark.skipif(not shutil.which("cmake"), reason="needs cmake")
@pytest.mark.parametrize("version", ["2.0", "3.0"])
def test_its_sources_build_the_same_unit(exported, tmp_path: Path, version: str) -> None:
    """An archive without libraries comes back through `fmpy compile`."""
    _, _, h, paths = exported("pendulum")
    bare = tmp_path / "bare.fmu"
    with zipfile.ZipFile(paths[version]) as full, zipfile.ZipFile(bare, "w") as archive:
        for name in full.namelist():
            if not name.startswith("binaries/"):
                archive.writestr(name, full.read(name))
    subprocess.run([sys.executable, "-m", "fmpy", "compile", str(bare)], check=True, capture_output=True)
    with FMUInstance(bare) as built, FMUInstance(paths[version]) as unit:
        for k in range(50):
            built.do_step(k * h, h)
            unit.do_step(k * h, h)
        a, b = built.get(built.names), unit.get(unit.names)
        np.testing.assert_allclose(a, b, rtol=1e-9, atol=1e-12)


@pytest.mark.slow
@pytest.mark.parametrize("platform", PLATFORMS)
def test_other_platforms_link(tmp_path: Path, platform: str) -> None:
    pytest.importorskip("ziglang")
    declaration, model, step = build("mass")
    (path,) = export(model, tmp_path, ("3.0",), step=step, platforms=[platform])
    assert [n for n in zipfile.ZipFile(path).namelist() if n.startswith(f"binaries/{platform}/mass.")]


def test_warm_export_compiles_nothing(exported) -> None:
    declaration, model, step = build("mass")
    unit = Unit(model, step, 100 * step)
    exported("mass")
    equations = sources.generated(unit)
    code = sources.complete(unit, equations, sources.token(unit, equations))
    assert compile({**code, **sources.headers()}, flags=("-DPH_API=",)).reused
