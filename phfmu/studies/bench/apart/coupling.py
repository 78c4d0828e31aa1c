"""Cost of stepping members apart, and composed; and how it grows with the members."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from gc import collect
from statistics import median
from time import thread_time
from typing import TYPE_CHECKING, Any

from phfmu.studies.bench.apart import own_time
from phfmu.studies.bench.apart.networks import composed, instances, joined, planned
from phfmu.studies.bench.apart.own_time import OwnTime
from phfmu.studies.bench.apart.turns import StepperTurns, in_turns
from phfmu.studies.tables import markdown_table

if TYPE_CHECKING:
    from phfmu.network.network import Network

ROUNDS = 15  # turns that the median is of
#: name -> step (s)
SCENES = {"oscillator": 1e-2, "drive": 1e-3, "smib": 1e-3, "two_machine": 1e-4}
#: name -> step (s), where members take one held value
HELD = {"oscillator": 1e-3, "drive": 1e-4, "smib": 2e-5, "ring": 1e-3}
RING = 20  # masses of that
#: masses around a ring, or around the one in the middle
SIZES = {"ring": (10, 50, 150), "star": (10, 100, 500)}
LONG = 0.01  # s, their step


@dataclass(frozen=True)
class ApartCost:
    """CPU time of a step in us, medians over turns: composed, members apart; median of the ratios.

    own, units: where the time goes per member and step, of native members and of the same as FMUs
    """

    name: str
    order: int
    members: int
    composed: float
    apart: float
    ratio: float
    trials: float
    own: OwnTime
    units: OwnTime


def measure(name: str, network: Network, h: float, k: int) -> ApartCost:
    """Turn by turn, so that what else the machine does falls on all alike."""
    members = instances(planned(network, k))
    both = [StepperTurns(composed(network, k), h, 200), StepperTurns(joined(network, members), h, 200)]
    in_turns(both, ROUNDS)
    one, two = (c.times for c in both)
    ratio = median(b / a for a, b in zip(one, two, strict=True))
    trials, apart = both[1].trials, median(two)
    own, unit = own_time.native(network, k, h), own_time.units(network, k, h)
    return ApartCost(name, 2 * k, len(members), median(one), apart, ratio, trials, own, unit)


@dataclass(frozen=True)
class CouplingCost:
    """CPU time of a step in us by one of the couplings with one held value; where the own time goes."""

    network: str
    members: int
    coupling: str
    step: float
    trials: float
    own: OwnTime


def by_coupling(name: str, network: Network, h: float) -> list[CouplingCost]:
    """Members of order 2, turn by turn; couplings that a network cannot be stepped by are left out."""
    from phfmu.network.couplings.coupling_table import COUPLINGS

    models, rows = planned(network, 1), list[CouplingCost]()
    for row in (r for r in COUPLINGS.values() if r.apart):
        try:
            turns = StepperTurns(joined(network, instances(models), coupling=row.kind()), h, 200)
        except ValueError:  # no output gives a junction its value
            continue
        in_turns([turns], ROUNDS)
        own = own_time.native(network, 1, h, row.kind())
        rows.append(CouplingCost(name, len(models), row.name, median(turns.times), turns.trials, own))
    return rows


def ring(n: int) -> Network:
    """n masses with springs between them, closed."""
    from phfmu.components.mechanical.translational import mass, spring
    from phfmu.network.network import Network

    net = Network(f"ring_{n}")
    for i in range(n):
        net.add(f"m{i}", mass(1.0, v=float(i == 0)))
        net.add(f"s{i}", spring(100.0))
    for i in range(n):
        net.junction(f"j{i}", [f"m{i}.flange", f"s{i}.a", f"s{i - 1 if i else n - 1}.b"])
    return net


def star(n: int) -> Network:
    """n masses, each on a spring to one in the middle: a junction of n + 1 ports."""
    from phfmu.components.mechanical.translational import mass, spring
    from phfmu.network.network import Network

    net = Network(f"star_{n}")
    net.add("middle", mass(1.0, v=1.0))
    for i in range(n):
        net.add(f"m{i}", mass(1.0))
        net.add(f"s{i}", spring(100.0))
        net.junction(f"j{i}", [f"m{i}.flange", f"s{i}.b"])
    net.junction("hub", ["middle.flange", *(f"s{i}.a" for i in range(n))])
    return net


@dataclass(frozen=True)
class NetworkCost:
    """CPU times of a network of many members, order 2.

    plans: how many were made;  plan, code, join: s for these, for instances with their libraries, and for what joins them with
    the start and the first step;  step: us per member and step, the least of some turns
    """

    members: int
    plans: int
    plan: float
    code: float
    join: float
    step: float


def growth(make: Callable[[int], Network], n: int) -> NetworkCost:
    collect()  # plans are shared as long as one is in use
    network = make(n)
    before = thread_time()
    models = planned(network, 1)
    after_plan = thread_time()
    members = instances(models)
    after_code = thread_time()
    stepper = joined(network, members)
    stepper.check_start()
    stepper.prepare(0.0, LONG)
    stepper.advance(0.0, LONG, 1)
    after_join = thread_time()
    turns = StepperTurns(stepper, LONG, 20)
    in_turns([turns], 5)
    count, plans = len(members), len({id(m.step) for m in models.values()})
    seconds = after_plan - before, after_code - after_plan, after_join - after_code
    return NetworkCost(count, plans, *seconds, min(turns.times) / count)


NETWORKS = {"ring": ring, "star": star}


def table(scenes: Sequence[str] = (), progress: Callable[[str], None] = lambda _: None) -> str:
    """All tables in Markdown, and the machine."""
    from phfmu.studies.bench.apart import crews
    from phfmu.studies.bench.machine import machine_line

    tables = (
        *_scene_tables(scenes or list(SCENES), progress), _coupling_table(progress), _growth_table(progress),
        crews.table(progress), machine_line(),
    )  # fmt: skip
    return "\n\n".join(tables)


def _scene_tables(scenes: Sequence[str], progress: Callable[[str], None]) -> tuple[str, str]:
    """Scenes composed and apart at each order; where the time of their members goes."""
    from phfmu.target import scene

    rows, owns = [], []
    for name in scenes:
        for k in (1, 2, 3):
            progress(f"{name}, order {2 * k}")
            network: Any = scene(name).system
            r = measure(name, network, SCENES[name], k)
            times = f"{r.composed:.1f}", f"{r.apart:.1f}", f"{r.ratio:.2f}", f"{r.trials:.1f}"
            rows.append([r.name, r.order, r.members, *times])
            for kind, t in (("native", r.own), ("FMU", r.units)):
                parts = [t.steps, t.exchange, t.join, t.solve, t.columns, t.own]
                owns.append([r.name, r.order, kind, *(f"{x:.2f}" for x in parts)])
    head = ["scene", "order", "members", "composed us", "apart us", "apart / composed", "trials"]
    parts = ["steps us", "exchange us", "join us", "solve us", "columns us", "own us"]
    return markdown_table(head, rows), markdown_table(["scene", "order", "members", *parts], owns)


def _coupling_table(progress: Callable[[str], None]) -> str:
    """All couplings with one held value."""
    from phfmu.target import scene

    rows = []
    for name, h in HELD.items():
        progress(f"{name}, by all couplings")
        network: Any = ring(RING) if name == "ring" else scene(name).system
        for c in by_coupling(name, network, h):
            numbers = [c.step, c.trials, c.own.exchange, c.own.join, c.own.solve, c.own.own]
            rows.append([c.network, c.members, c.coupling, *(f"{x:.2f}" for x in numbers)])
    head = ["network", "members", "coupling", "step us", "trials", "exchange us", "join us", "solve us", "own us"]
    return markdown_table(head, rows)


def _growth_table(progress: Callable[[str], None]) -> str:
    """Rings and stars of masses and springs."""
    rows = []
    for make, sizes in SIZES.items():
        for n in sizes:
            progress(f"{make}, {n}")
            g = growth(NETWORKS[make], n)
            rows.append([make, g.members, g.plans, *(f"{x:.2f}" for x in (g.plan, g.code, g.join, g.step))])
    return markdown_table(["network", "members", "plans", "plan s", "code s", "join s", "us per member and step"], rows)


PAGE = """# Members apart

