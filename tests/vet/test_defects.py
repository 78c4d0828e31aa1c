"""Planted defects are found by the claim that they break, and a unit without one has no claim that is false."""

from __future__ import annotations

import shutil
from pathlib import Path

import pytest

from phfmu.vet.claims.claims import CLAIMS
from phfmu.vet.finding import FALSE, HOLDS
from phfmu.vet.process import judged, vet
from phfmu.vet.subject import Subject
from tests.vet import planted
from tests.wide import slow, turning, wide

pytestmark = pytest.mark.skipif(not shutil.which("cc"), reason="needs a C compiler")

VERSIONS = ("2.0", "3.0")
#: defect -> the claim that it breaks; others may be broken by it too
BREAKS = {
    "FORGETS": "state restored",
    "BYTES": "state as bytes",
    "SHARED": "two instances",
    "PROCESS": "two processes",
    "READ_MOVES": "order of calls",
    "RESET_KEEPS": "reset",
    "DERIVATIVE": "directional derivatives",
    "ADJOINT": "adjoint derivatives",
    "NOT_FINITE": "finite values",
    "GROWS": "finite values",
    "FOLLOWS": "feedthrough",
    "LEAKS": "memory",
    "LEAVES_FILE": "files",
    "LEAVES_HANDLE": "files",
    "NEGATIVE_DAMPER": "passivity",
    "DIVERGES": "step sizes",
    "START": "start values",
    "PARAMETER": "parameters kept",
    "HANGS": "state restored",
    "EARLY": "early return",
    "THREADS": "threads",
    "UNEQUAL": "unequal steps",
    "REFUSES": "steps",
    "CRASHES": "state as bytes",
    "RANDOM": "two instances",
}
#: claims that a defect breaks, where there are more than three
MOST = {"SHARED": 4, "READ_MOVES": 6, "EARLY": 5, "RANDOM": 8}
#: of FMI 3.0 only
NEWER = ("ADJOINT", "EARLY")
#: defects that end or stop the process of the claim
FATAL = ("HANGS", "CRASHES")
BY_NAME = {claim.name: claim for claim in CLAIMS}
CASES = [(v, d) for d in BREAKS for v in VERSIONS if v == "3.0" or d not in NEWER]
QUICK = [("2.0", "FORGETS"), ("3.0", "ADJOINT"), ("2.0", "FOLLOWS")]


def test_every_planted_defect_has_a_claim() -> None:
    assert set(planted.DEFECTS) == set(BREAKS) and len(BREAKS) >= 12


@pytest.mark.parametrize(("version", "defect"), wide([c for c in CASES if c[1] not in FATAL], *QUICK))
def test_a_defect_is_found_by_its_claim(
    version: str, defect: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.chdir(tmp_path)
    found = judged(BY_NAME[BREAKS[defect]], Subject(planted.unit(tmp_path, version, defect)))
    print(found.seen)
    assert found.verdict == FALSE


@pytest.mark.slow
@pytest.mark.parametrize("version", VERSIONS)
def test_a_sound_unit_has_no_false_claim(version: str, tmp_path: Path) -> None:
    found = vet(planted.unit(tmp_path, version), 60.0)
    assert found.false == []
    expected = {c.name for c in CLAIMS} - {"ledger", "outward", "reference results"}
    expected -= {"adjoint derivatives", "early return", "intermediate update"} if version == "2.0" else set()
    assert {c.name for c, f in found.findings if f.verdict == HOLDS} >= expected


@pytest.mark.parametrize(
    ("defect", "version"),
    [*turning([b for b in BREAKS if b not in NEWER], VERSIONS), *(slow((b, "3.0")) for b in BREAKS if b in NEWER)],
)
def test_a_whole_vetting_finds_it_and_blames_no_sound_claim(version: str, defect: str, tmp_path: Path) -> None:
    """Each defect with all claims, in processes of their own; crashes and hangs leave the other claims judged."""
    found = vet(planted.unit(tmp_path, version, defect), 60.0)
    assert BREAKS[defect] in found.false, [(c.name, f.seen) for c, f in found.findings if c.name == BREAKS[defect]]
    assert len(found.false) <= MOST.get(defect, 3), found.false
