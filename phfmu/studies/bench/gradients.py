"""Cost of the whole gradient of a run backwards, beside the run itself with all columns off, and what it takes of memory."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from functools import partial
from statistics import median
from typing import TYPE_CHECKING, Any

import numpy as np

from phfmu.studies.bench.machine import cpu_seconds, machine_line
from phfmu.studies.tables import markdown_table

if TYPE_CHECKING:
    from phfmu.declare.phdae import PHDAE
    from phfmu.discretise.model import Model

TURNS = 7  # that the medians are of
LEAST = 0.03  # s that the steps of a turn take at least
#: steps of the run whose memory is told
LONG = 1_000_000


@dataclass(frozen=True)
class GradientCase:
    """A model by name (`chain:N`, `links:N`, `ladder:N` of the families), order of the scheme."""

    name: str
    order: int


CASES = (
    *(GradientCase("dc_motor", order) for order in (2, 4)), *(GradientCase("smib", order) for order in (2, 4, 6)),
    GradientCase("ladder:100", 2),
    *(GradientCase(name, order) for name in ("four_particle", "chain:50", "links:50") for order in (2, 6)),
)  # fmt: skip


@dataclass(frozen=True)
class GradientCost:
    """Times of a step [us]: forward, all columns off;  with the tape;  back, for one measure, by all parameters and starts.

    schur: whether the steps were the Schur stepper's
    """

    parameters: int
    states: int
    unknowns: int
    forward: float
    taped: float
    back: float
    schur: bool

    @property
    def ratio(self) -> float:
        """The whole gradient over the run: run with tape and way back, over the run alone."""
        return (self.taped + self.back) / self.forward


def links(n: int) -> PHDAE:
    """A chain of n rigid links of 1 m whose particles, springs between next but one points and dampers between neighbours have
    parameters of their own, 3 n - 1 of them."""
    from phfmu.components.mechanical.multibody import Multibody

    body = Multibody("links", 3, description=f"chain of {n} rigid links with parameters of their own")
    body.gravity([0.0, 0.0, -9.81])
    points = [body.support([0.0, 0.0, 0.0])]
    points += [body.particle(1.0 + i / n, [i + 1.0, 0.0, 0.0], [0.0, (i + 1.0) / n, 0.0]) for i in range(n)]
    for a, b in zip(points, points[1:], strict=False):
        body.bar(a, b)
    for i, (a, b) in enumerate(zip(points, points[2:], strict=False), 1):
        body.quartic_spring(a, b, body.parameter(f"bending_{i}", 1.0 + 0.1 * (i % 3), unit="N/m3", min=0.0).sx, 2.0)
    for i, (a, b) in enumerate(zip(points, points[1:], strict=False), 1):
        body.damper(a, b, body.parameter(f"damping_{i}", 0.5 + 0.1 * (i % 5), unit="N.s/m"))
    return body.build()


def built(case: GradientCase) -> tuple[Model, float]:
    """The model, and the step of its scene."""
    from phfmu.components.mechanical.chain import chain
    from phfmu.components.scenes.electrical.ladder import ladder
    from phfmu.discretise.model import build_model, default_scheme
    from phfmu.target import scene

    name, _, n = case.name.partition(":")
    if name == "links":
        declaration, step = links(int(n)), 1e-2
    elif name == "chain":
        declaration, step = chain(int(n), damping=0.5, bending=1.0), 1e-2
    else:
        found = ladder(int(n)) if n else scene(name)
        declaration, step = found.declaration(), found.step
    return build_model(declaration, default_scheme(declaration, case.order)), step


def measure(case: GradientCase) -> GradientCost:
    """Times of one case, medians over turns."""
    from phfmu.engine.native.native import NativeInstance
    from phfmu.engine.native.reverse import NativeReverse, NativeTape, RowBars

    model, h = built(case)
    instance, plan = NativeInstance(model, kernels="compiled"), model.step
    n = _steps(instance, h)
    tape, back = NativeTape(instance, n + 64), NativeReverse(model, instance._native_model, 1)
    nothing = RowBars(np.zeros(0, np.int32), np.zeros((0, 1, 1)))
    row, part = np.arange(n, dtype=np.int32), np.ones(n)
    times = np.zeros((TURNS, 3))
    for turn in times:
        instance.reset()
        turn[0] = cpu_seconds(lambda: instance.run(0.0, h, n))
        instance.reset()
        with tape:
            turn[1] = cpu_seconds(lambda: instance.run(0.0, h, n))
        if len(tape.rows) != n:
            raise ValueError(f"{case.name}: steps of {h:g} s were halved")
        for bar in (back.bars.x, back.bars.p, back.bars.u):
            bar[:] = 0.0
        back.bars.x[0, : plan.nx] = 1.0
        turn[2] = cpu_seconds(lambda: back.back(tape.rows, instance.parameters, row, part, nothing))
    forward, taped, reverse = (1e6 * median(column) / n for column in times.T.tolist())
    return GradientCost(plan.np, plan.nx, plan.nw, forward, taped, reverse, instance.counts["schur"] > 0)


def _steps(instance: Any, h: float) -> int:
    """So many steps that a turn is long enough."""
    n = 50
    while True:
        instance.reset()
        if cpu_seconds(partial(instance.run, 0.0, h, n)) >= LEAST or n >= 20_000:
            return n
        n *= 2


@dataclass(frozen=True)
class TapeMemory:
    """Memory and times of a run of so many steps that keeps no tape but the last stretch: bytes kept, s of the run with all
    columns off, of the stretches that are run again, and of the whole way back, these included."""

    steps: int
    kept: int
    forward: float
    again: float
    back: float


def long_run(name: str = "smib", order: int = 2, steps: int = LONG) -> TapeMemory:
    """The memory of the derivative of a long run."""
    from phfmu.derivatives.taped import TapedSteps
    from phfmu.engine.native.native import NativeInstance

    model, h = built(GradientCase(name, order))
    plain = NativeInstance(model, kernels="compiled")
    forward = cpu_seconds(lambda: plain.run(0.0, h, steps))
    names = [n for v in model.declaration.parameters for n in v.names()]
    taped = TapedSteps(model, NativeInstance(model, kernels="compiled"), names, 0)
    taped.read()
    stretch = 4096
    for first in range(0, steps, stretch):
        taped.advance(0.0, h, min(stretch, steps - first), first)
    taped.take_again(taped.calls[0])
    kept = sum(len(call.state) for call in taped.calls) + taped.calls[0].kept
    again = cpu_seconds(lambda: [taped.take_again(call) for call in taped.calls[:8]]) * len(taped.calls) / 8
    last = np.eye(1, steps + 1, steps)[0]
    return TapeMemory(steps, kept, forward, again, cpu_seconds(lambda: taped.slopes([{"energy.dissipated": last}])))


def table(cases: Sequence[GradientCase] = CASES, progress: Callable[[str], None] = lambda _: None) -> str:
    """The costs of all cases in Markdown, and the machine."""
    head = [
        "model", "order", "parameters", "states", "unknowns", "stepped by", "run us", "with tape us", "back us", "gradient/run",
    ]  # fmt: skip
    rows = []
    for case in cases:
        progress(f"{case.name}, order {case.order}")
        c = measure(case)
        times = (f"{x:.2f}" for x in (c.forward, c.taped, c.back, c.ratio))
        stepper = "Schur" if c.schur else "Newton"
        rows.append([case.name, case.order, c.parameters, c.states, c.unknowns, stepper, *times])
    return f"{markdown_table(head, rows)}\n\n{machine_line()}"


PAGE = """# Gradients

