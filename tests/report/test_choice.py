"""What a picture shows that nobody chose: few signals, slow and fast ones apart, texts that can be read."""

from __future__ import annotations

import itertools
from collections.abc import Sequence

import numpy as np
import pytest

from phfmu.cli import main
from phfmu.report.energies import POWER, STORED
from phfmu.report.live_recording import LiveRecording
from phfmu.report.picture.choice import MOST
from phfmu.report.picture.labels import LETTER, entry, labels, shortened
from phfmu.report.picture.picture import Picture, picture
from phfmu.report.picture.thinning import BEFORE, PERIODS, swings
from phfmu.report.recording import Mark

TIME = np.arange(0.0, 5.0, 1e-3)


def drawn(columns: dict[str, np.ndarray], units: dict[str, str], marks: Sequence[Mark] = ()) -> Picture:
    rows = LiveRecording("a scene", list(columns), marks, units)
    rows.add(TIME, np.column_stack(list(columns.values())))
    return picture(rows)


def shown(found: Picture) -> list[list[str]]:
    return [[c.label for c in p.curves] for p in found.panels]


def test_states_come_before_ports_before_algebraic_variables_and_at_most_six() -> None:
    ramp = {f"x[{i}]": TIME * i for i in range(1, 5)}
    ends = {"n.v": TIME**2, "n.v_end": TIME**2}
    ports = {"p.v": TIME**3, "p.v_step": TIME**3}
    six = {f"y[{i}]": TIME + i + 0.5 for i in range(9)}
    columns = {**ports, **ends, **ramp}
    assert shown(drawn(columns, dict.fromkeys(columns, "V"))) == [["p.v", "n.v", *ramp]]
    columns = {**ports, **ends, **ramp, **six}
    (panel,) = shown(found := drawn(columns, dict.fromkeys(columns, "V")))
    assert panel == ["x[1]", "x[2]", "x[3]", "y[0]", "y[1]", "y[2]"] and len(panel) == MOST
    assert "11 signals of 17 left out" in found.notes[0] and "phfmu plot FILE p.v" in found.notes[0]


def test_no_curve_twice() -> None:
    """Equal signals are one curve with all names, states first; of the mirror images one is enough."""
    columns = {"p.i": -TIME, "p.i_step": TIME, "q.i": TIME, "q.i_step": TIME, "x": TIME, "z": TIME, "near": TIME + 1e-3}
    assert shown(drawn(columns, dict.fromkeys(columns, "A"))) == [["x = z = q.i", "near"]]
    named = LiveRecording("a scene", list(columns), (), dict.fromkeys(columns, "A"))
    named.add(TIME, np.column_stack(list(columns.values())))
    assert shown(picture(named, ["q.i", "x", "near"])) == [["x = q.i", "near"]]
    many = {f"x[{i}]": np.sin(TIME) for i in range(9)}
    assert shown(drawn(many, dict.fromkeys(many, "A"))) == [["x[0] = x[1] = x[2] = x[3] and 5 more"]]


def test_curves_that_differ_far_from_zero_stay_two() -> None:
    """Speeds of machines differ by a ten-thousandth of themselves, which fills the axis."""
    columns = {"a": 377.0 + 1e-3 * np.sin(TIME), "b": 377.0 + 1e-3 * np.cos(TIME), "c": np.full_like(TIME, 377.0)}
    assert shown(drawn(columns, dict.fromkeys(columns, "rad/s"))) == [["a", "b", "c"]]


def test_legends_of_equal_signals_break_between_names() -> None:
    assert entry("gen.I[fd]") == ["gen.I[fd]"]
    found = entry("gen.I[a] = gen.terminal.i[a] = line.b.i[a] = grid.source.i[a]")
    assert found == ["gen.I[a] = gen.terminal.i[a]", "= line.b.i[a] = grid.source.i[a]"]


def test_powers_and_stored_energies_end_every_picture_that_nobody_chose() -> None:
    """Powers are differences of energies over time; an event has none; what is zero, or the other end of a bond, is not drawn."""
    energy = np.where(TIME > 2.0, 3.0 * TIME + 1.0, 3.0 * TIME)
    columns = {
        "x": np.sin(TIME), "a.p.energy": 3.0 * TIME**2, "b.p.energy": -3.0 * TIME**2, "a.q.energy": 5.0 * TIME,
        "c.p.energy": 0.0 * TIME, "energy.stored": energy + 1.0, "a.energy.stored": energy + 7.0, "b.energy.stored": 0.0 * TIME,
    }  # fmt: skip
    found = drawn(columns, {"x": "m"} | {n: "J" for n in columns if n != "x"})
    assert shown(found) == [["x"], ["a.p.power", "a.q.power"], ["a.energy.stored − 7 J"]]
    power, stored = found.panels[1:]
    assert (power.title, power.unit, stored.title, stored.unit) == (POWER, "W", STORED, "J")
    for curve, exact in zip(power.curves, (lambda t: 6.0 * t, lambda t: 5.0 + 0.0 * t), strict=True):
        assert np.allclose(curve.values, exact(curve.time), rtol=1e-9)
    assert np.isclose(stored.curves[0].values[-1], energy[-1])
    rows = LiveRecording("a scene", ["x", "p.energy"])
    rows.add(np.array([0.0, 1.0, 1.0, 2.0]), np.array([[0.0, 0.0], [1.0, 2.0], [1.0, 9.0], [0.0, 12.0]]))
    assert picture(rows).panels[-1].curves[0].values.tolist() == [2.0, 3.0]
    assert shown(picture(rows, ["x"])) == [["x"]]


