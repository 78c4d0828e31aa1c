"""Cost of every feature of a model: C text, tables, compile time, library, FMU and step, with and without it."""

from __future__ import annotations

import tempfile
from collections.abc import Callable
from dataclasses import dataclass
from time import process_time
from typing import TYPE_CHECKING

from phfmu.studies.bench.compile_cost import compile_runtime, compiler_seconds, fresh_cache
from phfmu.studies.tables import markdown_table

if TYPE_CHECKING:
    from phfmu.declare.phdae import PHDAE

STEPS = 20_000
H = 0.01


@dataclass(frozen=True)
class LeaveOutRow:
    """One variant: unknowns, state in bytes, kernels and library in bytes, compile in s CPU, FMU in bytes, step in us CPU."""

    name: str
    unknowns: int
    state: int
    kernels: int
    library: int
    compile: float
    fmu: int
    step: float


def pair(*, port: bool = True, damper: bool = True, bar: bool = True, spring: bool = True) -> PHDAE:
    """Two particles in the plane with a spring, a damper, a bar and a port, or without some of them."""
    from phfmu.components.mechanical.multibody import Multibody

    body = Multibody("pair", dim=2)
    one, two = body.particle(1.0, (1.0, 0.0), v=(0.0, 0.5)), body.particle(2.0, (1.0, 1.0))
    ground = body.support((0.0, 0.0))
    if spring:
        body.quartic_spring(one, two, 10.0)
    if damper:
        body.damper(one, two, lambda s: 0.1 * (1.0 + s))
    if bar:
        body.bar(ground, one)
    if port:
        body.port("force", two)
    return body.build()


#: name -> declaration, FMI versions of the exported unit
VARIANTS: tuple[tuple[str, Callable[[], PHDAE], tuple[str, ...]], ...] = (
    ("everything", pair, ("2.0", "3.0")),
    ("FMI 3.0 only", pair, ("3.0",)),
    ("no port", lambda: pair(port=False), ("2.0", "3.0")),
    ("no dissipation", lambda: pair(damper=False), ("2.0", "3.0")),
    ("no constraint", lambda: pair(bar=False), ("2.0", "3.0")),
    ("no port, dissipation, constraint", lambda: pair(port=False, damper=False, bar=False), ("2.0", "3.0")),
    ("masses alone", lambda: pair(port=False, damper=False, bar=False, spring=False), ("2.0", "3.0")),
)


def measure(name: str, declaration: PHDAE, versions: tuple[str, ...]) -> LeaveOutRow:
    from phfmu.discretise.model import build_model
    from phfmu.engine.build.codegen import kernel_table
    from phfmu.engine.model import kernels
    from phfmu.engine.native.native import NativeInstance
    from phfmu.engine.native.native_model import native_model
    from phfmu.fmu.export.export import export

    model = build_model(declaration)
    text = kernel_table(kernels(model), model.step.schur).text
    with fresh_cache(), tempfile.TemporaryDirectory() as folder:
        compile_runtime()
        before = compiler_seconds()
        unit = NativeInstance(model, kernels="compiled")
        seconds = compiler_seconds() - before
        library = native_model(model, "compiled").code.build
        assert library is not None
        size = library.path.stat().st_size
        paths = export(model, folder, versions=versions, step=H)
        fmu = sum(p.stat().st_size for p in paths)
    return LeaveOutRow(name, model.step.nw, len(unit.get_state()), len(text), size, seconds, fmu, step_time(unit))


def step_time(unit, record: tuple[str, ...] = ()) -> float:
    """Least process time of a step in us, over five runs from the start."""
    times = []
    for _ in range(5):
        unit.reset()
        before = process_time()
        unit.run(0.0, H, STEPS, record)
        times.append((process_time() - before) / STEPS * 1e6)
    return min(times)


def readings() -> list[tuple[str, float]]:
    """Step time of the whole model with more and more recorded."""
    from phfmu.discretise.model import build_model
    from phfmu.engine.native.native import NativeInstance

    unit = NativeInstance(build_model(pair()), kernels="compiled")
    ledger = ("stored", "dissipated", "supplied", "pairs")
    kinds = (
        ("nothing recorded", ()),
        ("ledger recorded", ledger),
        ("ledger and all signals at step ends", (*ledger, "signals")),
    )
    return [(name, step_time(unit, kept)) for name, kept in kinds]


def table(progress: Callable[[str], None] = lambda _: None) -> str:
    """Both tables in Markdown."""
    head = ["model", "unknowns", "state B", "kernels B", "library B", "compile s", "FMUs B", "step us"]
    rows = []
    for name, made, versions in VARIANTS:
        progress(name)
        r = measure(name, made(), versions)
        sizes = r.unknowns, r.state, r.kernels, r.library
        rows.append([r.name, *sizes, f"{r.compile:.1f}", r.fmu, f"{r.step:.2f}"])
    times = markdown_table(["reading", "step us"], [[n, f"{t:.2f}"] for n, t in readings()])
    return f"{markdown_table(head, rows)}\n\n{times}"


def page(progress: Callable[[str], None] = lambda _: None) -> str:
    """The page of the results."""
    return f"""# What is left out

Two particles with a spring, a damper, a bar and a port, and the same without some of them. `kernels`: generated C;
`library`: shared library with the runtime; `compile`: CPU time of the compiler for the kernels, beside 2 s for the runtime
once a machine; `FMUs`: both versions together, or the one that is there; `step`: least process time of a step of {H:g} s over
{STEPS} steps, nothing recorded. Times are those of one machine; compare them within the table.

    phfmu bench leave-out -o docs/results/leave-out.md

{table(progress)}

Importing `phfmu` loads none of its libraries, `phfmu --help` none either, and a run without an audit writes no file:
`tests/test_leave_out.py` holds these by the modules loaded and the files opened.
"""
