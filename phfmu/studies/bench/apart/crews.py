"""Gain of threads where coupled members take long: chains of links that hold each other by their tips."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from statistics import median
from time import perf_counter
from typing import TYPE_CHECKING

from phfmu.studies.bench.apart.networks import composed, instances, joined, planned
from phfmu.studies.bench.apart.turns import StepperTurns, in_turns
from phfmu.studies.tables import markdown_table

if TYPE_CHECKING:
    from phfmu.network.network import Network

#: chains, links of each
SIZES = ((2, 20), (2, 60), (2, 200), (4, 100))
STEP, TURN, TURNS = 1e-4, 200, 5  # s; steps of a turn (threads are started in each), turns that the medians are of


@dataclass(frozen=True)
class ThreadGain:
    """Wall time in us: of a trial of all members and of a step by one thread, of a step by `threads`, of one composed.

    gain, ratio: medians over neighbouring turns, of one thread / all, and of one thread / composed
    """

    members: int
    links: int
    threads: int
    trial: float
    one: float
    all: float
    gain: float
    ratio: float
    same: bool


def chains(members: int, links: int) -> Network:
    """Chains whose tips move together: a 1-junction."""
    from phfmu.components.mechanical.chain import chain
    from phfmu.network.network import Network

    network = Network(f"chains_{members}_{links}")
    for i in range(members):
        network.add(f"c{i}", chain(links, port=True))
    network.junction("tips", [f"c{i}.tip" for i in range(members)], kind="1")
    return network


def gain(members: int, links: int, threads: int) -> ThreadGain:
    network = chains(members, links)
    models = planned(network, 1)
    steppers = [*(joined(network, instances(models), n) for n in (1, threads)), composed(network, 1)]
    turns = [StepperTurns(s, STEP, TURN, warm=TURN, clock=perf_counter) for s in steppers]
    in_turns(turns, TURNS)
    one, every, together = (t.times for t in turns)
    return ThreadGain(
        members, links, threads, median(one) / turns[0].trials, median(one), median(every),
        median(a / b for a, b in zip(one, every, strict=True)), median(a / b for a, b in zip(one, together, strict=True)),
        turns[0].end == turns[1].end,
    )  # fmt: skip


def table(progress: Callable[[str], None] = lambda _: None) -> str:
    """The gains in Markdown, with as many threads as cores; a line that says why there is none where there is one core."""
    from phfmu.processors import processors

    threads = processors()
    if threads < 2:
        return "Threads: not measured, this machine has one core."
    rows = []
    for members, links in SIZES:
        progress(f"{members} chains of {links}")
        g = gain(members, links, threads)
        times = f"{g.trial:.0f}", f"{g.one:.0f}", f"{g.all:.0f}", f"{g.gain:.2f}"
        rows.append([g.members, g.links, *times, "yes" if g.same else "no", f"{g.ratio:.2f}"])
    times = ["trial us", "1 thread us", f"{threads} threads us"]
    return markdown_table(["chains", "links", *times, "gain", "same bits", "apart / composed"], rows)
