"""Vetting of one unit in a process of its own: claims one after the other, each with a share of the time.

Where the unit ends the process, or a call does not answer, the claim that was tried is judged by that, and the next ones go on
in a new process.
"""

from __future__ import annotations

import os
import sys
import tempfile
from collections import deque
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from pathlib import Path
from time import monotonic
from typing import Any

from phfmu.fmu.export.variables import FMUError
from phfmu.fmu.importer.archive import open_archive
from phfmu.fmu.isolation.child import AnswerTimeout, Child, ProcessEnded
from phfmu.fmu.isolation.unit_process import connected, read, write
from phfmu.fmu.words import plain
from phfmu.vet.claims.claims import CLAIMS
from phfmu.vet.finding import FALSE, Claim, ClaimFinding, false, untested
from phfmu.vet.subject import Subject

#: part of the time left that one claim may take, while more are to come
SHARE = 3
#: s until a process is there;  s that an answer may be late
START, LATE = 120.0, 3.0
#: times as long as its steps a call takes that hangs
HANGS = 100.0
#: lines of output that are quoted
QUOTED = 2


@dataclass(frozen=True)
class VettingResult:
    """A unit with a finding for each claim, in order, and the seconds that it took."""

    unit: str
    findings: tuple[tuple[Claim, ClaimFinding], ...]
    seconds: float

    @property
    def false(self) -> list[str]:
        """Names of claims that are false."""
        return [claim.name for claim, finding in self.findings if finding.verdict == FALSE]

    def as_data(self) -> dict[str, Any]:
        """The data that `--json` writes."""
        told = [{"claim": c.name, "verdict": f.verdict, "seen": f.seen, "done": c.done} for c, f in self.findings]
        return {"unit": self.unit, "claims": told}


def vet(
    path: str | Path,
    seconds: float = 60.0,
    claims: Sequence[Claim] = CLAIMS,
    progress: Callable[[str], None] = lambda _: None,
) -> VettingResult:
    """Try the claims of a unit within so many seconds; `progress` hears the name of each claim as it begins.

    FMUError if the unit cannot be read, or has no library for this machine.
    """
    path = Path(path)
    _ = open_archive(path).library
    begun, found = monotonic(), list[tuple[Claim, ClaimFinding]]()
    with tempfile.TemporaryDirectory(prefix="phfmu-vet-") as folder, _Work(path, Path(folder)) as work:
        for claim in claims:
            left = seconds - (monotonic() - begun)
            progress(claim.name)
            share = left / min(SHARE, len(claims) - len(found))
            found.append((claim, work.tried(claim, share) if left > 0 else untested("there was no time left")))
    return VettingResult(str(path), tuple(found), monotonic() - begun)


class _Work:
    """The process in which claims are tried, started anew after one has ended it."""

    def __init__(self, path: Path, folder: Path):
        self.path, self.folder = path, folder
        self.child: Child | None = None
        self.printed: deque[str] = deque(maxlen=QUOTED)
        #: what was found of the unit and the next process has to know
        self.known: dict[str, float] = {}

    def __enter__(self) -> _Work:
        return self

    def __exit__(self, *_: object) -> None:
        if self.child is not None:
            self.child.kill()

    def tried(self, claim: Claim, share: float) -> ClaimFinding:
        try:
            child = self._running()
            child.tell([claim.name, share, self.known])
            verdict, seen, self.known = child.answer(share + LATE)
            return ClaimFinding(verdict, seen)
        except ProcessEnded as lost:
            self.child = None
            said = f"; it printed: {' | '.join(self.printed)}" if self.printed else ""
            return false(f"{lost}{said}")
        except AnswerTimeout:
            self._end()
            pace = self.known.get("pace", 0.0)
            if pace and share + LATE > HANGS * pace:
                return false(f"a call does not answer: {share + LATE:.3g} s, while its steps take {pace:.2g} s")
            return untested(f"not done in {share + LATE:.3g} s")
        except BaseException:
            self._end()
            raise

    def _running(self) -> Child:
        if self.child is None:
            places = {name: str(self.folder / name) for name in ("work", "temporary")}
            for place in places.values():
                os.makedirs(place, exist_ok=True)
            child = Child("phfmu.vet.process", self._hear, places["work"], {"TMPDIR": places["temporary"]})
            self.child = child
            child.tell(str(self.path.resolve()))
            child.answer(START)
        return self.child

    def _end(self) -> None:
        if self.child is not None:
            self.child.kill()
        self.child = None

    def _hear(self, line: bytes) -> None:
        self.printed.append(plain(line.decode("utf-8", "replace").rstrip(), 200))


def serve() -> None:
    """The other side: claims are tried as they are asked for."""
    asked, told = connected()
    subject = Subject(Path(read(asked)))
    write(told, "ready")
    claims = {claim.name: claim for claim in CLAIMS}
    while (message := read(asked)) is not None:
        name, share, known = message
        subject.deadline = monotonic() + share
        subject.amplitude, subject.pace = known.get("amplitude", 1.0), known.get("pace", 0.0)
        finding = judged(claims[name], subject)
        write(told, [finding.verdict, finding.seen, {"amplitude": subject.amplitude, "pace": subject.pace}])
    sys.stdout.flush()
    os._exit(0)  # libraries are not asked whether they can be unloaded


def judged(claim: Claim, subject: Subject) -> ClaimFinding:
    """The finding of one claim; a unit that refuses what the trial needs leaves it untested."""
    from phfmu.outcome.status import StepFailure

    try:
        return claim.test(subject)
    except (FMUError, StepFailure) as error:
        return untested(str(error))
    except Exception as error:  # of this package: no claim of the unit is judged by it
        return untested(f"internal error: {type(error).__name__}: {error}")
