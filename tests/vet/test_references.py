"""Reference experiments in units (FMI-LS-REF): written, tried by `phfmu vet`, and found where they are wrong."""

from __future__ import annotations

import json
import shutil
import zipfile
from collections.abc import Mapping
from pathlib import Path

import numpy as np
import pytest
from fmpy.validation import validate_fmu
from scipy.integrate import solve_ivp

from phfmu import Scene
from phfmu.cli import main
from phfmu.components.mechanical.translational import mass
from phfmu.fmu.export.package import write
from phfmu.fmu.xml import etree
from phfmu.references.experiment import Series, read_experiments, read_series, series_text
from phfmu.references.layer import FOLDER, MANIFEST
from phfmu.vet.claims.references import CLAIM
from phfmu.vet.finding import FALSE, HOLDS, UNTESTED, ClaimFinding
from phfmu.vet.process import judged
from phfmu.vet.subject import Subject
from tests.fmu.public_units import public
from tests.vet import planted
from tests.wide import longer, slow

compiled = pytest.mark.skipif(not shutil.which("cc"), reason="needs a C compiler")
VERSIONS = ("2.0", "3.0")


def swinging() -> Scene:
    """A damped mass on a spring, let go."""
    return Scene("swinging", mass(2.0, k=100.0, d=0.5, q=0.1), 1.0, 1e-2)


def changed(unit: Path, files: Mapping[str, bytes | str]) -> Path:
    """The unit with these files in place of its own, or besides."""
    with zipfile.ZipFile(unit) as archive:
        own = {n: archive.read(n) for n in archive.namelist() if not n.endswith("/")}
    new = unit.with_name(f"changed_{unit.name}")
    write(new, own | {n: f.encode() if isinstance(f, str) else f for n, f in files.items()})
    return new


def tried(unit: Path) -> ClaimFinding:
    found = judged(CLAIM, Subject(unit))
    print(found.verdict, found.seen)
    return found


def read(unit: Path, name: str) -> bytes:
    return zipfile.ZipFile(unit).read(f"{FOLDER}/{name}")


