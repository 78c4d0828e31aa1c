"""Blame: which junction and which member of a co-simulation made energy, when, by what, and what to do about it.

Of a junction the net energy hides what cancels from step to step, so the gross one counts: the sum of |energy made in a step|.
Each step's energy belongs to a cause: inputs that were extrapolated over the step (explicit couplings), an iteration that was
given up or left something, or the prediction of a member that is stepped last.

Of a member W(t) is the energy through its ports since the start, positive into it.  One that keeps no books (a unit of another
tool) has given out -min W that it was not given before: a store of at least that was in it at the start, or it makes energy.  It
makes energy where it goes on giving: in the second half of the run a part `GOES_ON` of all, and in the last quarter more than the
estimate is known to.  A store that empties as exp(-t / T) does not, once the run is longer than 2.2 T.
"""

from __future__ import annotations

import os
from collections.abc import Iterator
from dataclasses import dataclass, field, replace
from typing import TYPE_CHECKING

import numpy as np

from phfmu.audit.analysis import summarise
from phfmu.audit.judge import DEFAULT_RTOL
from phfmu.audit.kinds import Quality, RowKind
from phfmu.audit.log.reading import Batches, InternedNames, LogRows
from phfmu.audit.violation import COMPONENT, JUNCTION, Violation, ViolationKind
from phfmu.words import first_few

if TYPE_CHECKING:
    import pyarrow as pa

EXTRAPOLATED = "inputs extrapolated over a step"
UNCONVERGED = "iterations that were given up"
ITERATED = "what the iteration left"
PREDICTED = "predictions of members stepped last"
#: words of the log: the test of a step that was kept though it did not converge; the part that estimates missed
_KEPT, _MISSED = "unconverged", "estimated ports"

#: parts of the run at whose ends the least W is looked at
MARKS = 4
#: of what a member gives out in a run, what it gives in the second half if no store explains it
GOES_ON = 0.25
#: of sum |energy of its ports|: to this part the quadrature of a unit's ports is known, (w h)^2 / 12 with w h = 0.1
KNOWN = 1e-3
#: of what was exchanged: less is not worth a sentence
WORTH = 1e-9

_REMEDIES = {
    EXTRAPOLATED: "a smaller step (what is made falls with it), --coupling newton where the members take steps back, or "
    "--coupling gauss-seidel with another --sequence",
    UNCONVERGED: "--unconverged halve, or a smaller step",
    ITERATED: "it is what the tolerance of the iteration leaves; a smaller step leaves less",
    PREDICTED: "a smaller step, or a member that can save its state (`phfmu vet` says whether it does)",
}
#: books that are judged -> violations of them
_BOOKS = {"member": COMPONENT, "port": (ViolationKind.EXCHANGED,), "junction": JUNCTION}
_CONTRADICTIONS = {
    "member": "its books do not close: look at its declared losses, and at what it tells of its ports and of its energy",
    "port": "what it takes is not what it is given, or what it gives is not what is told: look at the sign, the unit and the "
    "delay between it and its junction",
    "junction": "the energies that its members book there do not add up: look at signs, units and delays between them",
}


@dataclass
class JunctionBlame:
    """A junction over a run, energies in J: `net`, `gross`, `exchanged`; `causes`: cause -> gross; `worst`: step that made most.

    `members`: those whose ports meet there;  `worst_t`: start of that step (s).
    """

    junction: str
    members: list[str] = field(default_factory=list)
    net: float = 0.0
    gross: float = 0.0
    exchanged: float = 0.0
    causes: dict[str, float] = field(default_factory=dict)
    worst: float = 0.0
    worst_t: float = 0.0


@dataclass
class MemberBlame:
    """A member over a run, energies in J: `net` W at the end, `gross`, the least W with its time (s), the least up to each mark.

    `quality`: of its ports, see `Quality`.
    """

    component: str
    quality: str
    net: float = 0.0
    gross: float = 0.0
    least: float = 0.0
    least_t: float = 0.0
    lows: list[float] = field(default_factory=list)

    @property
    def makes(self) -> bool:
        """Whether it goes on giving out more than it was given, to the end of the run."""
        if len(self.lows) < MARKS or self.least >= -KNOWN * self.gross:
            return False
        _, half, late, end = self.lows
        return half - end >= -GOES_ON * end and late - end > KNOWN * self.gross


@dataclass
class Blame:
    """Junctions and members of a run, those that made most first."""

    junctions: list[JunctionBlame]
    members: list[MemberBlame]
    violations: list[Violation] = field(default_factory=list)
    #: member of each port, `member.port`
    owners: dict[str, str] = field(default_factory=dict)


