"""`phfmu report`: its energies are those of the audit, its balances close, and it loads nothing."""

from __future__ import annotations

import json
import re
import xml.etree.ElementTree as ET
from pathlib import Path

import numpy as np
import pytest

from phfmu.audit import AuditWriter, Booking, Ledger, PortKey, read, summarise
from phfmu.cli import main
from phfmu.outcome.steps import Steps
from phfmu.report.page.diagram import PAGE, one_line
from phfmu.report.page.flows import (
    CREATED,
    EVENT,
    JUNCTION,
    LOSS,
    MEMBER,
    NUMERICAL,
    PORT,
    RESIDUAL,
    STORE,
    Link,
    Node,
    PortEnergy,
    component_energies,
    links,
    ports,
)
from phfmu.report.page.history import History, read_history
from tests.report.links import imbalance
from tests.report.test_plot import loaded

EPS = float(np.finfo(float).eps)


@pytest.fixture(scope="module")
def place(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A motor that drives a load through a shaft, then brakes; and a mass at rest."""
    pytest.importorskip("matplotlib")
    pytest.importorskip("plotly")
    folder = tmp_path_factory.mktemp("runs")
    (folder / "in.csv").write_text("time,motor.terminal.v\n0,24\n0.03,-24\n")
    words = ["run", "drive", "--engine", "python", "--stop", "0.05", "--step", "1e-3", "--quiet"]
    files = [
        "--input",
        str(folder / "in.csv"),
        "-o",
        str(folder / "drive.csv"),
        "--audit",
        str(folder / "drive.audit.parquet"),
    ]
    assert main([*words, *files]) == 0
    rest = [
        "run",
        "mass",
        "--engine",
        "python",
        "--stop",
        "0.01",
        "--audit",
        str(folder / "rest.audit.parquet"),
        "--quiet",
    ]
    assert main(rest) == 0
    return folder


@pytest.fixture(scope="module")
def made(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A log of round numbers: a source feeds a sink through a junction that loses; an event, numerical loss, a residual."""
    path = tmp_path_factory.mktemp("made") / "made.audit.parquet"
    keys = (PortKey("source", "out", None, "node"), PortKey("sink", "in", 1, "node"), PortKey("sink", "in", 2, "node"),
            PortKey("source", "drive"))  # fmt: skip
    with AuditWriter(path) as sink:
        ledger = Ledger(sink)
        for k in range(2):
            if k == 1:
                ledger.event(1.0, "parameter", "sink", 0.5, "sink.C = 2")
            start = np.array([[4.0, 1.0]]) if k == 0 else np.array([[3.0, 3.5]])
            change = np.array([[-1.0, 2.0]])
            lost, gained = np.array([[0.25, 1.0]]), np.array([[-1.0, 3.25]])
            pairs, damped = np.array([[-4.0, 3.0, 0.25, 3.0]]), np.array([[0.0, 0.125]])
            steps = Steps(start + change, change, lost, gained, pairs, numerical=damped)
            ledger.add(Booking(("source", "sink"), keys), [k], [float(k)], 1.0, steps, H0=start)
    return path


def energy(found: list[Link], source: tuple[str, ...], target: tuple[str, ...]) -> float:
    (only,) = [x.energy for x in found if (x.source, x.target) == (Node(*source), Node(*target))]
    return only


def test_each_kind_of_energy_is_a_link_of_its_own(made: Path) -> None:
    found = links(read_history(made))
    expected = {
        ((PORT, "source.drive"), (MEMBER, "source")): 6.0,
        ((MEMBER, "source"), (JUNCTION, "node")): 8.0,
        ((JUNCTION, "node"), (MEMBER, "sink")): 6.5,
        ((JUNCTION, "node"), (CREATED, "junctions", "to")): 1.5,
        ((STORE, "stored", "from"), (MEMBER, "source")): 2.0,
        ((MEMBER, "source"), (LOSS, "dissipated", "to")): 0.5,
        # stored -2, dissipated 0.5, supplied -2: 0.5 came from nowhere
        ((RESIDUAL, "residual", "from"), (MEMBER, "source")): 0.5,
        ((MEMBER, "sink"), (STORE, "stored", "to")): 4.5,
        ((MEMBER, "sink"), (LOSS, "dissipated", "to")): 2.0,
        ((MEMBER, "sink"), (NUMERICAL, "lost by the scheme", "to")): 0.25,
        ((EVENT, "events", "from"), (MEMBER, "sink")): 0.5,
        ((MEMBER, "sink"), (RESIDUAL, "residual", "to")): 0.25,
    }
    assert {(x.source, x.target): x.energy for x in found} == {
        (Node(*a), Node(*b)): value for (a, b), value in expected.items()
    }
    assert [imbalance(found, Node(MEMBER, n)) for n in ("source", "sink")] == [0.0, 0.0]
    assert imbalance(found, Node(JUNCTION, "node")) == 0.0


def test_energies_are_the_sums_of_the_audit(place: Path) -> None:
    history, summary = read_history(place / "drive.audit.parquet"), summarise(place / "drive.audit.parquet")
    for b, c in zip(component_energies(history), summary.components, strict=True):
        assert (b.component, b.stored, b.dissipated) == (
            c.component,
            pytest.approx(c.stored),
            pytest.approx(c.dissipated),
        )
        assert b.supplied == pytest.approx(c.supplied, rel=1e-13)
    found = links(history)
    for p in summary.ports:
        other = (JUNCTION, p.junction) if p.junction else (PORT, f"{p.component}.{p.port}")
        ends = (other, (MEMBER, p.component)) if p.supplied > 0 else ((MEMBER, p.component), other)
        if p.supplied:
            assert energy(found, *ends) == pytest.approx(abs(p.supplied), rel=1e-14)
    for j in summary.junctions:
        told = sum((x.energy if x.target.name == j.junction else -x.energy) for x in found
                   if CREATED in (x.source.kind, x.target.kind) and j.junction in (x.source.name, x.target.name))  # fmt: skip
        assert told == pytest.approx(j.residual, rel=1e-6, abs=EPS * EPS)


def test_members_and_junctions_balance_to_rounding(place: Path) -> None:
    found = links(read_history(place / "drive.audit.parquet"))
    nodes = {n for x in found for n in (x.source, x.target) if n.kind in (MEMBER, JUNCTION)}
    assert {n.name for n in nodes} == {"motor", "shaft", "load", "coupling_a", "coupling_b"}
    for node in nodes:
        parts = [x.energy for x in found if node in (x.source, x.target)]
        assert abs(imbalance(found, node)) <= len(parts) * EPS * max(parts)


def test_a_window_sums_its_steps_and_no_others(place: Path) -> None:
    rows = read(place / "drive.audit.parquet").to_pylist()
    inside = [r for r in rows if r["row"] == "port" and 0.01 < r["t0"] + r["h"] / 2 < 0.02]
    assert len({r["step"] for r in inside}) == 10
    for p in ports(read_history(place / "drive.audit.parquet").within(0.01, 0.02)):
        own = [r["supplied"] for r in inside if (r["component"], r["port"]) == (p.component, p.port)]
        assert p.energy == pytest.approx(sum(own), rel=1e-13)


def figures(page: str) -> list[list[dict]]:
    """The traces of the plotly figures of a page."""
    return [json.loads(text)["data"] for text in re.findall(r'class="figure">(\{.*?\})</script>', page, re.DOTALL)]


def written(files: list[str], folder: Path, *more: str) -> str:
    assert main(["report", *files, "-o", str(folder / "page.html"), *more]) == 0
    return (folder / "page.html").read_text(encoding="utf-8")


def test_the_page_of_a_run(place: Path, tmp_path: Path) -> None:
    files = [str(place / "drive.audit.parquet"), str(place / "drive.csv")]
    page = written(files, tmp_path, "--signals", "motor.*", "load.w")
    assert loaded(tmp_path / "page.html") == []
    sankey, *others = figures(page)
    assert sankey[0]["type"] == "sankey"
    exact = sorted(x.energy for x in links(read_history(place / "drive.audit.parquet")))
    rounding = [e for e in exact if e < 1e-6 * exact[-1]]
    assert sorted(sankey[0]["link"]["value"]) == exact[len(rounding) :] and max(rounding) < 1e-12
    assert f"Not drawn: {len(rounding)} flows below 1e-06 of the largest" in page
    curves = {name for figure in others for trace in figure for name in trace["name"].split(" = ")}
    assert {"motor.terminal.power", "shaft.residual", "shaft.allowed", "load.w", "motor.i"} <= curves
    assert "<svg" in page and "Ledger closed" in page and "motor.terminal.v = -24" in page
    for fact in ("drive", "3 members, 2 junctions", "50 of 0.001 s", "casadi"):
        assert fact in page


def test_the_page_tells_what_junctions_made_net_and_gross(tmp_path: Path) -> None:
    """Numbers of the audit, in full where the pointer rests on them."""
    log = str(tmp_path / "gs.audit.parquet")
    assert main(["run", "oscillator", "--coupling", "gauss-seidel", "--audit", log, "--quiet"]) == 0
    page = written([log], tmp_path)
    junctions = summarise(log).junctions
    assert len(junctions) == 2
    for j in junctions:
        row = page.index(f"<tr><td>{j.junction}</td>")
        told = re.findall(r'title="(\S+) J"', page[row : page.index("</tr>", row)])
        assert [float(x) for x in told] == [j.residual, j.gross, j.exchanged, j.worst_residual]
        assert j.gross > 100.0 * abs(j.residual) > 0.0


def test_what_a_run_has_not_is_left_out(place: Path, tmp_path: Path) -> None:
    page = written([str(place / "rest.audit.parquet")], tmp_path)
    assert [t["type"] for figure in figures(page) for t in figure].count("sankey") == 0  # no energy went anywhere
    for absent in ("Events", "junction", "Signals", "residual", "numerical", "by events"):
        assert absent not in re.sub(r"<script.*?</script>", "", page, flags=re.DOTALL), absent
    assert "0 J" in page  # its port
    table = written([str(place / "drive.csv")], tmp_path, "--signals", "load.w")
    shown = re.sub(r"<script.*?</script>", "", table, flags=re.DOTALL)
    assert "Ledger" not in shown and "<svg" not in shown and "Signals" in shown


def test_a_component_without_ports_has_no_diagram() -> None:
    assert one_line(["alone"], [], {}) == ""


def test_a_violated_ledger_is_said_on_the_page_and_by_the_exit_code(made, tmp_path, capsys) -> None:
    pytest.importorskip("plotly")
    assert main(["report", str(made), "-o", str(tmp_path / "x.html")]) == 4
    page = (tmp_path / "x.html").read_text(encoding="utf-8")
    assert "Ledger violated" in page and "misses" in page and "lost by the scheme" in page
    assert "ledger violated: made" in capsys.readouterr().err


def test_names_of_a_file_are_text(tmp_path: Path) -> None:
    pytest.importorskip("plotly")
    name = "</script><script>alert(1)</script>"
    with AuditWriter(tmp_path / "x.parquet", {"target": name, "run": name}) as sink:
        ledger = Ledger(sink)
        ledger.event(0.0, "input", None, None, name)
        key = PortKey(name, "p")
        one = np.ones((1, 1))
        ledger.add(Booking((name,), (key,)), [0], [0.0], 1.0, Steps(one, one, 0.0 * one, one, one))
    page = written([str(tmp_path / "x.parquet")], tmp_path)
    assert "<script>alert" not in page and "&lt;script&gt;alert" in page
    assert main(["plot", str(tmp_path / "x.parquet"), "-o", str(tmp_path / "plot.html")]) == 0
    assert "<script>alert" not in (tmp_path / "plot.html").read_text(encoding="utf-8")


SVG = "{http://www.w3.org/2000/svg}"


def drawn(members: list[str], joined: list[PortEnergy]) -> ET.Element:
    return ET.fromstring(one_line(members, joined, {}))


def boxes(svg: ET.Element) -> list[tuple[float, ...]]:
    return [tuple(float(r.get(k) or 0) for k in ("x", "y", "width", "height")) for r in svg.iter(f"{SVG}rect")]


def test_widths_of_the_diagram_are_energies() -> None:
    joined = [
        PortEnergy("a", "p", "n", -8.0),
        PortEnergy("b", "p", "n", 6.0),
        PortEnergy("c", "p", "n", 2.0),
        PortEnergy("a", "in", "", 4.0),
    ]
    svg = drawn(["a", "b", "c"], joined)
    lines = [float(p.get("stroke-width") or 0) for p in svg.iter(f"{SVG}path")]
    (outside,) = [float(p.get("stroke-width") or 0) for p in svg.iter(f"{SVG}line")]
    assert np.array([*lines, outside]) / lines[0] == pytest.approx([1.0, 0.75, 0.25, 0.5], abs=2e-3)
    texts = {t.text for t in svg.iter(f"{SVG}text")}
    assert {"a", "b", "c", "n", "p 8 J", "p 6 J", "p 2 J", "in", "4 J"} <= texts
    turned = [re.search(r"rotate\((\d+)\)", p.get("transform") or "") for p in svg.iter(f"{SVG}polygon")]
    (source,) = [x for x, *_ in boxes(svg)[:1]]
    assert source < min(x for x, *_ in boxes(svg)[1:]) and all(m and m[1] in ("0", "90") for m in turned)


@pytest.mark.parametrize("ring", [False, True])
@pytest.mark.parametrize("n", [2, 5, 8])
def test_no_box_of_the_diagram_covers_another(n: int, ring: bool) -> None:
    """Lines between buses with loads, as a chain and closed to a ring, and a part that stands alone; wide ones go on below."""
    joined, members = [], ["alone"]
    for i in range(n):
        members += [f"gen{i}", f"load{i}", f"line{i}"]
        joined += [
            PortEnergy(f"gen{i}", "t", f"bus{i}", -3.0),
            PortEnergy(f"gen{i}", "shaft", "", 3.0),
            PortEnergy(f"load{i}", "t", f"bus{i}", 2.0),
        ]
        if i < n - 1 or ring:
            joined += [
                PortEnergy(f"line{i}", "a", f"bus{i}", 1.0),
                PortEnergy(f"line{i}", "b", f"bus{(i + 1) % n}", -1.0),
            ]
    svg = drawn(members, joined)
    found = boxes(svg)
    marks = [t.text for t in svg.iter(f"{SVG}text") if t.text in ("goes on below", "from above")]
    twice = marks.count("goes on below")  # bars in two rows
    assert twice == marks.count("from above") and bool(twice) == (n > 2)
    assert len(found) == len(members) + n + twice
    assert len(list(svg.iter(f"{SVG}path"))) == sum(bool(p.junction) for p in joined)
    width, height = float(svg.get("width") or 0), float(svg.get("height") or 0)
    assert width < 1.2 * PAGE  # letters of 11 pixels stay readable
    for i, (x, y, w, h) in enumerate(found):
        assert 0 <= x and 0 <= y and x + w <= width and y + h <= height
        for a, b, c, d in found[:i]:
            assert x >= a + c or a >= x + w or y >= b + d or b >= y + h


def test_several_runs_are_pages_in_a_folder(place: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    files = [str(place / name) for name in ("drive.audit.parquet", "drive.csv", "rest.audit.parquet")]
    assert main(["report", *files, "-o", str(tmp_path / "x.html")]) == 2
    assert "2 runs (drive, rest) need a folder that exists" in capsys.readouterr().err
    assert main(["report", *files, "-o", str(tmp_path)]) == 0
    assert sorted(p.name for p in tmp_path.iterdir()) == ["drive.html", "rest.html"]
    assert "signals only" not in capsys.readouterr().out
    assert main(["report", files[1], "-o", str(tmp_path)]) == 0
    assert f"signals only; with the audit of the run also energies, events, verdict: phfmu report {files[1]} AUDIT" in (
        capsys.readouterr().out
    )


@pytest.mark.parametrize(
    ("words", "said"),
    [
        (["--window", "3:4"], "has no step from 3 s to 4 s; the run is from 0 s to 0.05 s"),
        (["--signals", "x"], "--signals names signals of a result table"),
        (["-o", "x.png"], "the ending must be .html"),
    ],
)
def test_what_cannot_be_reported_is_said_once(words, said, place, tmp_path, monkeypatch, capsys) -> None:
    monkeypatch.chdir(tmp_path)
    assert main(["report", str(place / "drive.audit.parquet"), "-o", "x.html", *words]) == 2
    (line,) = capsys.readouterr().err.splitlines()
    assert said in line and not list(tmp_path.iterdir())


def test_an_empty_history_has_no_links() -> None:
    assert links(History("x", {})) == [] and component_energies(History("x", {})) == []
