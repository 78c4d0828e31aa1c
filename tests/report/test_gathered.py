"""Pages of networks with many members: the others are one member, and every balance still closes."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from phfmu.audit import AuditWriter, Booking, Ledger, PortKey
from phfmu.outcome.steps import Steps
from phfmu.report.page.flows import JUNCTION, MEMBER, RESIDUAL, Node, component_energies, links, ports
from phfmu.report.page.gathered import ALL, MOST, gathered_links, gathered_ports, others
from phfmu.report.page.history import read_history
from phfmu.report.page.page import Run, write_report
from tests.report.links import imbalance

N = 101


@pytest.fixture(scope="module")
def star(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A hub that gives k joule to member k through a junction of its own, which loses a quarter of it."""
    path = tmp_path_factory.mktemp("star") / "star.audit.parquet"
    k = np.arange(1.0, N)
    gives = [PortKey("hub", f"p{i}", None, f"j{i}") for i in range(1, N)]
    keys = [*gives, *(PortKey(f"m{i}", "q", None, f"j{i}") for i in range(1, N))]
    change = np.concatenate([[-k.sum()], 0.75 * k])[None]
    steps = Steps(change, change, 0.0 * change, change, np.concatenate([-k, 0.75 * k])[None])
    with AuditWriter(path) as sink:
        Ledger(sink).add(Booking(("hub", *(f"m{i}" for i in range(1, N))), tuple(keys)), [0], [0.0], 1.0, steps)
    return path


def test_the_others_are_one_member_and_all_balances_close(star: Path) -> None:
    history = read_history(star)
    passed, members = ports(history), [b.component for b in component_energies(history)]
    gone = others(members, passed)
    assert set(members) - gone == {"hub", *(f"m{i}" for i in range(N - 1, N - MOST, -1))}
    found = gathered_links(links(history), passed, gone)
    for node in {n for x in found for n in (x.source, x.target) if n.kind in (MEMBER, JUNCTION)}:
        assert imbalance(found, node) == pytest.approx(0.0, abs=1e-9), node
    one = Node(MEMBER, f"{len(gone)} other members")
    got = sum(x.energy for x in found if x.target == one and x.source.kind != RESIDUAL)
    assert got == sum(range(1, N - MOST + 1))
    assert sum(p.energy for p in gathered_ports(passed, gone)) == sum(p.energy for p in passed)


def test_few_members_are_all_drawn(star: Path) -> None:
    history = read_history(star)
    assert others([f"m{i}" for i in range(ALL)], ports(history)) == frozenset()
    assert gathered_links(links(history), ports(history), frozenset()) == links(history)


def test_the_page_of_many_members_is_short_and_says_so(star: Path, tmp_path: Path) -> None:
    pytest.importorskip("plotly")
    write_report(Run("star", str(star)), tmp_path / "x.html")
    text = (tmp_path / "x.html").read_text(encoding="utf-8")
    svg = text[text.index('<svg xmlns="http://www.w3.org/2000/svg" viewBox="0 0') :].partition("</svg>")[0]
    assert svg.count("<rect") <= 2 * MOST + 4 and "89 other members" in svg
    assert "Of 101 members" in text and "<td>m1</td>" not in text and "<td>m100</td>" in text
