"""The campaign as a table and a page."""

from __future__ import annotations

from collections import Counter
from collections.abc import Callable, Sequence
from dataclasses import dataclass, field

from phfmu.studies.blame.campaign import Exclusion, FaultOutcome, outcome
from phfmu.studies.blame.faults import FaultKind, FaultPlace
from phfmu.studies.blame.networks import COUPLINGS
from phfmu.studies.tables import markdown_table

CASES = 200
#: draws of a case, after which none of its kind is expected to be admitted
ATTEMPTS = 200

HEAD = """# Who is blamed

How often [`phfmu audit FILE --why`](../use/read-an-audit.md#who-made-the-energy) names the one that makes the energy. Each
case is a network of 2 to 8 members (electrical, translational, rotational, or electrical with motors and shafts), drawn from
a seed with its parameters, starts, step size and coupling, with one fault in one member or in one of its connections; about
half of the members keep no books, as units of other tools. It is run for 400 steps with the fault and without. The case is a
*hit* where the first sentence names the guilty member, or, for a fault of a connection, the junction it is at. It is
*innocent named* where the first sentence names another one. *Control named* counts runs without a fault in which a sentence
tells of one; what a coupling made itself, by extrapolated inputs, is no fault.

A fault is planted on one signal of a port: a factor (`gain` 0.1 to 4; `unit factor` 1e3, 60/2pi, pi/180, ..; `sign`), a
`delay` of 1 to 5 steps, `lost samples` (an input that 5 to 50 % of the steps do not update), a `quantised output` (0.05 to
0.5 of what members swing by); or it is a damper of negative size inside. What the books say decides what can be seen of it:

- *connection*: the books of the member are right, the values on their way are not. What its port books is not what was
  exchanged.
- *member with books*: the ledger is made of what the member tells, so that its balance does not close, or its dissipation is
  negative.
- *member without books*: all that is known is `W(t)`, the energy through its ports, by a quadrature. It is blamed where it
  goes on giving more than it was given.

A fault that the energies cannot show in principle is drawn again, by these rules:

- *changed nothing*: what the fault made, the sum of |energy told - energy taken|, is below 1e-6 of what the member exchanged.
- *the member stays passive*: it keeps no books, and `W(t) >= -H(0)` at all times. A passive member with that store at the
  start could have exchanged the same energies (Willems, Dissipative dynamical systems, 1972), such as one with all energies
  scaled by a gain.
- *less than its estimate is known to*: it keeps no books, and gave out less than 1e-3 of the sum of |energy| of its ports.
- *a store at the start explains it*: it keeps no books, and gave less than a quarter of what it gave out in the second half
  of the run.
- *refused before the first step*: there is no log.

"Less than its estimate is known to" and "a store at the start explains it" use the bounds by which `--why` does not blame
members without books: what they leave out, it would not name. They are counted for that reason. A gain, a sign or a delay of a
signal without power, such as a set point, is in no energy, and not in the campaign.

Seed 1 is the one whose misses were looked at when the rules of `--why` were made. Of 200 cases of each of the seeds 1 and 2
at least 190 are hits, and at most 2 name an innocent one, or one in a run without a fault:
`pytest -m long tests/audit/test_planted_faults.py`.

    phfmu bench blame {arguments} -o docs/results/blame.md
"""


@dataclass
class CampaignResult:
    """Outcomes of the cases of a seed; `left_out`: kind of fault and reason -> draws."""

    seed: int
    outcomes: list[FaultOutcome] = field(default_factory=list)
    left_out: Counter[tuple[FaultKind, str]] = field(default_factory=Counter)


def measure(
    seed: int, cases: int = CASES, progress: Callable[[str], None] | None = None, most: int = 8
) -> CampaignResult:
    """The cases of a seed, of networks of 2 to `most` members, each drawn until its fault is admitted."""
    found = CampaignResult(seed)
    for number in range(cases):
        if progress is not None:
            progress(f"seed {seed}: case {number + 1} of {cases} ...")
        for attempt in range(ATTEMPTS):
            case = outcome(seed, number, attempt, most)
            if not case.left_out:
                found.outcomes.append(case)
                break
            found.left_out[case.fault.kind, case.left_out] += 1
    return found


def table(found: CampaignResult) -> str:
    """Rows by kind of fault, by where it is and by coupling, in Markdown."""
    head = ["", "cases", "hits", "innocent named", "control named", *(f"left out: {r.value}" for r in Exclusion)]
    rows = []
    for kind in FaultKind:
        left = [str(found.left_out[kind, r]) for r in Exclusion]
        rows.append([kind.value, *_counts([o for o in found.outcomes if o.fault.kind is kind]), *left])
    for where in FaultPlace:
        rows.append([where.value, *_counts([o for o in found.outcomes if o.where is where]), *[""] * len(Exclusion)])
    for coupling in COUPLINGS:
        own = [o for o in found.outcomes if o.drawn.coupling == coupling]
        rows.append([f"`{coupling}`", *_counts(own), *[""] * len(Exclusion)])
    all_left = [str(sum(n for (_, why), n in found.left_out.items() if why == r)) for r in Exclusion]
    rows.append(["all", *_counts(found.outcomes), *all_left])
    return markdown_table(head, rows)


def _counts(own: Sequence[FaultOutcome]) -> list[str]:
    return [
        str(len(own)), str(sum(o.hit for o in own)), str(sum(o.innocent for o in own)),
        str(sum(bool(o.control) for o in own)),
    ]  # fmt: skip


def summary(found: CampaignResult) -> str:
    """A line: parts of the cases."""
    n = max(len(found.outcomes), 1)
    _, hits, innocent, control = map(int, _counts(found.outcomes))
    return (
        f"Seed {found.seed}: {hits} of {n} hits ({hits / n:.1%}), an innocent one first in {innocent} ({innocent / n:.1%}), "
        f"one named in {control} of {n} runs without a fault ({control / n:.1%}); {sum(found.left_out.values())} draws left out."
    )


def misses(found: CampaignResult) -> str:
    """A line for each miss: what was planted, and what was said first."""
    lines = []
    for o in found.outcomes:
        if not o.hit:
            said = o.told[0].split(";")[0] if o.told else "nothing"
            planted = f"{o.fault.kind.value} of {o.guilty} ({o.where.value}, {o.drawn.coupling}, {o.drawn.step:g} s)"
            lines.append(f"- case {o.number}, {planted}: {said}")
    return "\n".join(lines)


def page(found: Sequence[CampaignResult]) -> str:
    """The page in Markdown."""
    seeds, cases = ",".join(str(f.seed) for f in found), max((len(f.outcomes) for f in found), default=0)
    text = [HEAD.format(arguments=f"--seeds {seeds} --cases {cases}")]
    for f in found:
        text += [f"## Seed {f.seed}", "", summary(f), "", table(f), ""]
        if missed := misses(f):
            text += ["Misses:", "", missed, ""]
    return "\n".join(text)
