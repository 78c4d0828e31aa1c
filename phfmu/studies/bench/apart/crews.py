"""Gain of threads where coupled members take long: chains of links that hold each other by their tips."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from statistics import median
from time import perf_counter
from typing import TYPE_CHECKING

from phfmu.studies.bench.apart.networks import composed, instances, joined, planned

if TYPE_CHECKING:
    from phfmu.network.couplings.stepper import Stepper
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


class _Turns:
    """Wall times of a stepper that goes on from turn to turn, and what it found last."""

    def __init__(self, stepper: Stepper):
        self._stepper, self._first = stepper, 0
        stepper.check_start()
        stepper.prepare(0.0, STEP)
        self.take()
        self.times: list[float] = []

    def take(self) -> None:
        before = perf_counter()
        steps = self._stepper.advance(0.0, STEP, TURN, self._first)
        spent = perf_counter() - before
        if self._first:
            self.times.append(1e6 * spent / TURN)
        self._first += TURN
        self.found, self.trials = steps.signals[-1].tobytes(), steps.spent / TURN


def gain(members: int, links: int, threads: int) -> ThreadGain:
    network = chains(members, links)
    models = planned(network, 1)
    turns = [_Turns(joined(network, instances(models), n)) for n in (1, threads)]
    turns.append(_Turns(composed(network, 1)))
    for _ in range(TURNS):
        for each in turns:
            each.take()
    one, every, together = (t.times for t in turns)
    return ThreadGain(
        members, links, threads, median(one) / turns[0].trials, median(one), median(every),
        median(a / b for a, b in zip(one, every, strict=True)), median(a / b for a, b in zip(one, together, strict=True)),
        turns[0].found == turns[1].found,
    )  # fmt: skip


def table(progress: Callable[[str], None] = lambda _: None) -> str:
    """In Markdown, with as many threads as cores; a line that says why there is none where there is one core."""
    from phfmu.processors import processors

    threads = processors()
    if threads < 2:
        return "Threads: not measured, this machine has one core."
    head = [
        "chains",
        "links",
        "trial us",
        "1 thread us",
        f"{threads} threads us",
        "gain",
        "same bits",
        "apart / composed",
    ]
    lines = ["| " + " | ".join(head) + " |", "|" + " --- |" * len(head)]
    for members, links in SIZES:
        progress(f"{members} chains of {links}")
        g = gain(members, links, threads)
        lines.append(
            f"| {g.members} | {g.links} | {g.trial:.0f} | {g.one:.0f} | {g.all:.0f} | {g.gain:.2f} | "
            f"{'yes' if g.same else 'no'} | {g.ratio:.2f} |"
        )
    return "\n".join(lines)