def blame(source: pa.Table | str | os.PathLike[str], rtol: float = DEFAULT_RTOL) -> Blame:
    """Net and gross energies of the junctions and members of an audit log; two passes, memory does not grow with it.

    Errors: ValueError for a file that is not an audit log.
    """
    found = _BlameSums(*_kept(source))
    batches = Batches(source)
    for batch in batches:
        found.take(batch, batches.interned)
    return replace(found.blame(), violations=summarise(source, rtol).violations)


def _kept(source: pa.Table | str | os.PathLike[str]) -> tuple[dict[int, str], tuple[float, float]]:
    """The tests by which a coupling took its steps, of those that it gave up or iterated; start and end of the run (s)."""
    batches, kept, start, end = Batches(source), dict[int, str](), np.inf, -np.inf
    for batch in batches:
        rows = batch.get(RowKind.NETWORK)
        if rows is None:
            continue
        t0 = rows.values("t0")
        start, end = min(start, t0.min()), max(end, (t0 + rows.values("h")).max())
        codes = rows.names["accepted_by"]
        kept |= {int(rows.step[i]): batches.interned.name(codes[i]) or "" for i in np.flatnonzero(codes >= 0)}
    return kept, (float(start), float(end))


class _BlameSums:
    """The sums of one pass; `kept`: by which test iterated steps were taken;  `span`: of the run (s)."""

    def __init__(self, kept: dict[int, str], span: tuple[float, float]):
        self._kept, (start, end) = kept, span
        self._marks = start + (end - start) * np.arange(1, MARKS + 1) / MARKS
        self.junctions: dict[str, JunctionBlame] = {}
        self.members: dict[str, MemberBlame] = {}
        self._owners: dict[str, str] = {}
        self._divided: set[str] = set()

    def take(self, batch: dict[RowKind, LogRows], interned: InternedNames) -> None:
        """The rows of a batch."""
        if RowKind.PORT in batch:
            self._ports(batch[RowKind.PORT], interned)
        if RowKind.PART in batch:
            self._parts(batch[RowKind.PART], interned)
        if RowKind.JUNCTION in batch:
            self._junctions(batch[RowKind.JUNCTION], interned)

    def _ports(self, rows: LogRows, interned: InternedNames) -> None:
        ends, energies = rows.values("t0") + rows.values("h"), rows.values("supplied")
        met = {*zip(rows.names["component"].tolist(), rows.names["junction"].tolist(), strict=True)}
        for component, junction in sorted(met):
            if junction >= 0:
                known = self._junction(interned.name(junction) or "").members
                known += [n for n in [interned.name(component) or ""] if n not in known]
        for component, port in {*zip(rows.names["component"].tolist(), rows.names["port"].tolist(), strict=True)}:
            name = interned.name(component) or ""
            self._owners[f"{name}.{interned.name(port)}"] = name
        for code in np.unique(rows.names["component"]):
            own = rows.names["component"] == code
            name = interned.name(code) or ""
            quality = interned.name(rows.names["quality"][own][0]) or Quality.EXACT
            member = self.members.setdefault(name, MemberBlame(name, quality))
            self._run(member, ends[own], energies[own])

    def _run(self, member: MemberBlame, ends: np.ndarray, energies: np.ndarray) -> None:
        """W goes on through the steps of a batch; its pairs of one step are taken together."""
        last = np.flatnonzero(np.append(np.diff(ends) > 0.0, True))
        W, times = member.net + np.cumsum(energies)[last], ends[last]
        member.gross += float(np.abs(energies).sum())
        lows = np.minimum(np.minimum.accumulate(W), member.least)
        while len(member.lows) < MARKS and times[-1] >= (mark := self._marks[len(member.lows)] * (1.0 - 1e-12)):
            member.lows.append(float(lows[np.searchsorted(times, mark)]))
        i = int(np.argmin(W))
        if W[i] < member.least:
            member.least, member.least_t = float(W[i]), float(times[i])
        member.net = float(W[-1])

    def _parts(self, rows: LogRows, interned: InternedNames) -> None:
        made = np.abs(rows.values("residual"))
        for code in np.unique(rows.names["part"]):
            predicted = interned.name(code) == _MISSED
            for j in np.unique(rows.names["junction"]):
                own = (rows.names["part"] == code) & (rows.names["junction"] == j)
                name = interned.name(j) or ""
                self._divided.add(name)
                causes = self._junction(name).causes
                if predicted:
                    causes[PREDICTED] = causes.get(PREDICTED, 0.0) + float(made[own].sum())
                else:
                    self._by_test(causes, rows.step[own], made[own])

    def _by_test(self, causes: dict[str, float], steps: np.ndarray, made: np.ndarray) -> None:
        tests = [self._kept.get(s) for s in steps.tolist()]
        for cause, chosen in (
            (EXTRAPOLATED, [t is None for t in tests]),
            (UNCONVERGED, [t == _KEPT for t in tests]),
            (ITERATED, [t is not None and t != _KEPT for t in tests]),
        ):
            if any(chosen):
                causes[cause] = causes.get(cause, 0.0) + float(made[np.array(chosen)].sum())

    def _junctions(self, rows: LogRows, interned: InternedNames) -> None:
        for code in np.unique(rows.names["junction"]):
            own = rows.names["junction"] == code
            name, made = interned.name(code) or "", rows.values("residual")[own]
            junction = self._junction(name)
            junction.net += float(made.sum())
            junction.gross += float(np.abs(made).sum())
            junction.exchanged += float(rows.values("exchanged")[own].sum())
            i = int(np.argmax(np.abs(made)))
            if abs(made[i]) > abs(junction.worst):
                junction.worst, junction.worst_t = float(made[i]), float(rows.values("t0")[own][i])
            if name not in self._divided:
                self._by_test(junction.causes, rows.step[own], np.abs(made))

    def _junction(self, name: str) -> JunctionBlame:
        return self.junctions.setdefault(name, JunctionBlame(name))

    def blame(self) -> Blame:
        """Sums of the run so far, those that made most first."""
        junctions = sorted(self.junctions.values(), key=lambda j: -j.gross)
        return Blame(junctions, sorted(self.members.values(), key=lambda m: m.least), owners=self._owners)