The derivative of one number of a run by all parameters, all start values and all
[held inputs](../understand/glossary.md#held) at once, backwards: CPU time of a
step of the run with all columns off, of the same run with its tape written, and of a step of the way back. `gradient/run` is
what the whole gradient costs, run included, in runs; it does not depend on how many parameters there are.

    phfmu bench gradients -o docs/results/gradients.md

"""

AFTER = """
Where the sparse Newton's method steps, the way back takes one factor and one pass of the kernels in reverse where a step takes a
factor or two and some passes: less than a second run. Where the [Schur stepper](../understand/glossary.md#schur-stepper) steps
(`four_particle`, chains; `links` is a chain with parameters of their own for every link), its equations are solved transposed by
[the same factor](../internals/native-engine.md#the-way-back), in about as many sweeps as the step takes, each of which costs a
little more than one of these.
[Gradients beside other tools](gradient-peers.md) has a picture of errors and times beside CasADi and diffrax.

## Memory

"""


def page(progress: Callable[[str], None] = lambda _: None) -> str:
    """The page of the results."""
    told = table(progress=progress)
    progress("a long run")
    m = long_run()
    return (
        f"{PAGE}{told}\n{AFTER}"
        f"`smib` at order 2, {m.steps} steps with no memory for tapes but that of the last stretch: {m.kept / 1e6:.0f} MB are "
        f"kept (states at the starts of stretches, one tape). The run alone takes {m.forward:.1f} s; the way back "
        f"{m.back:.1f} s, of which {m.again:.1f} s ({m.again / m.forward:.2f} runs) are the stretches that are run again.\n"
    )
