"""`phfmu plot` and `run --plot`: what is drawn of a run, and what is said where nothing can be."""

from __future__ import annotations

import base64
import gzip
import re
import struct
from html.parser import HTMLParser
from pathlib import Path

import numpy as np
import pyarrow as pa
import pyarrow.parquet as pq
import pytest

from phfmu.audit import AuditWriter, Booking, Ledger, PortKey, read
from phfmu.cli import main
from phfmu.outcome.steps import Steps
from phfmu.pick import pick
from phfmu.report.live_recording import LiveRecording
from phfmu.report.opening import opened
from phfmu.report.page.history import read_history
from phfmu.report.picture.html import POINTS, fitted, single, write_html
from phfmu.report.picture.picture import COLOURS, panel, picture, with_marks
from phfmu.report.picture.prefix import engineering, scaled
from phfmu.report.picture.thinning import lean, thin
from phfmu.report.recording import Mark, Signal
from phfmu.report.result_table import ResultTable
from phfmu.results.schema import UNIT_KEY

NAMES = ["gen.I[1]", "gen.I[2]", "gen.V_step[1]", "gen.Te", "line.I[1]", "gen.energy.stored", "constraint.velocity.x"]


@pytest.fixture(scope="module")
def folder(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Table and audit of a motor that is switched on, and then over."""
    pytest.importorskip("matplotlib")
    pytest.importorskip("plotly")
    place = tmp_path_factory.mktemp("run")
    (place / "in.csv").write_text("time,terminal.v\n0,24\n0.02,-12\n")
    words = ["run", "dc_motor", "--engine", "python", "--stop", "0.05", "--input", str(place / "in.csv"), "--quiet"]
    assert main([*words, "-o", str(place / "m.csv"), "--audit", str(place / "m.audit.parquet")]) == 0
    return place


def table(path: Path, rows: int = 5, names: list[str] = NAMES) -> Path:
    time = np.arange(rows)
    path.write_text(
        "\n".join(
            [",".join(["time", *names]), *(",".join([f"{t}", *[f"{t + i}" for i in range(len(names))]]) for t in time)]
        )
        + "\n"
    )
    return path


@pytest.mark.parametrize(
    ("pattern", "found"),
    [
        ("gen.*", [n for n in NAMES if n.startswith("gen.")]),
        ("*.I[1]", ["gen.I[1]", "line.I[1]"]),
        ("gen.I", ["gen.I[1]", "gen.I[2]"]),
        ("gen.I[?]", ["gen.I[1]", "gen.I[2]"]),
        ("gen.Te", ["gen.Te"]),
    ],
)
def test_patterns_take_brackets_as_they_are(pattern: str, found: list[str]) -> None:
    assert pick([pattern], NAMES, "x.csv") == found


def test_patterns_give_each_signal_once_in_their_order() -> None:
    assert pick(["gen.Te", "gen.*"], NAMES, "x.csv")[:3] == ["gen.Te", "gen.I[1]", "gen.I[2]"]
    assert len(pick(["gen.Te", "gen.*"], NAMES, "x.csv")) == 5


def test_entries_of_a_variable_share_an_axis_where_units_are_not_known(tmp_path: Path) -> None:
    drawn = picture(ResultTable(table(tmp_path / "x.csv")))
    assert [[c.label for c in p.curves] for p in drawn.panels] == [
        ["gen.I[1]", "gen.I[2]"], ["gen.Te"], ["line.I[1]"], ["gen.energy.stored − 5 J"],
    ]  # fmt: skip
    assert any("2 signals of 7 left out" in note for note in drawn.notes)
    names = [*NAMES, "gen.I_step[1]"]  # now gen.I is that of a port
    drawn = picture(ResultTable(table(tmp_path / "x.csv", names=names)))
    assert [[c.label for c in p.curves] for p in drawn.panels] == [
        ["gen.Te"],
        ["line.I[1]"],
        ["gen.energy.stored − 5 J"],
    ]


def test_signals_of_a_unit_share_an_axis(tmp_path: Path) -> None:
    units = {"a.i": "A", "b.i": "A", "b.v": "V", "w": "rad/s"}
    fields = [
        pa.field("time", pa.float64()),
        *(pa.field(n, pa.float64(), metadata={UNIT_KEY: u}) for n, u in units.items()),
    ]
    values = {"time": [0.0, 1.0], "a.i": [0.0, 2500.0], "b.i": [0.0, 1.0], "b.v": [0.0, 0.02], "w": [0.0, 377.0]}
    pq.write_table(pa.table(values, schema=pa.schema(fields)), tmp_path / "x.parquet")
    drawn = picture(opened(tmp_path / "x.parquet"))
    assert [(p.unit, [c.label for c in p.curves]) for p in drawn.panels] == [
        ("kA", ["a.i", "b.i"]), ("mV", ["b.v"]), ("rad/s", ["w"]),
    ]  # fmt: skip
    assert drawn.panels[0].curves[0].values[-1] == pytest.approx(2.5)


def test_si_prefixes() -> None:
    assert [engineering(x, "W") for x in (444e6, -2.5e3, 0.0, 999.7, 0.999, 999.5)] == [
        "444 MW",
        "-2.5 kW",
        "0 W",
        "1 kW",
        "999 mW",
        "1 kW",
    ]
    assert scaled(20e3, "A") == (1e-3, "kA") and scaled(2e-9, "J")[1] == "nJ"
    assert scaled(377.0, "rad/s") == (1.0, "rad/s") and scaled(1.04e7, None)[1] == "10⁶" and scaled(4e3, "s")[1] == "s"


def test_a_thinned_curve_has_the_same_extremes_in_every_column() -> None:
    n, columns = 100_003, 200
    rng = np.random.default_rng(1)
    time, values = np.arange(n) * 1e-4, rng.standard_normal(n)
    values[12_345], values[50_000:51_500] = 50.0, np.nan
    t, v = thin(time, values, columns)
    assert len(t) <= 4 * columns and (t[0], t[-1]) == (time[0], time[-1])
    edges = np.linspace(time[0], time[-1], columns + 1)
    for a, b in zip(edges[:-1], edges[1:], strict=True):
        inside, left = (time >= a) & (time < b), (t >= a) & (t < b)
        if np.isfinite(values[inside]).any():
            assert np.nanmax(v[left]) == np.nanmax(values[inside]) and np.nanmin(v[left]) == np.nanmin(values[inside])
        else:
            assert np.isnan(v[left]).all()


def test_a_run_of_a_million_rows_says_what_is_not_drawn(tmp_path: Path) -> None:
    n = 1_000_000
    columns = {"time": np.arange(n) * 1e-3, "x": np.sin(np.arange(n) * 1e-3)}
    pq.write_table(pa.table(columns), tmp_path / "x.parquet")
    drawn = picture(ResultTable(tmp_path / "x.parquet"))
    assert len(drawn.panels[0].curves[0].time) <= 6000
    assert any(note.startswith("drawn from 1000000 rows") for note in drawn.notes)


def test_png_has_the_size_asked_for(folder: Path) -> None:
    for words, size in (
        (["--size", "640x480"], (640, 480)),
        (["--size", "1500x900", "--window", ":0.03"], (1500, 900)),
    ):
        assert main(["plot", str(folder / "m.csv"), "w", "i", "-o", str(folder / "x.png"), *words]) == 0
        head = (folder / "x.png").read_bytes()[:24]
        assert head[:8] == b"\x89PNG\r\n\x1a\n" and struct.unpack(">II", head[16:24]) == size


class Page(HTMLParser):
    """What a page would load."""

    def __init__(self) -> None:
        super().__init__()
        self.loaded: list[str] = []
        self.styles, self._style = "", False

    def handle_starttag(self, tag: str, attrs: list[tuple[str, str | None]]) -> None:
        self._style = tag == "style"
        names = {"src", "href", "data", "srcset", "action", "poster", "xlink:href"}
        self.loaded += [f"{tag} {n}={v}" for n, v in attrs if n in names and not (v or "").startswith(("#", "data:"))]

    def handle_data(self, data: str) -> None:
        self.styles += data if self._style else ""


def loaded(path: Path) -> list[str]:
    page = Page()
    page.feed(path.read_text(encoding="utf-8"))
    return page.loaded + [word for word in ("url(", "@import") if word in page.styles]


def test_html_loads_nothing(folder: Path) -> None:
    assert main(["plot", str(folder / "m.audit.parquet"), "-o", str(folder / "x.html")]) == 0
    text = (folder / "x.html").read_text(encoding="utf-8")
    assert loaded(folder / "x.html") == []
    assert text.count('<script type="application/json" class="figure">') == 1
    (packed,) = re.findall(r'<script type="text/plain" id="plotly">([^<]+)</script>', text)
    assert len(gzip.decompress(base64.b64decode(packed))) > 1_000_000  # the library is within the page
    assert "dc_motor.shaft.power" in text and "terminal.v = -12" in text


def test_what_loads_something_is_seen(tmp_path: Path) -> None:
    (tmp_path / "x.html").write_text('<script src="https://cdn.plot.ly/plotly.js"></script><style>@import "x"</style>')
    assert len(loaded(tmp_path / "x.html")) == 2


def test_signals_of_an_audit_are_those_of_its_rows(folder: Path) -> None:
    rows = [r for r in read(folder / "m.audit.parquet").to_pylist() if r["row"] in ("component", "port")]
    found = {s.name: s for s in opened(folder / "m.audit.parquet").read(opened(folder / "m.audit.parquet").names)}
    shaft = [r["supplied"] / r["h"] for r in rows if r.get("port") == "terminal"]
    assert np.array_equal(found["dc_motor.terminal.power"].values, shaft)
    body = [r for r in rows if r["row"] == "component"]
    for r in body:
        r["ports"] = sum(abs(p["supplied"]) for p in rows if p["row"] == "port" and p["step"] == r["step"])
    stored = next(s for name, s in found.items() if name.startswith("dc_motor.H"))
    assert np.allclose(stored.values[1:], [r["H1"] - body[0]["H0"] for r in body], rtol=1e-15, atol=0.0)
    assert np.array_equal(found["dc_motor.dissipated_power"].values, [r["dissipated"] / r["h"] for r in body])
    limits = found["dc_motor.allowed"]
    assert limits.limit and limits.values == pytest.approx(allowed(body), rel=1e-9)
    assert [m.text for m in opened(folder / "m.audit.parquet").marks()][-1] == "terminal.v = -12"


def allowed(rows: list[dict]) -> list[float]:
    """What the ledger page says of a component's steps: 1e-11 of what is in play, and roundings of it and of H."""
    reach, stored, found = 0.0, 0.0, []
    for r in rows:
        in_play = max(r["moved"], abs(r["dH"])) + abs(r["supplied"]) + abs(r["dissipated"]) + r["ports"]
        stored += r["dH"]
        reach = max(reach, in_play, abs(stored))
        eps = float(np.finfo(float).eps)
        found.append(1e-11 * in_play + 1024 * eps * reach + 64 * eps * max(abs(r["H0"]), abs(r["H1"])))
    return [x for x, r in zip(found, rows, strict=True) if r["residual"] != 0.0]


def test_power_of_a_vector_port_is_that_of_all_its_pairs(tmp_path: Path) -> None:
    keys = tuple(PortKey("box", "p", i, None) for i in (1, 2, 3))
    with AuditWriter(tmp_path / "a.parquet") as sink:
        ledger = Ledger(sink)
        energy = np.array([[1.0, 2.0, 4.0], [8.0, 16.0, 32.0]])
        total = energy.sum(axis=1, keepdims=True)
        steps = Steps(np.cumsum(total, axis=0), total, 0.0 * total, total, energy, iterations=np.array([2, 3]))
        ledger.add(Booking(("box",), keys), [0, 1], [0.0, 0.5], 0.5, steps)
    found = opened(tmp_path / "a.parquet").read(["box.p.power"])[0]
    assert found.values.tolist() == [14.0, 112.0] and found.time.tolist() == [0.25, 0.75]
    assert "step_size" not in opened(tmp_path / "a.parquet").names
    assert opened(tmp_path / "a.parquet").read(["iterations"])[0].values.tolist() == [2.0, 3.0]


def test_events_of_a_log_are_marked_also_in_a_table(folder: Path) -> None:
    from phfmu.report.audit_signals import marks

    found = marks(read_history(folder / "m.audit.parquet"))
    drawn = with_marks(picture(opened(folder / "m.csv")), found, (0.01, 0.05))
    assert [m.time for m in drawn.marks] == [0.02]


def test_a_picture_while_running_is_that_of_its_table(folder: Path) -> None:
    from_file = ResultTable(folder / "m.csv")
    names = from_file.names
    values = np.stack([s.values for s in from_file.read(names)], axis=1)
    time = from_file.read(names)[0].time
    read = from_file.read(names)
    told = ({s.name: getattr(s, what) or "" for s in read} for what in ("unit", "kind", "label"))
    rows = LiveRecording("m", names, (), *told)
    for part in np.array_split(np.arange(len(time)), 3):
        rows.add(time[part], values[part])
    for a, b in zip(picture(rows).panels, picture(from_file).panels, strict=True):
        assert a.title == b.title
        assert all(np.array_equal(c.values, d.values) for c, d in zip(a.curves, b.curves, strict=True))


def test_run_draws(folder: Path, capsys: pytest.CaptureFixture[str]) -> None:
    target = folder / "drawn.png"
    words = ["run", "dc_motor", "--engine", "python", "--stop", "0.01", "--set", "terminal.v=24"]
    assert main([*words, "--plot", str(target)]) == 0
    assert f"picture: {target}" in capsys.readouterr().out and target.stat().st_size > 5000


def test_a_scene_names_the_signals_of_its_picture(
    tmp_path: Path, capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.chdir(tmp_path)
    (tmp_path / "m.py").write_text(
        "from phfmu import Scene\nfrom phfmu.components.mechanical.translational import mass\n"
        "def m(): return Scene('m', mass(2.0, k=50.0, q=1.0), stop=0.1, step=0.01, shown=('q', 'speed'))\n"
    )
    words = ["run", "m.py:m", "--audit", "none", "--plot", "m.html"]
    assert main(words) == 0
    said = capsys.readouterr().out
    assert "signals that the scene names for its picture" in said
    assert "the run has no signal speed, which the scene names" in said
    assert '"name":"q"' in (tmp_path / "m.html").read_text() and '"name":"v"' not in (tmp_path / "m.html").read_text()
    assert main([*words, "--signals", "v"]) == 0
    assert "the scene" not in capsys.readouterr().out and '"name":"q"' not in (tmp_path / "m.html").read_text()


def torn(path: Path) -> Path:
    path.write_bytes(table(path, 50).read_bytes()[:-4])
    return path


def cut(source: Path, path: Path) -> Path:
    path.write_bytes(source.read_bytes()[:-100])
    return path


@pytest.mark.parametrize(
    ("make", "words", "said"),
    [
        (lambda p, _: table(p / "x.csv"), ["gen.Ti"], "x.csv has no signal 'gen.Ti'; did you mean gen.Te"),
        (lambda p, _: p / "none.csv", [], "no file"),
        (lambda p, _: (p / "x.csv").touch() or p / "x.csv", [], "x.csv is empty"),
        (lambda p, _: table(p / "x.csv", 0), [], "x.csv has no rows below its header"),
        (lambda p, _: torn(p / "x.csv"), [], "x.csv was cut off: its last line has no end"),
        (
            lambda p, f: cut(f / "m.audit.parquet", p / "x.parquet"),
            [],
            "x.parquet was cut off or is not a Parquet file",
        ),
        (lambda p, _: (p / "x.csv").write_text("time,a\n0,1\n1,b\n") and p / "x.csv", [], "invalid value 'b'"),
        (lambda p, _: (p / "x.csv").write_text("time,a\n0,1\n1\n") and p / "x.csv", [], "Expected 2 columns, got 1"),
        (lambda p, _: (p / "x.csv").write_text("t,a\n0,1\n") and p / "x.csv", [], "first column must be 'time'"),
        (lambda p, _: (p / "x.csv").write_text("time,a\n1,1\n0,1\n") and p / "x.csv", [], "times must not fall"),
        (lambda p, _: table(p / "x.csv"), ["--window", "7:9"], "no row from 7 s to 9 s"),
        (lambda p, _: table(p / "x.csv"), ["--window", "2:1"], "--window 2:1: expected A:B"),
        (lambda p, _: table(p / "x.csv"), ["--size", "big"], "--size big: expected WIDTHxHEIGHT"),
    ],
)
def test_what_cannot_be_drawn_is_said_once(make, words, said, folder, tmp_path, capsys) -> None:
    path = make(tmp_path, folder)
    assert main(["plot", str(path), *words, "-o", str(tmp_path / "x.png")]) == 2
    lines = capsys.readouterr().err.splitlines()
    assert len(lines) == 1 and said in lines[0]
    assert not (tmp_path / "x.png").exists()


@pytest.mark.parametrize(("ending", "package"), [("png", "matplotlib"), ("html", "plotly")])
def test_a_missing_package_is_said_before_the_work(ending, package, tmp_path, monkeypatch, capsys) -> None:
    monkeypatch.setattr("phfmu.report.picture.extra.find_spec", lambda name: None)
    for words in (["plot", str(table(tmp_path / "x.csv")), "-o"], ["run", "dc_motor", "--plot"]):
        assert main([*words, str(tmp_path / f"x.{ending}")]) == 2
        (line,) = capsys.readouterr().err.splitlines()
        assert package in line and 'pip install "phfmu[report]"' in line


def test_curves_are_told_apart_without_colour() -> None:
    """More curves than colours get dashes."""
    time = np.arange(3.0)
    curves = panel("x", [Signal(f"x[{i}]", None, time, time) for i in range(len(COLOURS) + 1)]).curves
    assert len({(c.colour, c.dash) for c in curves}) == len(curves)
    assert (curves[-1].colour, curves[-1].dash) == (0, 1)
    (zero, *_) = panel("r", [Signal("a", "J", time, time, "r", log=True)]).curves[0].values
    assert np.isnan(zero)  # a zero has no place on a log axis


def test_a_component_has_its_colour_on_all_axes_and_so_has_its_limit(tmp_path: Path) -> None:
    keys = (PortKey("a", "p", None, "n"), PortKey("a", "q", None, "n"), PortKey("b", "p", None, "n"))
    with AuditWriter(tmp_path / "a.parquet") as sink:
        change, gained = np.array([[1e-9, 1.0]] * 2), np.array([[0.0, 1.0 + 1e-9]] * 2)
        steps = Steps(np.array([[1.0, 2.0]] * 2), change, 0.0 * change, gained, np.array([[1.0, -1.0, 1.0]] * 2))
        Ledger(sink).add(Booking(("a", "b"), keys), [0, 1], [0.0, 1.0], 1.0, steps)
    found = opened(tmp_path / "a.parquet")
    by_owner: dict[str, set[int]] = {}
    for p in picture(found, pick(["b.*", "a.*", "n.*"], found.names, "a")).panels:
        assert len({(c.colour, c.dash) for c in p.curves if not c.limit}) == sum(not c.limit for c in p.curves)
        for c in p.curves:
            by_owner.setdefault(c.label.partition(".")[0], set()).add(c.colour)
    assert by_owner == {"a": {0}, "b": {1}, "n": {2}}


def test_marks_of_the_same_time_are_one(tmp_path: Path) -> None:
    from phfmu.report.audit_signals import marks
    from phfmu.report.page.history import History

    when = {"t0": np.array([1.0]), "h": np.array([np.nan]), "step": np.array([np.nan])}
    history = History("x", {}, events={("input", "", "u = 1"): when, ("input", "", "v = 2"): when})
    assert marks(history) == [Mark(1.0, "u = 1, v = 2")]


def test_a_page_of_many_fast_signals_has_three_megabytes_at_most(tmp_path: Path) -> None:
    """The library is packed, points on a line are left out, and what is left shares a number of points."""
    t = np.linspace(0.0, 10.0, 50_000)
    fast = {f"x{i}.v": 1e3 * np.sin(2 * np.pi * 50.0 * t + i) for i in range(90)}
    slow = {f"w{i}.v": 377.0 + np.exp(-t) * np.sin(6.0 * t + i) for i in range(6)}
    columns = {**fast, **slow}
    units = {n: f"unit{i // 6}" for i, n in enumerate(columns)}
    rows = LiveRecording("many", list(columns), (), units)
    rows.add(t, np.column_stack(list(columns.values())))
    drawn = picture(rows)
    assert sum(len(p.curves) for p in drawn.panels) == 96
    write_html(drawn, tmp_path / "many.html")
    assert (tmp_path / "many.html").stat().st_size < 3e6
    few, note = fitted(drawn.panels)
    assert sum(len(c.time) for p in few for c in (*p.curves, *p.near)) <= POINTS and "fast curves" in note
    for c, lean_one in zip(drawn.panels[-1].curves, few[-1].curves, strict=True):
        assert len(lean_one.time) < 700 < len(c.time)
        off = np.abs(np.interp(c.time, lean_one.time, lean_one.values) - c.values).max()
        assert off < 0.005 * 2.0  # of an axis from 376 to 378
    for c, thin_one in zip(drawn.panels[0].curves, few[0].curves, strict=True):
        assert thin_one.values.max() == c.values.max() and thin_one.values.min() == c.values.min()


def test_lines_keep_their_corners_gaps_and_jumps() -> None:
    t = np.array([0.0, 1.0, 2.0, 3.0, 4.0, 4.0, 5.0, 6.0, 7.0, 8.0, 9.0])
    v = np.array([0.0, 1.0, 2.0, 3.0, 4.0, 9.0, 9.0, 9.0, np.nan, 9.0, 9.0])
    time, values = lean(t, v, 10.0)
    assert time.tolist() == [0.0, 4.0, 4.0, 6.0, 7.0, 8.0, 9.0] and values[:3].tolist() == [0.0, 4.0, 9.0]


@pytest.mark.parametrize(
    ("values", "kind"),
    [([0.0, 1.0], np.float32), ([377.0, 377.001], np.float64), ([5.0, 5.0], np.float64), ([0.0, 1e300], np.float64),
     ([1e-300, 1.0], np.float64), ([np.nan, np.nan], np.float64)],
)  # fmt: skip
def test_single_precision_where_it_shows_all_digits(values: list[float], kind: type) -> None:
    assert single(np.array(values)).dtype == kind


def test_names_may_stand_after_options(folder: Path) -> None:
    words = ["plot", str(folder / "m.csv"), "-o", str(folder / "after.png"), "w", "--window", "0:1", "terminal.i"]
    assert main(words) == 0
    assert main([*words, "terminal.j"]) == 2
