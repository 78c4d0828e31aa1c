"""A campaign of planted faults: networks, faults and couplings are drawn from a seed, run, and judged by what `--why` says first.

A fault is admitted where the energies of a run can tell it at all.  It is left out, and counted, where

- the run is refused before its first step, so that there is no log;
- it changed nothing: what it made, sum |energy told at its port - energy taken there|, is less than `ACTED` of what its member
  exchanged;
- its member keeps no books and stays passive: W(t) >= -H(0) at all times.  A passive member with the same store at the start can
  have given the same energies (J. C. Willems, Dissipative dynamical systems, Arch. Rational Mech. Anal. 45, 1972, 321);
- its member keeps no books, and gave out no more than a part `KNOWN` of its sum |energy of the ports|, which is what a
  quadrature of the ports is known to;
- its member keeps no books, and gave out less than a quarter of it in the second half of the run: a store that empties explains
  that.
"""

from __future__ import annotations

from contextlib import suppress
from dataclasses import dataclass, field
from enum import StrEnum
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any

import numpy as np

from phfmu.audit.blame import GOES_ON, KNOWN, Finding, blame, findings
from phfmu.studies.blame.faults import FaultKind, FaultPlace, FaultyMember, PlantedFault
from phfmu.studies.blame.networks import COUPLINGS, KINDS, STEPS, RandomNetwork, draw, members

#: of the energy that a member exchanges: a fault that makes less has not acted
ACTED = 1e-6
UNITS = (1e3, 1e-3, 60.0 / (2.0 * np.pi), 2.0 * np.pi / 60.0, np.pi / 180.0, 180.0 / np.pi, 1e6, 1e-6)


class Exclusion(StrEnum):
    """Why a fault is left out."""

    REFUSED = "refused before the first step"
    IDLE = "changed nothing"
    PASSIVE = "the member stays passive"
    SMALL = "less than its estimate is known to"
    ENDS = "a store at the start explains it"


@dataclass
class FaultOutcome:
    """The outcome of a case: the guilty member, the first sentence, the name in it; `left_out`: why it does not count, or "".

    control:  members and junctions that are named in the run without the fault
    """

    number: int
    drawn: RandomNetwork
    guilty: str
    fault: PlantedFault
    where: FaultPlace
    left_out: str = ""
    hit: bool = False
    innocent: bool = False
    told: list[str] = field(default_factory=list)
    control: list[str] = field(default_factory=list)


