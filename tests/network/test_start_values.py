"""The first row of a coupled run is the instant of the start, as in the composed run: `phfmu compare` finds no difference."""

from __future__ import annotations

from pathlib import Path

import pytest

from phfmu import Network, Options, PythonInstance, build_model, run
from phfmu.cli import main
from phfmu.components.mechanical.translational import mass
from phfmu.network.couplings.coupled import Coupled
from phfmu.network.members.engine_member import EngineMember
from tests.wide import slow

CASES = [
    ("smib", "--order 4 --step 1e-3", "--engine native"),
    *(slow(("smib", "--order 4 --step 1e-3", f"--engine {engine}")) for engine in ("python", "fmu")),
    slow(("smib", "--step 1e-3", "")),
    slow(("two_machine", "--order 4", "")),
    ("drive", "", ""),
    ("drive", "", "--engine fmu"),
    ("oscillator", "", "--coupling anderson"),
    ("oscillator", "", "--coupling jacobi"),
    ("speed_control", "", ""),
]


def first_row(path: Path) -> str:
    """The file with its first row only."""
    path.write_text("\n".join(path.read_text().splitlines()[:2]) + "\n")
    return str(path)


@pytest.mark.parametrize(("scene", "options", "coupling"), CASES)
def test_the_first_row_is_that_of_the_composed_run(
    scene: str, options: str, coupling: str, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    paths = [tmp_path / "composed.csv", tmp_path / "coupled.csv"]
    for path, more in zip(
        paths, ("", coupling if "--coupling" in coupling else f"{coupling} --coupling newton"), strict=True
    ):
        words = f"run {scene} {options} {more} --stop 2e-3 --audit none -o".split()
        assert main([*words, str(path)]) == 0
    said = capsys.readouterr()
    assert main(["compare", "--atol", "1e-12", *map(first_row, paths)]) == 0, capsys.readouterr().out + said.err


def test_the_force_of_a_rigid_joint_is_that_of_the_instant() -> None:
    """Two masses joined rigidly, one on a spring: only accelerations tell the force, (k2/m2 q2 - k1/m1 q1)/(1/m1 + 1/m2)."""
    net = Network("joined")
    net.add("a", mass(1.0, k=10.0, q=0.3))
    net.add("b", mass(2.0, k=50.0, q=0.1))
    net.junction("joint", ["a.flange", "b.flange"], kind="1")
    models = {n: build_model(d) for n, d in net.declared.items()}
    coupled = Coupled(net, [EngineMember(n, m, PythonInstance(m)) for n, m in models.items()])
    result = run(coupled, Options(stop=0.02, step=0.01))
    force = (50.0 * 0.1 / 2.0 - 10.0 * 0.3 / 1.0) / (1 / 1.0 + 1 / 2.0)
    for name, sign in {"a.flange.force": 1.0, "b.flange.force": -1.0}.items():
        assert sign * result.column(name)[0] == pytest.approx(-force, rel=1e-9)
        assert abs(sign * result.column(name)[1] + force) > 1e-6 * abs(force), "a step later it is another"
