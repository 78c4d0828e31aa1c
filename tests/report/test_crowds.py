"""Events in pictures: state events of a run, crowds of them, tables of many; log axes; flows that are rounding."""

from __future__ import annotations

import re
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from phfmu.cli import main
from phfmu.report.audit_signals import marks
from phfmu.report.live_recording import LiveRecording
from phfmu.report.page.flows import Link, Node
from phfmu.report.page.history import read_history
from phfmu.report.page.page import _events
from phfmu.report.page.sankey import seen
from phfmu.report.picture.labels import parted
from phfmu.report.picture.picture import DECADES, panel, picture
from phfmu.report.recording import Mark, Signal


def test_events_that_stand_close_are_a_crowd_and_no_event_is_lost() -> None:
    bounces = [Mark(4.0 - 0.8**k * 4.0, "floor") for k in range(80)] + [Mark(4.0, "floor, flight = 0")]
    alone, (crowd,) = parted(bounces[::-1], 0.0, 5.0)
    assert sorted([*alone, *crowd.marks], key=lambda m: m.time) == bounces
    gaps = np.diff([m.time for m in crowd.marks])
    assert gaps.max() <= 5.0 / 60 < alone[-1].time - alone[-2].time
    assert crowd.mark.text == f"{len(crowd.marks)} events until 4 s" and crowd.mark.time == crowd.marks[0].time
    assert len(crowd.ticks) < len(crowd.marks)  # the last ones are at one place
    assert set(crowd.ticks) <= {m.time for m in crowd.marks}


def test_few_events_at_a_time_are_no_crowd() -> None:
    few = [Mark(1.0 + 1e-3 * k, "x") for k in range(5)]
    assert parted(few, 0.0, 10.0) == (few, []) and parted(few, 1.0, 1.0) == (few, [])
    assert parted([], 0.0, 1.0) == ([], [])
    _, (crowd,) = parted([Mark(0.001 * k, "x") for k in range(6)], 0.0, 1.0)
    assert crowd.mark.text == "6 × x until 0.005 s"


def test_a_run_marks_its_state_events_as_its_audit_does(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    made: list[LiveRecording] = []
    start = LiveRecording.__init__

    def kept(self: LiveRecording, *args: Any, **named: Any) -> None:
        start(self, *args, **named)
        made.append(self)

    pytest.importorskip("matplotlib")
    monkeypatch.setattr(LiveRecording, "__init__", kept)
    audit = tmp_path / "ball.audit.parquet"
    words = ["run", "bouncing_ball", "--stop", "1.3", "--quiet", "--audit", str(audit)]
    assert main([*words, "--plot", str(tmp_path / "ball.png")]) == 0
    drawn = picture(made[0]).marks
    assert [(m.time, m.text) for m in drawn] == [(m.time, m.text) for m in marks(read_history(audit))]
    impact = np.sqrt(2.0 / 9.81)  # from 1 m; then 0.8 of the speed
    assert [m.time for m in drawn] == pytest.approx([impact, impact * 2.6], rel=1e-9) and drawn[0].text == "floor"


def test_a_log_axis_has_no_more_than_its_decades() -> None:
    time = np.arange(4.0)
    signal = Signal("r", "J", time, np.array([1e-16, 0.0, 1e-40, 1e-9]), topic="r", log=True)
    drawn = panel("r", [signal])
    assert drawn.reach == (1e-9 * 10.0**-DECADES, 1e-9)
    near = panel("r", [Signal("r", "J", time, np.array([1e-3, 1e-4, 0.0, 1e-5]), topic="r", log=True)])
    assert near.reach == (1e-5, 1e-3)
    assert panel("r", [Signal("r", "J", time, np.zeros(4), topic="r", log=True)]).reach is None


def test_flows_of_rounding_are_not_drawn_and_said() -> None:
    a, b = Node("member", "a"), Node("store", "stored", "to")
    large, small = Link(a, b, 2.0), Link(a, Node("residual", "residual", "to"), 3e-16)
    assert seen([large, small], 1e-11) == ([large], "Not drawn: 1 flow below 1e-06 of the largest, the largest 0.3 fJ.")
    assert seen([large], 1e-11) == ([large], "")
    assert seen([small], 1e-11)[0] == [] and seen([small], 0.0)[0] == [small]


def test_many_events_are_counted_and_folded() -> None:
    few = "".join(_events([Mark(float(k), "on") for k in range(20)]))
    assert few.count("<tr>") == 20 and "details" not in few
    many = "".join(_events([Mark(float(k), "on" if k % 3 else "off") for k in range(90)]))
    rows = re.findall(r"<tr><td>(\w+)</td><td class=\"n\">(\d+)</td><td class=\"n\">(.*?) s</td>", many)
    assert rows == [("on", "60", "1"), ("off", "30", "0")] and "the first 60 of 90" in many