def outcome(seed: int, number: int, attempt: int = 0, most: int = 8) -> FaultOutcome:
    """Case `number` of a seed, of 2 to `most` members; what is left out is drawn again as another attempt."""
    rng = np.random.default_rng([seed, number, attempt])
    kinds = tuple(FaultKind)
    kind = kinds[number % len(kinds)]
    coupling = COUPLINGS[number // len(kinds) % len(COUPLINGS)]
    drawn = draw(rng, int(rng.integers(2, most + 1)), str(rng.choice(list(KINDS))), coupling)
    guilty, fault, where = _planted(rng, drawn, kind)
    found = FaultOutcome(number, drawn, guilty, fault, where)
    with TemporaryDirectory() as folder:
        member, log = _run(drawn, Path(folder) / "a.parquet", guilty, fault, where)
        found.left_out = Exclusion.REFUSED if log is None else _left_out(member)
        if log is None or found.left_out:
            return found
        _judge(found, log)
        clean = _run(drawn, Path(folder) / "b.parquet", guilty, None, where)[1]
        found.control = [] if clean is None else [f"{f.subject} {f.name}" for f in _findings(clean) if f.accuses]
    return found


def _findings(log: Path) -> list[Finding]:
    return findings(blame(log))


def _run(
    drawn: RandomNetwork, log: Path, guilty: str, fault: PlantedFault | None, where: FaultPlace
) -> tuple[FaultyMember, Path | None]:
    """A run with an audit log, which may end early; the member with the fault, and the log if there is a step in it."""
    from phfmu.audit import AuditWriter
    from phfmu.network.couplings.choice.coupling_choice import named_coupling
    from phfmu.network.couplings.coupled import Coupled
    from phfmu.outcome.status import StepFailure
    from phfmu.runs.loop import run
    from phfmu.runs.options import Options

    stand = members(drawn)
    for name, inner in stand.items():
        if name == guilty:
            stand[name] = FaultyMember(inner, fault, where)
        elif name not in drawn.booked:
            stand[name] = FaultyMember(inner, None, FaultPlace.UNBOOKED)
    coupling = named_coupling(drawn.coupling, drawn.network, unconverged=drawn.unconverged)
    stepper: Any = Coupled(drawn.network, [*stand.values()], coupling.make)
    with AuditWriter(log) as sink:
        with suppress(StepFailure):
            run(stepper, Options(stop=drawn.step * STEPS, step=drawn.step, sink=sink))
    return stand[guilty], log if sink.rows else None


def _planted(rng: np.random.Generator, drawn: RandomNetwork, kind: FaultKind) -> tuple[str, PlantedFault, FaultPlace]:
    """The guilty member, its fault and where that is."""
    names = list(drawn.dampers if kind is FaultKind.DAMPER else drawn.network.members)
    guilty = str(rng.choice(names))
    where = (
        FaultPlace.UNBOOKED
        if guilty not in drawn.booked
        else FaultPlace(rng.choice([FaultPlace.MEMBER, FaultPlace.CONNECTION]))
    )
    if kind is FaultKind.DAMPER:
        size = -float(rng.uniform(0.5, 5.0))
        where = FaultPlace.MEMBER if where is FaultPlace.CONNECTION else where
        return guilty, PlantedFault(kind, size=size, parameter=drawn.dampers[guilty]), where
    ends = {str(e) for j in drawn.network.junctions for e in j.ends}
    joined = [i for i, port in enumerate(drawn.ports(guilty)) if port in ends]
    pair, given = int(rng.choice(joined)), bool(rng.random() < 0.5)
    lost, size = frozenset[int](), 1.0
    if kind is FaultKind.GAIN:
        size = float(rng.choice([rng.uniform(0.1, 0.8), rng.uniform(1.25, 4.0)]))
    elif kind is FaultKind.UNIT:
        size = float(rng.choice(UNITS))
    elif kind is FaultKind.SIGN:
        size = -1.0
    elif kind is FaultKind.DELAY:
        size = float(rng.integers(1, 6))
    elif kind is FaultKind.QUANTISED:
        size, given = float(rng.uniform(0.05, 0.5)), False
    else:
        given, share = True, rng.uniform(0.05, 0.5)
        lost = frozenset(np.flatnonzero(rng.random(STEPS) < share).tolist())
    return guilty, PlantedFault(kind, pair, given, size, lost), where


def _left_out(member: FaultyMember) -> str:
    """Why the fault of the member cannot be told, after its run; "" if it can."""
    if member.fault and member.made <= ACTED * member.gross:
        return Exclusion.IDLE
    if member.where is not FaultPlace.UNBOOKED:
        return ""
    W = np.array(member.W)
    first, least = W[: len(W) // 2 + 1].min(), W.min()
    if least >= -member.had * (1.0 + ACTED):
        return Exclusion.PASSIVE
    if least >= -KNOWN * member.gross:
        return Exclusion.SMALL
    return Exclusion.ENDS if first - least < -GOES_ON * least else ""


def _judge(found: FaultOutcome, log: Path) -> None:
    """Judge whether the member or junction that is named first is the guilty one."""
    told = _findings(log)
    right = {("member", found.guilty)}
    if found.where is FaultPlace.CONNECTION:
        port = found.drawn.ports(found.guilty)[found.fault.pair]
        right |= {("junction", j.name) for j in found.drawn.network.junctions if any(str(e) == port for e in j.ends)}
    found.hit = bool(told) and (told[0].subject, told[0].name) in right
    found.innocent = not found.hit and bool(told) and (told[0].accuses or told[0].subject == "junction")
    found.told = [f.text for f in told]
