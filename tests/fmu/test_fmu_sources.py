"""Sources of exported units: what they build, export and link, without an interpreter and on other platforms."""

from __future__ import annotations

import re
import shutil
import subprocess
import sys
import zipfile
from pathlib import Path

import numpy as np
import pytest

from phfmu.engine.build.compile import compile
from phfmu.fmu.export import sources
from phfmu.fmu.export.description import ExportedUnit
from phfmu.fmu.export.export import PLATFORMS, export
from phfmu.fmu.importer.reader import FMUInstance
from tests.fmu.exported import build, needs_cc
from tests.wide import longer, wide

HERE = Path(__file__).parent


def host_libraries(folder: Path) -> tuple[dict[str, object], Path]:
    """Sources of a unit with the headers, and its library before stripping (compiled by hand)."""
    declaration, model, step = build("pendulum")
    unit = ExportedUnit(model, step)
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


@pytest.mark.parametrize("platform", longer(PLATFORMS, "aarch64-linux", "aarch64-darwin"))
def test_other_platforms_link(tmp_path: Path, platform: str) -> None:
    pytest.importorskip("ziglang")
    declaration, model, step = build("mass")
    (path,) = export(model, tmp_path, ("3.0",), step=step, platforms=[platform])
    assert [n for n in zipfile.ZipFile(path).namelist() if n.startswith(f"binaries/{platform}/mass.")]


def test_warm_export_compiles_nothing(exported) -> None:
    declaration, model, step = build("mass")
    unit = ExportedUnit(model, step, 100 * step)
    exported("mass")
    equations = sources.generated(unit)
    code = sources.complete(unit, equations, sources.token(unit, equations))
    assert compile({**code, **sources.headers()}, flags=("-DPH_API=",)).reused