@pytest.mark.parametrize(("version", "order"), [("2", "2"), ("3", "6"), slow(("3", "4"))])
def test_an_experiment_is_written_and_holds_and_a_wrong_one_is_found(
    version: str, order: str, compiler: None, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """The results are those of the analytic solution; a wrong value, and a parameter set of another spring, are told."""
    monkeypatch.chdir(tmp_path)
    Path("s.py").write_text("from tests.vet.test_references import swinging\n")
    assert main(["export", "s.py:swinging", "--fmi", version, "--order", order, "--reference-experiment"]) == 0
    (unit,) = tmp_path.glob("*.fmu")
    assert validate_fmu(str(unit)) == []
    told = read_series(read(unit, "results.csv"), "results.csv")
    rate, w = 0.5 / 4.0, np.sqrt(100.0 / 2.0 - (0.5 / 4.0) ** 2)
    exact = 0.1 * np.exp(-rate * told.times) * (np.cos(w * told.times) + rate / w * np.sin(w * told.times))
    # Gauss collocation turns the phase of an oscillator by (w h)^(p + 1) / C too little in a step, C = 12, 720, 100800
    allowed = {"2": 100 * (w * 1e-2) ** 3 / 12, "4": 100 * (w * 1e-2) ** 5 / 720, "6": 100 * (w * 1e-2) ** 7 / 1e5}[
        order
    ]
    assert len(told.times) == 101 and np.abs(told.columns["q"] - exact).max() < 0.1 * allowed
    assert any(np.abs(told.columns[n] - exact).max() > 0.05 for n in told.columns)  # the others are other signals

    found = tried(unit)
    assert found.verdict == HOLDS and "101 times" in found.seen
    lines = read(unit, "results.csv").decode().splitlines()
    wrong = [
        (n if (n := line.split(","))[0] != "0.5" else [n[0], *(repr(float(x) * 1.001) for x in n[1:])])
        for line in lines
    ]
    other = changed(unit, {f"{FOLDER}/results.csv": "\n".join(",".join(n) for n in wrong)})
    found = tried(other)
    assert found.verdict == FALSE and "at t = 0.5 s" in found.seen and "tolerance 1e-06" in found.seen
    wider = read(other, "experiments.exp").replace(b'tolerance="1e-06"', b'tolerance="0.002"')
    assert tried(changed(other, {f"{FOLDER}/experiments.exp": wider})).verdict == HOLDS
    stiffer = read(unit, "parameters.ssv").replace(b'value="100.0"', b'value="101.0"')
    assert stiffer != read(unit, "parameters.ssv")
    assert tried(changed(unit, {f"{FOLDER}/parameters.ssv": stiffer})).verdict == FALSE
    # a parameter set in another unit of measurement is converted: 2000 g are 2 kg
    grams = read(unit, "parameters.ssv").replace(b'value="2.0" unit="kg"', b'value="2000.0" unit="g"')
    grams = grams.replace(
        b'<ssc:Unit name="kg">',
        b'<ssc:Unit name="g"><ssc:BaseUnit kg="1" factor="0.001"/></ssc:Unit>\n<ssc:Unit name="kg">',
    )
    assert grams.count(b'"g"') == 2
    assert tried(changed(unit, {f"{FOLDER}/parameters.ssv": grams})).verdict == HOLDS


@compiled
@pytest.mark.parametrize("version", VERSIONS)
def test_the_form_that_other_tools_write(version: str, tmp_path: Path) -> None:
    """The older draft, with stimuli and a parameter set; the results are those of SciPy, of which a planted defect is found."""
    force = Series(np.array([0.0, 0.3, 0.3, 1.0]), {"F": np.array([0.0, 6.0, 2.0, -1.0])})

    def right(t: float, x: np.ndarray) -> list[float]:
        k = int(t >= 0.3)
        f = np.interp(t, force.times[2 * k : 2 * k + 2], force.columns["F"][2 * k : 2 * k + 2])
        return [x[1], (f - 20.0 * x[0] - 0.5 * x[1])]

    times = np.linspace(0.0, 1.0, 101)
    solved = solve_ivp(right, (0.0, 1.0), [0.0, 0.0], t_eval=times, rtol=1e-10, atol=1e-12, max_step=0.01)
    files = {
        MANIFEST: listed(
            ("application/x-ma-ls-experiments", "experiment", "sub/all.exp"),
            ("application/x-ssp-parameter-set", "parameter", "soft.ssv"),
        ),
        f"{FOLDER}/sub/all.exp": experiment(
            'startTime="0" stopTime="1" stepSize="0.01" tolerance="0.05"',
            '<Parameters source="../soft.ssv"/><Stimuli source="in.csv"/><References source="out.csv"/>',
        ),
        f"{FOLDER}/soft.ssv": PARAMETERS,
        f"{FOLDER}/sub/in.csv": series_text(force),
        f"{FOLDER}/sub/out.csv": series_text(Series(times, {"q": solved.y[0], "v": solved.y[1]})),
    }
    found = tried(changed(planted.unit(tmp_path, version), files))
    assert (
        found.verdict == HOLDS
        and "101 times of 2 variables" in found.seen
        and "has no variable 'nothing'" in found.seen
    )
    away = {n: f for n, f in files.items() if not n.endswith("in.csv")} | {f"{FOLDER}/sub/in.csv": b"time,F\n0,0\n"}
    assert tried(changed(planted.unit(tmp_path, version), away)).verdict == FALSE
    assert tried(changed(planted.unit(tmp_path, version, "PARAMETER"), files)).verdict == FALSE


PARAMETERS = """<?xml version="1.0" encoding="UTF-8"?>
<ssv:ParameterSet xmlns:ssv="http://ssp-standard.org/SSP1/SystemStructureParameterValues" version="1.0" name="soft">
<ssv:Parameters><ssv:Parameter name="k"><ssv:Real value="20"/></ssv:Parameter>
<ssv:Parameter name="nothing"><ssv:Real value="1"/></ssv:Parameter></ssv:Parameters></ssv:ParameterSet>"""


def listed(*files: tuple[str, str, str]) -> str:
    related = "".join(f'<Related type="{t}" role="{r}" source="{s}"/>' for t, r, s in files)
    return f'<fmiReferences xmlns:fmi-ls="http://fmi-standard.org/fmi-ls-manifest">{related}</fmiReferences>'


def experiment(attributes: str, content: str) -> str:
    return f'<Experiments name="all"><Experiment name="one" {attributes}>{content}</Experiment></Experiments>'


EXP = ("application/x-ma-hs-experiments", "experiment/validation", "a.exp")
CSV = ("text/csv", "result", "out.csv")
OUT = b"time,q\n0,0\n0.01,0\n"


@compiled
@pytest.mark.parametrize(
    ("files", "verdict", "words"),
    [
        ({}, UNTESTED, "brings along no files"),
        ({MANIFEST: listed(("text/plain", "document", "a.txt"))}, UNTESTED, "none is an experiment"),
        ({MANIFEST: listed(CSV)}, UNTESTED, "does not hold it"),
        ({MANIFEST: listed(CSV), "out.csv": OUT}, HOLDS, "2 times of 1 variable"),
        ({MANIFEST: listed(CSV), "out.csv": b"time,q\n0,0\n0.01,1\n"}, FALSE, "q = 0, not 1, at t = 0.01 s"),
        ({MANIFEST: listed(CSV), "out.csv": b"time,q\n0.003,0\n"}, UNTESTED, "no time of its results"),
        ({MANIFEST: listed(CSV), "out.csv": b"time,other\n0,0\n"}, FALSE, "none of its columns (other)"),
        ({MANIFEST: listed(CSV), "out.csv": b"time,q\n1,0\n0,0\n"}, FALSE, "no times in rising order"),
        ({MANIFEST: listed(CSV), "out.csv": b"q,time\n1,0\n"}, FALSE, "begins with 'time'"),
        ({MANIFEST: listed(EXP), "a.exp": experiment("", "<SteadyState/>")}, UNTESTED, "no simulation over time"),
        ({MANIFEST: listed(EXP), "a.exp": experiment("", "<TransientSimulation/>")}, UNTESTED, "tells no results"),
        ({MANIFEST: listed(EXP), "a.exp": experiment('tolerance="-1"', "")}, FALSE, "tolerance = '-1'"),
        ({MANIFEST: listed(EXP), "a.exp": "<Nothing/>"}, FALSE, "expected Experiments"),
        (
            {MANIFEST: listed(EXP), "a.exp": experiment("", '<References type="application/hdf5" source="o.h5"/>')},
            UNTESTED,
            "application/hdf5",
        ),
        ({MANIFEST: listed(("text/csv", "result", "../../../../etc/passwd"))}, FALSE, "inside the unit"),
        ({MANIFEST: listed(("text/csv", "result", "file:///etc/passwd"))}, FALSE, "inside the unit"),
        (
            {MANIFEST: listed(("application/x-ssp-parameter-set", "parameter", "p.ssv")), "p.ssv": PARAMETERS},
            HOLDS,
            "1 value taken",
        ),
    ],
)  # fmt: skip
def test_what_is_said_of_files(files: dict[str, bytes | str], verdict: str, words: str, tmp_path: Path) -> None:
    placed = {n if n == MANIFEST else f"{FOLDER}/{n}": f for n, f in files.items()}
    found = tried(changed(planted.unit(tmp_path, "3.0"), placed))
    assert found.verdict == verdict and words in found.seen


@pytest.mark.parametrize("name", ["2.0/Stair", "3.0/StateSpace", "3.0/Feedthrough", "2.0/VanDerPol"])
def test_reference_units_give_their_own_results(name: str) -> None:
    """Arrays, integers and booleans among them; their results come with no experiment and no tolerance."""
    found = tried(public(f"reference_fmus/{name}.fmu"))
    assert found.verdict == HOLDS and "by 0 of its largest value (tolerance 0.002, as none is told)" in found.seen


def test_a_reference_unit_names_results_that_it_does_not_hold() -> None:
    found = tried(public("reference_fmus/3.0/Roberts.fmu"))
    assert found.verdict == UNTESTED and "BouncingBall_out.csv and does not hold it" in found.seen


@pytest.mark.parametrize(
    "scene", longer(["buck", "breaker_opening", "bouncing_ball", "chain"], "buck", "breaker_opening")
)
def test_scenes_with_switches_events_and_constraints(scene: str, compiler: None, tmp_path: Path) -> None:
    """Events inside fall within communication steps, where a run has other steps; the unit gives the results all the same."""
    options = ["--fmi", "3", "--reference-experiment", "--events", "inside"]
    assert main(["export", scene, "-o", str(tmp_path), *options]) == 0
    (unit,) = tmp_path.glob("*.fmu")
    told = tmp_path / "told.json"
    assert main(["vet", str(unit), "--claim", "reference results", "--json", str(told)]) == 0
    found = {c["claim"]: c for c in json.loads(told.read_text())["claims"]}["reference results"]
    assert found["verdict"] == HOLDS


@pytest.mark.parametrize("port", ["a", "b"])
def test_flows_that_count_outward(port: str, compiler: None, tmp_path: Path) -> None:
    """The results of a stretched spring have the signs of the unit."""
    told = []
    for more in ([], ["--outward", port]):
        line = ["export", "spring", "-o", str(tmp_path / str(len(more))), "--fmi", "2", "--set", "e=0.3"]
        assert main([*line, *more, "--reference-experiment"]) == 0
        (unit,) = (tmp_path / str(len(more))).glob("*.fmu")
        assert tried(unit).verdict == HOLDS
        told.append(read_series(read(unit, "results.csv"), "results.csv").columns)
    turned = {n for n in told[0] if not np.array_equal(told[0][n], told[1][n])}
    assert f"{port}.force" in turned and all(np.array_equal(told[0][n], -told[1][n]) for n in turned)


def test_the_same_bytes_twice(compiler: None, tmp_path: Path) -> None:
    for folder in ("a", "b"):
        assert main(["export", "oscillator", "-o", str(tmp_path / folder), "--fmi", "2", "--reference-experiment"]) == 0
    first, second = (tmp_path / f / "oscillator_fmi2.fmu" for f in "ab")
    assert first.read_bytes() == second.read_bytes()
    root = etree.fromstring(zipfile.ZipFile(first).read(MANIFEST))
    assert [e.get("role") for e in root] == ["experiment/smoke-test", "parameter", "result"]
    (one,) = read_experiments(read(first, "experiments.exp"), f"{FOLDER}/experiments.exp")
    assert (one.start, one.stop, one.step, one.tolerance) == (0.0, 1.0, 0.01, 1e-6)
    assert one.results == f"{FOLDER}/results.csv" and one.parameters == f"{FOLDER}/parameters.ssv"


def test_exports_that_have_no_experiment(compiler: None, tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    for more, words in (
        (["drive", "--as-unit"], "leave out --as-unit"),
        (["drive", "--ssp"], "--ssp and --reference-experiment do not go together"),
        (["dc_motor"], "all signals stay 0"),
    ):
        assert main(["export", *more, "-o", str(tmp_path / "x"), "--reference-experiment"]) == 2
        assert words in capsys.readouterr().err
    assert not list(tmp_path.rglob("*.fmu"))


def test_tables_are_read_as_they_were_written() -> None:
    told = Series(np.array([0.0, 0.1, 0.1]), {"a": np.array([1e-300, -np.pi, 3.0]), "b[1]": np.array([1.0, 2.0, 3.0])})
    again = read_series(series_text(told), "t.csv")
    assert again.times.tolist() == told.times.tolist()
    assert {n: c.tolist() for n, c in again.columns.items()} == {n: c.tolist() for n, c in told.columns.items()}
    mixed = read_series(b"time,on,y,word\n0,true,1 2,x\n1,false,3 4,y\n", "t.csv")
    assert {n: c.tolist() for n, c in mixed.columns.items()} == {"on": [1, 0], "y[1]": [1, 3], "y[2]": [2, 4]}
    assert mixed.left_out == ("word",)
