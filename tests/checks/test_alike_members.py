"""Values of members that are alike are checked as settings of one of them."""

from __future__ import annotations

from typing import Any

import pytest

from phfmu.checks import run_values
from phfmu.checks.run_values import check_values, sound_members
from phfmu.components.mechanical.translational import damper, mass
from phfmu.studies.bench.apart.coupling import star


def test_each_kind_is_looked_at_once(monkeypatch: pytest.MonkeyPatch) -> None:
    made: list[str] = []
    entries = run_values.Entries

    def counted(model: Any) -> Any:
        made.append(model.name)
        return entries(model)

    monkeypatch.setattr(run_values, "Entries", counted)
    net = star(6)
    assert sound_members(net.declared.values())
    assert len(made) < len(net.declared) / 2


@pytest.mark.parametrize("at", [0, 2, 4])
def test_what_is_wrong_with_one_of_them_is_found(at: int) -> None:
    for make, sound, wrong in ((mass, 1.0, -1.0), (damper, 2.0, -0.1)):
        members = [make(wrong if i == at else sound + i) for i in range(5)]
        assert check_values(members[at]) and not sound_members(members)
        del members[at]
        assert sound_members(members)


def test_a_start_is_that_of_each() -> None:
    members = [mass(1.0, k=2.0, q=0.1), mass(1.0, k=2.0, q=float("inf"))]
    assert not sound_members(members) and sound_members(members[:1])
