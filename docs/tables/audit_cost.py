"""The table of docs/results/audit.md: what a ledger costs a run."""

from __future__ import annotations

import tempfile
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from statistics import median
from time import process_time
from typing import Any

from pages import PageBlock, table

from phfmu import Collocated, Monolithic, NativeInstance, Options, Scene, build_model, default_scheme, run
from phfmu.audit import AuditWriter
from phfmu.components.mechanical.four_particle import four_particle
from phfmu.components.scenes.electrical.smib import smib
from phfmu.components.scenes.electrical.two_machine import two_machine
from phfmu.components.scenes.mechanical.oscillator import oscillator
from phfmu.network.couplings.coupled import Coupled
from phfmu.network.couplings.stepper import Stepper
from phfmu.studies.bench import machine
from phfmu.studies.bench.apart import networks as apart

ROUNDS = 15
KEPT = ("none", "summary", "full")


def composed(declaration: Any) -> Callable[[], Stepper]:
    model = build_model(declaration, default_scheme(declaration, 2))
    return lambda: Monolithic(model, NativeInstance(model))


def units(scene: Scene) -> Callable[[], Stepper]:
    """Members of the scene as FMUs of their own."""
    from phfmu.cli.stepping import as_fmu
    from phfmu.network.members.fmu_member import FMUMember

    net: Any = scene.system
    made = [FMUMember(n, as_fmu(replace(d, name=n), Collocated(1), None, scene.step)) for n, d in net.declared.items()]
    starts = [m.get_state() for m in made]

    def begun() -> Stepper:
        for m, start in zip(made, starts, strict=True):
            m.set_state(start)
        return Coupled(net, [*made])

    return begun


def audit_cost() -> PageBlock:
    """CPU time of a step in us without a ledger, with its sums, and with a row per step in a file.

    Medians over turns, in percent those of the ratios.
    """
    before, rows = machine.load(), []
    for name, make, step, steps in (
        ("smib, composed", composed(smib().declaration()), 1e-4, 10_000),
        ("four_particle, composed", composed(four_particle()), 1e-3, 10_000),
        ("two_machine, apart", lambda: apart.coupled(two_machine().system, 1), 1e-4, 2000),  # pyright: ignore
        ("oscillator, FMUs", units(oscillator()), 1e-2, 200),
    ):
        found = {kept: [] for kept in KEPT}
        for turn in range(ROUNDS):
            for kept in KEPT[turn % 3 :] + KEPT[: turn % 3]:  # what comes first has the colder memory
                found[kept].append(cost(make(), kept, step, steps))
        none = found["none"]
        more = {kept: 100 * median(b / a - 1 for a, b in zip(none, found[kept], strict=True)) for kept in KEPT[1:]}
        rows.append([name, f"{median(none):.1f}", *(f"{median(found[k]):.1f} ({x:+.1f} %)" for k, x in more.items())])
    about = machine.machine_line(before)
    return table(["run", *KEPT], rows, notes=(about,))


def cost(stepper: Stepper, kept: str, step: float, steps: int) -> float:
    """CPU time per step in us; the file is closed in it."""
    asked: dict[str, Any] = {"stop": steps * step, "step": step, "every": steps, "audited": kept != "none"}
    with tempfile.TemporaryDirectory() as folder:
        begun = process_time()
        if kept == "full":
            with AuditWriter(Path(folder) / "run.audit.parquet") as sink:
                run(stepper, Options(sink=sink, **asked))
        else:
            run(stepper, Options(**asked))
        return 1e6 * (process_time() - begun) / steps