@dataclass(frozen=True)
class Finding:
    """A sentence about a "member" or "junction" of that name; `accuses`: it tells of a fault, not of what a coupling costs."""

    subject: str
    name: str
    text: str
    accuses: bool


def findings(found: Blame) -> list[Finding]:
    """Findings of a run: contradictions of the ledger, members that make energy, energy made by the coupling, each by size."""
    makers = [f for f in _of_members(found) if f.accuses]
    stores = [f for f in _of_members(found) if not f.accuses]
    return [*_of_violations(found), *makers, *_of_junctions(found), *stores]


def why(found: Blame) -> list[str]:
    """Sentences in the order of `findings`, each with its remedy."""
    told = findings(found)
    if not told:
        nothing = f"No junction made more than {WORTH:g} of what it exchanged"
        return [f"{nothing}, and no member gave out what it had not been given."]
    return [f.text for f in told]


def _of_violations(found: Blame) -> Iterator[Finding]:
    """A sentence for each member, port, and junction whose books do not close, each by its worst step, in that order."""
    worst = sorted(found.violations, key=lambda v: -v.ratio)
    for subject, kinds in _BOOKS.items():
        for name in dict.fromkeys(v.name for v in worst if v.kind in kinds):
            own = next(v for v in worst if v.name == name and v.kind in kinds)
            text = f"{subject.capitalize()} {own}. Next: {_CONTRADICTIONS[subject]}."
            about = ("member", found.owners.get(name, name)) if subject == "port" else (subject, name)
            yield Finding(*about, text, True)


def _of_junctions(found: Blame) -> Iterator[Finding]:
    for j in found.junctions:
        if j.gross <= WORTH * j.exchanged:
            continue
        causes = [c for c in sorted(j.causes, key=lambda c: -j.causes[c]) if j.causes[c] > 0.01 * j.gross]
        shares = ", ".join(f"{j.causes[c] / sum(j.causes.values()):.0%} by {c}" for c in causes)
        share = f" ({100.0 * j.gross / j.exchanged:.2g} %)" if j.exchanged else ""
        yield Finding(
            "junction",
            j.junction,
            f"Junction {j.junction} of {first_few(j.members)} made {j.gross:.3g} J gross, {j.net:.3g} J net, of "
            f"{j.exchanged:.3g} J exchanged{share}: {shares}; most at t = {j.worst_t:.6g} s ({j.worst:.3g} J in a step). "
            f"Next: {_REMEDIES[causes[0]]}.",
            False,
        )


def _of_members(found: Blame) -> Iterator[Finding]:
    for m in found.members:
        if m.quality == Quality.EXACT or m.least >= -WORTH * m.gross or not m.gross:
            continue
        given = f"Member {m.component} has given out {-m.least:.3g} J more than it was given by t = {m.least_t:.6g} s"
        if m.makes:
            text = (
                f"{given}, and goes on to the end of the run: it makes energy, or has a source. "
                "Next: look at the sign and the units of its ports, and try `phfmu vet` on it (claim passivity)."
            )
        else:
            # what a store explains says nothing against it: it comes after all that was made
            text = f"{given}: it had a store of at least that at the start, since it keeps no books."
        yield Finding("member", m.component, text, m.makes)