def test_signals_named_are_all_drawn() -> None:
    rows = LiveRecording("a scene", [f"x[{i}]" for i in range(9)])
    rows.add(TIME, TIME[:, None] * np.arange(1.0, 10.0))
    assert len(shown(picture(rows, rows.names))[0]) == 9


def test_fast_signals_have_an_axis_with_a_band_and_a_few_periods() -> None:
    """A band is what the signal reaches; the periods are those about the event."""
    hertz, size = 50.0, 1.0 + 0.5 * (TIME > 2.0)
    wave = size * np.sin(2 * np.pi * hertz * TIME)
    columns = {"i": wave, "slow": np.sin(TIME), "noise": 1e-12 * np.cos(900 * TIME)}
    found = drawn(columns, dict.fromkeys(columns, "A"), [Mark(2.0, "fault")])
    assert shown(found) == [["slow", "noise"], ["i"]]
    assert not found.panels[0].near
    (curve,) = found.panels[1].curves
    assert curve.band is not None
    time, low, high = curve.band
    for sign, edge in ((-1.0, low), (1.0, high)):
        assert edge[time < 1.9] == pytest.approx(sign, abs=0.01) and edge[time > 2.1] == pytest.approx(
            1.5 * sign, abs=0.02
        )
    near = found.panels[1].near[0].time
    assert near[-1] - near[0] == pytest.approx(PERIODS / hertz, rel=0.25)
    assert 2.0 - near[0] == pytest.approx(BEFORE / hertz, rel=0.25)
    assert any(note.startswith("bands:") for note in found.notes)


@pytest.mark.parametrize(("periods", "fast"), [(20, False), (60, False), (150, True), (400, True)])
def test_fast_is_told_by_periods_also_beside_a_spike(periods: int, fast: bool) -> None:
    phase = np.linspace(0.0, 2 * np.pi * periods, 20001)
    wave = np.sin(phase)
    wave[300:310] = 12.0
    assert (swings(wave) > 0.0) is fast and swings(wave[:300]) == 0.0


def test_texts_of_events_do_not_overlap() -> None:
    width = 400.0
    found = labels([Mark(t, f"some.event = {t:.4g}") for t in (0.0, 1.0, 1.1, 1.2, 4.5, 4.9, 5.0)], 0.0, 5.0, width)
    boxes = []
    for label in found:
        at, size = label.time / 5.0 * width, len(label.text) * LETTER
        boxes.append((label.row, *((at - size, at) if label.right else (at, at + size))))
    assert all(low >= 0.0 and high <= width for _, low, high in boxes)
    assert not any(a[0] == b[0] and a[1] < b[2] and b[1] < a[2] for a, b in itertools.combinations(boxes, 2))
    many = [Mark(float(t), "x") for t in range(13)]
    assert [(label.time, label.text) for label in labels(many, 0.0, 13.0, width)] == [(0.0, "13 × x")]
    assert labels([Mark(float(t), f"x{t}") for t in range(13)], 0.0, 13.0, width) == []


def test_long_texts_of_events_are_cut_where_a_part_ends() -> None:
    assert shortened("bridge.d5.closes, bridge.conducts[5] = 1; bridge.d5 on") == "bridge.d5.closes …"
    assert shortened("x" * 50) == "x" * 39 + "…" and shortened("x" * 40) == "x" * 40


def test_an_audit_says_what_it_holds_and_where_signals_are(tmp_path, capsys) -> None:
    words = ["run", "mass", "--engine", "python", "--stop", "0.01", "--quiet", "--audit", str(tmp_path / "a.parquet")]
    assert main(words) == 0
    assert main(["plot", str(tmp_path / "a.parquet"), "velocity", "-o", str(tmp_path / "x.png")]) == 2
    (line,) = capsys.readouterr().err.splitlines()
    assert "no signal 'velocity'" in line and "an audit holds '*.power'" in line and "-o RUN.csv" in line
