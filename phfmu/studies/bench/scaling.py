"""Growth of time, memory and code with the size of a model."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass, fields
from pathlib import Path
from time import process_time
from typing import TYPE_CHECKING, Any

import numpy as np

from phfmu.studies.bench.compile_cost import compiler_seconds, fresh_cache
from phfmu.studies.bench.families import FAMILIES, Family
from phfmu.studies.bench.precision.own import solver_iterations
from phfmu.studies.figures import pyplot, save
from phfmu.studies.tables import aligned_table, write_csv

if TYPE_CHECKING:
    from phfmu.engine.build.codegen import KernelTable

STEPS = 20  # every size is timed over these first steps: a later part of the motion may take more iterations
STEPS_TIME = 0.3  # CPU seconds all repetitions take at least
PARTS = 5  # repetitions at least; their median counts


@dataclass(frozen=True)
class Size:
    """One model of a family.

    n: parts;  unknowns of a step;  declare, plan: CPU seconds from nothing to the declaration and on to the model
    code: bytes of generated C;  compile: CPU seconds of the compiler, nothing reused
    memory: bytes of an instance, its tables included;  fill: nonzeros of the Newton matrix
    step: CPU seconds per step;  iterations: Newton iterations and sweeps per step
    """

    family: str
    n: int
    unknowns: int
    declare: float
    plan: float
    code: int
    compile: float
    memory: int
    nonzeros: int
    step: float
    iterations: float

    @property
    def iteration(self) -> float:
        """CPU seconds per iteration."""
        return self.step / self.iterations


#: columns whose growth is fitted
GROWTH = ("declare", "plan", "code", "compile", "memory", "step", "iteration")


def measure(family: Family, n: int) -> Size:
    """One size of a family, everything made anew."""
    from phfmu.discretise.model import build_model
    from phfmu.engine.build.codegen import kernel_table
    from phfmu.engine.model import kernels
    from phfmu.engine.native.native import NativeInstance

    start = process_time()
    declaration = family.build(n)
    declared = process_time()
    model = build_model(declaration)
    planned = process_time()
    table = kernel_table(kernels(model), model.step.schur)
    seconds = compile_time(table)
    instance = NativeInstance(model, kernels="compiled")
    step, iterations = step_time(instance, family.step)
    return Size(
        family.name, family.count(n), model.step.nw, declared - start, planned - declared, len(table.text), seconds,
        instance.memory_size, model.step.matrix.nnz, step, iterations,
    )  # fmt: skip


def compile_time(table: KernelTable) -> float:
    """CPU seconds of the compiler for runtime and kernels, nothing reused."""
    from phfmu.engine.build.compile import compile, host_flags
    from phfmu.engine.build.runtime_sources import STEPS, headers, runtime_sources

    with fresh_cache():
        before = compiler_seconds()
        compile(runtime_sources(*STEPS), flags=host_flags())
        compile(headers() | {"kernels.c": table.text}, flags=host_flags())
        return compiler_seconds() - before


def step_time(instance: Any, h: float) -> tuple[float, float]:
    """CPU seconds per step (median) and iterations per step (Newton's, sweeps) of the first STEPS steps."""
    instance.run(0.0, h, STEPS)
    iterations, spent = solver_iterations(instance), []
    while len(spent) < PARTS or sum(spent) < STEPS_TIME:
        instance.reset()
        start = process_time()
        instance.run(0.0, h, STEPS)
        spent.append(process_time() - start)
    each = (solver_iterations(instance) - iterations) / len(spent)
    return float(np.median(spent)) / STEPS, each / STEPS


def exponent(sizes: Sequence[Size], column: str) -> float:
    """p of  column ~ n^p  by least squares over the larger half of the sizes (at least two)."""
    chosen = sorted(sizes, key=lambda s: s.n)[-max(2, (len(sizes) + 1) // 2) :]
    if len(chosen) < 2:
        return float("nan")
    values = np.maximum([float(getattr(s, column)) for s in chosen], 1e-300)
    return float(np.polyfit(np.log([s.n for s in chosen]), np.log(values), 1)[0])


def table_text(sizes: Sequence[Size]) -> str:
    """Sizes in aligned columns, exponents below."""
    head = [
        "n", "unknowns", "declare s", "plan s", "C kB", "compile s", "memory MB", "nonzeros", "us/step", "its", "us/it",
    ]  # fmt: skip
    rows = [
        [str(s.n), str(s.unknowns), f"{s.declare:.3g}", f"{s.plan:.3g}", f"{s.code / 1e3:.1f}", f"{s.compile:.2f}",
         f"{s.memory / 1e6:.3g}", str(s.nonzeros), f"{1e6 * s.step:.4g}", f"{s.iterations:.1f}", f"{1e6 * s.iteration:.4g}"]
        for s in sizes
    ]  # fmt: skip
    p = {c: f"{exponent(sizes, c):.2f}" for c in GROWTH}
    rows.append(
        ["~ n^", "", p["declare"], p["plan"], p["code"], p["compile"], p["memory"], "", p["step"], "", p["iteration"]]
    )
    return aligned_table(head, rows)


def run(family: Family, sizes: Sequence[int], progress: Callable[[str], None] = lambda _: None) -> Iterator[Size]:
    """All sizes of a family; each in turn, nothing is kept between them but the caches of kernels."""
    for n in sizes:
        progress(f"{family.name} {n}")
        yield measure(family, n)


def report(
    names: Sequence[str], sizes: Sequence[int], folder: Path, progress: Callable[[str], None] = lambda _: None
) -> list[str]:
    """Measure families (default: all) and write scaling.csv and scaling.png into `folder`; returns the printed lines."""
    from importlib.util import find_spec

    from phfmu.studies.bench import machine

    for name in names:
        if name not in FAMILIES:
            raise ValueError(f"--families {name}: choose from {', '.join(FAMILIES)}")
    before, found, lines = machine.load(), [], []
    for family in (FAMILIES[n] for n in names or FAMILIES):
        own = list(run(family, sizes or family.sizes, progress))
        found += own
        lines += [f"{family.name}: n = {family.parts}, step {family.step:g} s", table_text(own), ""]
    caption = f"{machine.machine_line(before)}; one thread, process CPU time"
    folder.mkdir(parents=True, exist_ok=True)
    head, rows = [f.name for f in fields(Size)], [vars(s).values() for s in found]
    write_csv(folder / "scaling.csv", [caption, machine.versions()], head, rows)
    written = ["scaling.csv"]
    if find_spec("matplotlib") is not None:
        write_png(folder / "scaling.png", found, caption)
        written.append("scaling.png")
    return [caption, machine.versions(), "", *lines, f"written: {', '.join(written)} in {folder}"]


def write_png(path: Path, sizes: Sequence[Size], caption: str) -> None:
    """Declaration and plan, time per step, memory over n."""
    plt = pyplot()

    figure, axes = plt.subplots(1, 3, figsize=(11, 3.8), layout="constrained")
    panels = [
        ("declaration and plan", "CPU seconds", lambda s: s.declare + s.plan),
        ("one step", "CPU microseconds", lambda s: 1e6 * s.step),
        ("instance and tables", "MB", lambda s: s.memory / 1e6),
    ]
    for ax, (title, unit, value) in zip(axes, panels, strict=True):
        for name, colour in zip(
            dict.fromkeys(s.family for s in sizes), ("#1f6fb4", "#d1711b", "#5b8c3a"), strict=False
        ):
            own = [s for s in sizes if s.family == name]
            ax.loglog([s.n for s in own], [value(s) for s in own], "o-", color=colour, label=name, ms=4)
        low, high = ax.get_xlim()
        y0 = ax.get_ylim()[0]
        ax.plot([low, high], [y0, y0 * high / low], color="0.7", ls=":", lw=1, label="~ n", scaley=False, scalex=False)
        ax.set(title=title, ylabel=unit, xlabel="links, particles, machines")
        ax.grid(color="0.92")
        ax.spines[["top", "right"]].set_visible(False)
    axes[0].legend(fontsize=8, frameon=False)
    figure.supxlabel(caption, fontsize=7, color="0.4")
    save(figure, path)
