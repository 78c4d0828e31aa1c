"""The bench of sweeps: what it takes is what it says."""

from __future__ import annotations

import pytest

from phfmu.studies.bench import sweeps
from phfmu.studies.bench.sweeps import AT_ENDS, FEW, MANY, SweepCase, measure, table


@pytest.mark.slow
@pytest.mark.parametrize(("measures", "values"), [(FEW, 1), (MANY, 48), (AT_ENDS, 1)])
def test_costs(monkeypatch: pytest.MonkeyPatch, measures: tuple[str, ...], values: int) -> None:
    """Steps, values (MANY: four measures of vectors of twelve entries), bits, and times that are some."""
    monkeypatch.setattr(sweeps, "TURNS", 1)
    c = measure(SweepCase(40, 0.05, measures), jobs=2)
    assert (c.steps, c.values, c.jobs, c.same) == (5, values, 2, True)
    assert c.alone > 0 and c.size >= 8 * (values + 3) and c.share == c.alone / (2 * c.every)


@pytest.mark.slow
def test_table(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(sweeps, "TURNS", 1)
    lines = table([SweepCase(8, 0.02, FEW), SweepCase(16, 0.01, FEW)]).splitlines()
    rows = [[c.strip() for c in line.strip("|").split("|")] for line in lines[2:4]]
    assert [r[:3] for r in rows] == [["8", "2", "1"], ["16", "1", "1"]] and all(r[-1] == "yes" for r in rows)
