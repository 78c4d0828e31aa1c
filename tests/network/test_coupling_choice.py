"""Which coupling a run takes when nobody says, and the sentence that says why."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from phfmu.cli import main
from tests.fmu import foreign
from tests.wide import wide

SIDECAR = '[flange]\neffort = "F"\nflow = "v"\nsign = 1\n'
SCENE = """
from phfmu import Network, Scene
from phfmu.components.mechanical.translational import mass, spring


def mixed():
    net = Network("mixed")
    net.add("pump", "pump.fmu")
    net.add("cart", mass(2.0, q=0.3))
    net.add("spring", spring(40.0, elongation=0.3))
    net.junction("a", ["pump.flange", "spring.a"])
    net.junction("b", ["cart.flange", "spring.b"])
    return Scene("mixed", net, stop=1.0, step=0.01)
"""


def mixed(folder: Path, version: str, saves: bool) -> Path:
    (folder / "pump.ports.toml").write_text(SIDECAR)
    foreign.mass(folder / "pump.fmu", version, saves=saves)
    path = folder / "mixed.py"
    path.write_text(SCENE)
    return path


@pytest.mark.parametrize("version", wide(["2.0", "3.0"], "3.0"))
def test_a_unit_that_cannot_go_back_is_stepped_last(
    version: str, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    """Without a word from the user; on request once, with the others; the motion is that of repeated steps, up to the order."""
    table = tmp_path / "rows.csv"
    ends = []
    for saves, more, words, loose in (
        (True, (), "coupling newton: pump cannot be composed", False),
        (False, (), "coupling newton: units cannot be composed; pump is stepped last", True),
        (False, ("--coupling", "gauss-seidel"), "gauss-seidel coupling (pump, the composed member)", True),
        (
            False,
            ("--coupling", "gauss-seidel", "--sequence", "pump,cart,spring"),
            "coupling (pump, cart, spring)",
            True,
        ),
    ):
        path = mixed(tmp_path, version, saves)
        assert main(["run", str(path), "-o", str(table), *more]) == 0
        out = capsys.readouterr().out
        assert words in out and ("loose" in out) is loose
        ends.append(np.genfromtxt(table, delimiter=",", names=True, deletechars="")["cart.q"])
    assert 1e-6 < abs(ends[2] - ends[0]).max() < 0.02


def test_declared_members_are_one_model_and_that_is_said_on_request(capsys: pytest.CaptureFixture[str]) -> None:
    short = ("run", "oscillator", "--engine", "python", "--stop", "0.02")
    assert main([*short]) == 0
    assert "coupling" not in capsys.readouterr().out
    assert main([*short, "--coupling", "auto"]) == 0
    assert "coupling monolithic: all members are declared" in capsys.readouterr().out
