"""What a scene does not need costs nothing: modules, files, unknowns, factors."""

from __future__ import annotations

import subprocess
import sys
from dataclasses import replace

import pytest

from phfmu import NativeInstance, build_model
from phfmu.components.electrical.switches import diode
from phfmu.components.mechanical.multibody import Multibody
from phfmu.components.mechanical.translational import mass
from tests.wide import wide

HEAVY = ("numpy", "casadi", "scipy", "fmpy", "lxml", "pyarrow", "matplotlib", "plotly", "rich", "ziglang")
LOADED = "import sys; print(*sorted(m for m in %r if m in sys.modules))"
CPU = "import time; t = time.process_time(); %s; print(time.process_time() - t)"


def python(code: str, *options: str) -> str:
    done = subprocess.run([sys.executable, *options, "-c", code], capture_output=True, text=True, check=True)
    return done.stdout


def test_import_loads_no_library():
    assert python("import phfmu, phfmu.cli, phfmu.components.library; " + LOADED % (HEAVY,)).split() == []


def test_import_costs_next_to_nothing():
    """0.05 s beyond the interpreter; numpy alone takes more."""
    assert min(float(python(CPU % "import phfmu")) for _ in range(3)) <= 0.05


def test_help_loads_no_library_and_costs_little():
    code = "import phfmu.cli\ntry: phfmu.cli.main(['--help'])\nexcept SystemExit: pass\n" + LOADED % (HEAVY,)
    assert python(code).splitlines()[-1].split() == []
    timed = "import time\nt = time.process_time()\nimport phfmu.cli\ntry: phfmu.cli.main(['--help'])\n"
    timed += "except SystemExit: print(time.process_time() - t)"
    assert min(float(python(timed).splitlines()[-1]) for _ in range(3)) <= 0.3


RUN = """
import sys
from phfmu.cli import main
written = []
def hook(event, arguments):
    if event == "open" and isinstance(arguments[0], str) and set(str(arguments[1] or "r")) & set("wax+"):
        written.append(arguments[0])
main(["run", "oscillator", "--stop", "0.1", "--quiet", "--engine", ENGINE, *MORE])
sys.addaudithook(hook)
main(["run", "oscillator", "--stop", "0.1", "--quiet", "--engine", ENGINE, *MORE])
print("written", *written)
print("loaded", *[m for m in ("fmpy", "lxml", "pyarrow", "matplotlib", "rich") if m in sys.modules])
"""

#: rooms of the package that a run of one composed model with an audit on the terminal and a result table has no use for
UNUSED = (
    "audit.analysis", "audit.contradictions", "audit.log", "checks.check", "derivatives", "doors", "importers", "fmu.export",
    "fmu.importer", "network.as_unit", "network.couplings.coupled", "network.couplings.landing", "network.interface", "operating",
    "references", "report", "ssp.loading", "studies", "sweeps.runs", "vet",
    "components.control", "components.grids", "components.mechanical", "components.scenes.drive",
    "components.scenes.electrical.wscc9", "components.scenes.mechanical", "components.electrical.machines.induction_machine",
)  # fmt: skip
MODULES = """
import sys
from phfmu.cli import main
assert main(["run", "smib", "--stop", "0.001", "--quiet", "-o", sys.argv[1]]) == 0
print(*sorted(sys.modules))
"""


@pytest.mark.parametrize("more", [[], ["--coupling", "newton"]], ids=["composed", "apart"])
@pytest.mark.parametrize("engine", wide(["native", "python"], "native"))
def test_a_run_without_audit_and_units_writes_no_file_and_loads_no_reader_of_either(engine, more):
    lines = python(RUN.replace("ENGINE", repr(engine)).replace("MORE", repr(more)), "-B").splitlines()
    assert lines[-2:] == ["written", "loaded"]


def test_a_plain_run_loads_neither_rooms_nor_libraries_that_it_does_not_use(tmp_path):
    """Importing them takes longer than all else that the first row waits for; pandas would come with pyarrow's conversions."""
    done = subprocess.run(
        [sys.executable, "-c", MODULES, str(tmp_path / "rows.csv")], capture_output=True, text=True, check=True
    )
    loaded = done.stdout.split()
    unused = tuple(f"phfmu.{room}" for room in UNUSED)
    assert [m for m in loaded if m in unused or m.startswith(tuple(f"{u}." for u in unused))] == []
    assert [m for m in ("fmpy", "lxml", "matplotlib", "pandas", "scipy") if m in loaded] == []
    assert len([m for m in loaded if m.partition(".")[0] == "phfmu"]) <= 310


def test_every_room_that_a_plain_run_leaves_out_is_there():
    from importlib.util import find_spec

    assert [room for room in UNUSED if find_spec(f"phfmu.{room}") is None] == []


def test_an_ode_has_no_multipliers_and_no_instant_system():
    model = build_model(mass(1.0, k=2.0, d=0.1))
    assert model.step.nw == model.step.nx == 2 and model.step.na == 0
    assert len(model.step.regularised) == len(model.step.mean_a) == 0
    assert model.instant.nw == 0 and model.instant.matrix.nnz == 0 and not model.checks
    unit = NativeInstance(model)
    unit.run(0.0, 0.01, 5, ("signals",))
    assert unit.counts["factored"] == 1  # linear: the step matrix once, nothing for the values at an instant


def pendulums(barred: bool):
    body = Multibody("pair", dim=2)
    one = body.particle(1.0, (1.0, 0.0))
    body.quartic_spring(body.support((0.0, 0.0)), one, 10.0)
    if barred:
        body.bar(body.support((0.0, 0.5)), one)
    return build_model(body.build())


def test_constraints_bring_their_columns_and_nothing_else_does():
    free, bound = pendulums(False), pendulums(True)
    assert len(free.step.regularised) == 0 and free.instant.nw == 0
    assert bound.step.nw == free.step.nw + 2 and len(bound.step.regularised) > 0  # lambda and its velocity twin
    assert free.step.nw == free.step.nx


def test_the_compiler_is_announced_only_when_it_is_waited_for(compiler, tmp_path, monkeypatch):
    declaration, said = mass(1.25, k=3.75), []

    def made(kernels):
        model = replace(build_model(declaration), first=None)  # one alike may still be in use
        NativeInstance(model, lambda: said.append(kernels), kernels)

    NativeInstance(build_model(mass()))  # so that the runtime is there
    for kernels in ("interpreted", "auto", "compiled"):
        made(kernels)
    assert said in (["compiled"], [])  # the cache may know it from another time
    made("compiled")
    assert said in (["compiled"], [])
    said.clear()
    monkeypatch.setenv("PHFMU_CACHE_DIR", str(tmp_path))
    monkeypatch.setattr("phfmu.engine.build.compile.SHIPPED", tmp_path)
    made("interpreted")
    assert said == ["interpreted"]  # what steps all models
    made("compiled")
    assert said == ["interpreted", "compiled"]


def test_a_model_without_switches_is_what_it_was() -> None:
    """Modes are of what has switches, and built when they come up."""
    plain, switched = build_model(mass(1.0, k=4.0)), build_model(diode())
    assert plain.modes is None and switched.modes is not None and switched.modes.known == [(0,)]
    assert plain.events is None and not plain.declaration.switches
