"""`phfmu vet` on units of other projects and of this package: no claim that is true is called false; JSON, page, exit codes."""

from __future__ import annotations

import json
import subprocess
import sys
from pathlib import Path

import pytest

from phfmu.cli import main
from phfmu.vet.claims.claims import CLAIMS, chosen
from phfmu.vet.finding import FALSE, HOLDS
from phfmu.vet.process import vet
from tests.fmu.public_units import public
from tests.vet import planted

REFERENCE = [
    f"reference_fmus/{v}/{name}.fmu"
    for v, names in (
        ("2.0", "BouncingBall Dahlquist Feedthrough Resource Stair VanDerPol"),
        ("3.0", "BouncingBall Dahlquist Feedthrough Resource Roberts Stair StateSpace VanDerPol"),
    )
    for name in names.split()
]
#: events, switches, machines, constraints, signals, members apart, a stop and a restart
SCENES = ["bouncing_ball", "breaker_opening", "buck", "four_particle", "hard_stop", "smib", "two_point_control"]
OPTIONS = {"drive": ["--node-inputs", "--order", "4"], "dc_motor": ["--arrays"], "oscillator": ["--tunable"]}
#: chassis and wheel of the quarter truck: what is not as they say
TRUE_OF_THE_TRUCK = {"start values", "parameters kept", "state restored", "state as bytes", "reset"}


@pytest.mark.slow
@pytest.mark.parametrize("name", REFERENCE)
def test_reference_units_have_no_false_claim(name: str) -> None:
    found = vet(public(name))
    assert found.false == [] and found.seconds < 60.0
    assert sum(f.verdict == HOLDS for _, f in found.findings) >= 13


@pytest.mark.slow
@pytest.mark.parametrize("scene", [*SCENES, "drive", "dc_motor"])
def test_units_of_this_package_have_no_false_claim(scene: str, compiler: None, tmp_path: Path) -> None:
    options = ["--fmi", "3", *OPTIONS[scene]] if scene in OPTIONS else []
    assert main(["export", scene, "-o", str(tmp_path), *options]) == 0
    units = sorted(tmp_path.glob("*.fmu"))
    assert units
    for unit in units:
        found = vet(unit)
        assert found.false == [], [(c.name, f.seen) for c, f in found.findings if f.verdict == FALSE]
        assert sum(f.verdict == HOLDS for _, f in found.findings) >= 18


@pytest.mark.slow
@pytest.mark.parametrize("name", ["Chassis", "Wheel"])
def test_the_quarter_truck_is_seen_as_it_is(name: str) -> None:
    """Each finding was confirmed by hand; the wheel has steps of its own length inside, which its state does not hold."""
    found = vet(public(f"quarter_truck/{name}.fmu"))
    assert {"start values", "reset"} <= set(found.false) <= TRUE_OF_THE_TRUCK


SLAVE = """
from pythonfmu import Fmi2Causality, Fmi2Slave, Fmi2Variability, Real


class Spring(Fmi2Slave):
    def __init__(self, **kwargs):
        super().__init__(**kwargs)
        self.k, self.v, self.q, self.F, self.hidden = 40.0, 0.0, 0.3, 0.0, 0.0
        self.register_variable(Real("v", causality=Fmi2Causality.input))
        self.register_variable(Real("k", causality=Fmi2Causality.parameter, variability=Fmi2Variability.fixed))
        self.register_variable(Real("q", causality=Fmi2Causality.output))
        self.register_variable(Real("F", causality=Fmi2Causality.output))

    def do_step(self, current_time, step_size):
        self.q += step_size * self.v
        self.hidden += HIDDEN * step_size
        self.F = self.k * self.q + self.hidden
        return True
"""


@pytest.mark.slow
@pytest.mark.parametrize("hidden", [0, 1])
def test_units_by_pythonfmu(hidden: int, tmp_path: Path) -> None:
    """Its empty InitialUnknowns are against the standard; a value that is not registered is not in its saved states."""
    pytest.importorskip("pythonfmu", reason="pythonfmu is not installed")
    (tmp_path / "spring.py").write_text(SLAVE.replace("HIDDEN", str(hidden)))
    command = [sys.executable, "-m", "pythonfmu", "build", "-f", "spring.py", "--handle-state"]
    subprocess.run(command, cwd=tmp_path, check=True, capture_output=True)
    found = vet(tmp_path / "Spring.fmu")
    seen = {c.name: f.seen for c, f in found.findings if f.verdict == FALSE}
    assert "InitialUnknowns" in seen.pop("description")
    assert set(seen) == ({"state restored"} if hidden else set())


def test_exit_codes_data_and_page(compiler: None, tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    """One false claim is exit code 1; of two units the data are a list; the page has a row for each claim."""
    bad = planted.unit(tmp_path, "2.0", "START")
    told, page = tmp_path / "out.json", tmp_path / "out.html"
    options = ["--claim", "start values", "--json", str(told), "--html", str(page)]
    assert main(["vet", str(bad), *options]) == 1
    data = json.loads(told.read_text())
    assert data["unit"] == str(bad)
    assert [(c["claim"], c["verdict"]) for c in data["claims"]] == [("steps", "holds"), ("start values", "false")]
    assert "m = 2, not 1" in data["claims"][1]["seen"] and "m = 2, not 1" in capsys.readouterr().out
    assert page.read_text().count("<tr ") == 2
    assert main(["vet", str(bad), str(bad), "--claim", "steps", "--json", str(told)]) == 0
    assert [u["unit"] for u in json.loads(told.read_text())] == [str(bad)] * 2


def test_bad_input(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    assert main(["vet", str(tmp_path / "no.fmu")]) == 2
    assert "there is no such file" in capsys.readouterr().err
    assert main(["vet", "x.fmu", "--claim", "state restord"]) == 2
    assert "did you mean state restored?" in capsys.readouterr().err
    assert main(["vet", "x.fmu", "--seconds", "0"]) == 2
    assert main(["vet", "x.fmu", "--json", str(tmp_path / "no" / "out.json")]) == 2
    assert "there is no folder" in capsys.readouterr().err


def test_claims_have_names_of_their_own() -> None:
    assert len({c.name for c in CLAIMS}) == len(CLAIMS)
    assert [c.name for c in chosen(["reset"])] == ["steps", "reset"]
