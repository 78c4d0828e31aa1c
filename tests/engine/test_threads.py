"""Instances share nothing that is written: threads over them under a checker, and no data of our own in a library."""

from __future__ import annotations

import os
import shutil
import subprocess
import sys
from pathlib import Path

import pytest

from phfmu import Collocated, build_model
from phfmu.components.library import build as built
from phfmu.components.mechanical.chain import chain
from phfmu.discretise.model import Model
from phfmu.engine.build.codegen import kernel_table, tangent_text
from phfmu.engine.build.compile import host_flags
from phfmu.engine.build.runtime_sources import library_sources
from phfmu.engine.build.tables import c_text
from phfmu.engine.model import kernels

FOUND = 66
#: what instances, and members of the master, do all the time
CALLS = {
    "eval.c": "void ph_eval(ph_system *s, int slots, int late) {",
    "native.c": "static int step(const ph_share *s, double t, double h) {",
}
MODELS = {
    "chain": lambda: build_model(chain(5, port=True), Collocated(1)),
    "chain, two-level": lambda: build_model(chain(5, port=True)),
    "four_particle": lambda: build_model(built("four_particle")),
}


def sources(model: Model) -> dict[str, str | Path]:
    """All that models and masters are made of, this model and the program."""
    table = kernel_table(kernels(model), model.step.schur)
    made = {"kernels.c": table.text, "tangents.c": tangent_text(table, model.step, model.instant)}
    made["model.c"] = c_text(model, table.index, tangents="ph_tangents")
    program = Path(__file__).parent / "threads.c"
    return {**library_sources(), **made, program.name: program}


def compiled(files: dict[str, str | Path], folder: Path) -> Path:
    """The program under the checker; skipped with the reason where there is none."""
    gcc = shutil.which("gcc")
    if gcc is None or not sys.platform.startswith("linux"):
        pytest.skip("needs gcc on Linux")
    # checks make its optimiser need gigabytes for the lanes of the Schur stepper
    options = [gcc, "-std=c11", "-O0", "-g", "-ffp-contract=off", "-fsanitize=thread", "-pthread"]
    trial = folder / "trial.c"
    trial.write_text("int main(void) { return 0; }\n")
    for words in ([*options, str(trial), "-o", str(folder / "trial")], [str(folder / "trial")]):
        tried = subprocess.run(words, capture_output=True, text=True)
        if tried.returncode:
            pytest.skip(f"no programs under the thread sanitizer here: {tried.stderr[-300:]}")
    for name, source in files.items():
        (folder / name).write_text(source if isinstance(source, str) else source.read_text())
    program = folder / "threads"
    words = [*options, *host_flags("cc"), f"-I{folder}", *(str(folder / n) for n in files if n.endswith(".c"))]
    done = subprocess.run([*words, "-lm", "-o", str(program)], capture_output=True, text=True)
    assert done.returncode == 0, done.stderr[-4000:]
    return program


def ran(program: Path) -> subprocess.CompletedProcess[str]:
    environment = os.environ | {"TSAN_OPTIONS": f"halt_on_error=1 exitcode={FOUND}"}
    return subprocess.run([str(program)], env=environment, capture_output=True, text=True, timeout=600)


@pytest.mark.slow
@pytest.mark.parametrize("name", MODELS)
def test_threads_share_nothing(tmp_path: Path, name: str) -> None:
    """Instances in threads of their own, and members stepped by the crew of the master: no data race, the bits of one thread."""
    done = ran(compiled(sources(MODELS[name]()), tmp_path))
    assert (done.returncode, done.stdout) == (0, "same bits\n"), done.stderr[-4000:]


@pytest.mark.slow
@pytest.mark.parametrize("file", CALLS)
def test_the_checker_sees_a_count_that_all_share(tmp_path: Path, file: str) -> None:
    """The same program with one global in the runtime, or in the master, is refused."""
    files, call = sources(MODELS["chain"]()), CALLS[file]
    text = Path(files[file]).read_text()
    assert text.count(call) == 1
    shared = text.replace(call, f"static long shared_count;\n{call}\n    shared_count++;")
    done = ran(compiled(files | {file: shared}, tmp_path))
    assert done.returncode == FOUND and "data race" in done.stderr and "shared_count" in done.stderr, done.stderr
