"""Tables of times: docs/results/work-precision.md and scaling.md, with their pictures.

Times change with the machine and its load, which stand below each table.
"""

from __future__ import annotations

import re
from collections.abc import Sequence
from pathlib import Path
from typing import Any

from pages import DOCS, PageBlock, table

from phfmu.studies.bench import machine
from phfmu.studies.bench.families import FAMILIES, member
from phfmu.target import scene

RESULTS = DOCS / "results"


def numbers(text: str) -> tuple[float, ...]:
    return tuple(float(t) for t in text.split(","))


def work_precision(target: str, steps: str, errors: str, stop: float, repeat: int, peers: tuple[str, ...]) -> PageBlock:
    """One comparison of `phfmu bench`: rows, ratios at equal errors, machine; its picture."""
    from phfmu.studies.bench.precision.problem import problem_of
    from phfmu.studies.bench.precision.report import write_png
    from phfmu.studies.bench.precision.run import ComparisonSettings, compare

    problem = problem_of(member(target) or scene(target), times=(1.0,), stop=stop, judged=("q",))
    choice = ComparisonSettings(steps=numbers(steps), errors=numbers(errors), repeat=repeat, peers=peers)
    found = compare(problem, choice)

    def draw() -> Sequence[Path]:
        picture = RESULTS / "img" / f"work_precision_{problem.name}.png"
        write_png(picture, problem, found.table, f"{found.caption}\n{machine.versions()}")
        return (picture,)

    rows = [
        [r.method, r.setting, 1e3 * r.cpu, r.judged.errors[-1], r.judged.energy, r.judged.drift, r.ledger or "",
         r.steps or "", r.iterations or ""]
        for r in found.table.rows
    ]  # fmt: skip
    head = [
        "method",
        "setting",
        "ms/s",
        "error of q(1 s)",
        "energy error in J",
        "drift",
        "ledger in J",
        "steps",
        "iterations",
    ]
    notes = (*found.ratios, *found.table.remarks, *found.about)
    return table(head, rows, ".3g", notes=notes, draw=draw)


def four_particle() -> PageBlock:
    """Four particles, damped, timed over 10 s."""
    return work_precision(
        "four_particle",
        "0.08,0.04,0.02,0.01,0.005,0.0025",
        "2e-4,1e-6,5e-9",
        10.0,
        5,
        ("scipy", "casadi", "sundae", "exudyn"),
    )


def chain_10() -> PageBlock:
    """Ten unit links let go from the horizontal, timed over 2 s."""
    return work_precision("chain:10", "0.04,0.02,0.01,0.005", "1e-4,1e-6,1e-8", 2.0, 5, ("casadi", "mujoco", "exudyn"))


def chain_50() -> PageBlock:
    """The same with fifty links."""
    return work_precision("chain:50", "0.04,0.02,0.01", "1e-5,1e-7,3e-9", 2.0, 3, ("mujoco", "exudyn"))


def scaling(name: str, sizes: Sequence[int]) -> PageBlock:
    """Sizes of a family with fitted exponents."""
    from phfmu.studies.bench.scaling import GROWTH, exponent, run

    before, found = machine.load(), list(run(FAMILIES[name], sizes))
    rows: list[list[Any]] = [
        [s.n, s.unknowns, s.declare, s.plan, s.code / 1e3, s.compile, s.memory / 1e6, f"{1e6 * s.step:.0f}", s.iterations,
         f"{1e6 * s.iteration:.0f}"]
        for s in found
    ]  # fmt: skip
    p = {c: f"{exponent(found, c):.2f}" for c in GROWTH}
    rows.append(["~ n^", "", *(p[c] for c in GROWTH[:-1]), "", p["iteration"]])
    parts = FAMILIES[name].parts
    head = [parts, "unknowns", "declare s", "plan s", "C kB", "compile s", "memory MB", "µs/step", "its", "µs/it"]
    about = f"{machine.machine_line(before)}; process CPU time"
    return table(head, rows, ".3g", notes=(about,), draw=draw_scaling)


def draw_scaling() -> Sequence[Path]:
    """The tables on the page about scaling as one picture."""
    from phfmu.studies.bench.scaling import Size, write_png

    page, sizes = (RESULTS / "scaling.md").read_text(encoding="utf-8"), []
    for name, body in re.findall(r"docs/tables scaling_(\w+)\n\n((?:\|.*\n)+)", page):
        for line in body.splitlines()[2:-1]:
            n, unknowns, declare, plan, code, compiled, memory, step, iterations, _ = (
                float(cell) for cell in line.strip("| ").split("|")
            )
            sizes.append(Size(name, int(n), int(unknowns), declare, plan, int(1e3 * code), compiled, int(1e6 * memory), 0,
                              1e-6 * step, iterations))  # fmt: skip
    picture = RESULTS / "img" / "scaling.png"
    write_png(picture, sizes, f"{machine.processor()}; {machine.versions()}")
    return (picture,)


def scaling_chain() -> PageBlock:
    """Pendulum chains, two-level of order 2, h = 2 ms."""
    return scaling("chain", (10, 100, 1000, 3000, 10_000))


def scaling_net() -> PageBlock:
    """Square sheets of masses and springs, h = 1 ms."""
    return scaling("net", (4, 8, 16, 32))


def scaling_ladder() -> PageBlock:
    """Machines along a line, h = 0.1 ms."""
    return scaling("ladder", (3, 10, 30, 100, 300))