CPU time of a step with all its columns and ledger rows: of the composed model in compiled code, of its members joined by
`newton` in compiled code, and by the same loop in Python. Taken in turns on one machine, medians; `apart / composed`: median of
the ratios of neighbours; `trials`: of each member per step.

The second table divides a step apart by members, native ones and the same as FMUs (FMI 3.0): time per member and step,
of the shortest of 30 turns. A clock in the compiled loop tells it, which is read twice for each call of a library; what a reading
costs is measured and taken out, and in a run the clock is off. `steps` is spent in steps and derivatives of the members,
`exchange` in their functions that save, load, set and read, `join` in rows, matrix and records, `solve` in what solves the
interface and, at [bare nodes](../understand/glossary.md#bare-node), the impulses; `columns` in Python, which makes the columns
and ledger rows of 100 steps at once. `own` is all but `steps`.

The third table has all couplings, with one held value per step and members of order 2: CPU time of a step, in compiled code
and in Python, and the time per member and step that is not the members' own steps, also as a ratio to that of `newton`. What
iterates pays it in each trial.

Below, masses and springs, order 2: the cost of a member does not grow with their number. Members that are alike share a plan
and its code: CPU seconds for the plans, for all instances with their libraries (compiled before), and for what joins them, with
the start and the first step.

Last, chains of links at a 1-junction, order 2, wall time: what threads gain where a trial of the members takes long. They step
members, ask them for derivatives and for values at the end; the results are the same bits.

    phfmu bench coupling -o docs/results/coupling.md

"""


def page(progress: Callable[[str], None] = lambda _: None) -> str:
    return PAGE + table(progress=progress) + "\n"
