"""Where R lost its sign: named when a run ends with a negative dissipation that no check before it could see."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from phfmu import PHDAE, Monolithic, Options, PythonInstance, build_model, check, damping, energy, run, state, time
from phfmu.checks.matrices import sign_lost
from phfmu.cli import main

MODEL = '''
from phfmu import PHDAE, Network, damping, energy, parameter, skew, state
from phfmu.components.mechanical.translational import mass, spring

def softens():
    """R = d (4 - q^2) is negative beyond q = 2 m, far from the start."""
    q, v = state("q", unit="m", start=0.1), state("v", unit="m/s", start=10.0)
    m, k, d = parameter("m", 2.0, unit="kg"), parameter("k", 5.0, unit="N/m"), parameter("d", 0.4, unit="N.s/m3")
    return PHDAE("softens", states=(q, v), parameters=(m, k, d), energies=(energy(m * v**2 / 2), energy(k * q**2 / 2)),
                 E={v: m}, structure=(skew(q, v, 1.0),), dissipation=(damping(v, d * (4 - q**2)),))

def pair():
    net = Network("pair")
    net.add("calm", mass(1.0)), net.add("wild", softens())
    return net
'''


def model(name: str = "softens"):
    scope: dict = {}
    exec(MODEL, scope)
    return scope[name]()


def test_the_block_its_rows_and_the_eigenvalue_at_a_state():
    declaration = model()
    assert check(declaration) == [] and sign_lost(declaration, {"q": 1.9}) == []
    (found,) = sign_lost(declaration, {"q": 3.0, "d": 0.5, "nothing": 1.0})
    assert found.eigenvalue == pytest.approx(0.5 * (4 - 9)) and found.rows == ("v",) and found.along == "v"
    assert found.entry == "R block on v" and dict(found.values) == {"q": 3.0, "d": 0.5}


def test_it_may_depend_on_time_and_costates():
    x = state("x", start=1.0)
    m = PHDAE("m", states=(x,), energies=(energy(2 * x**2),), dissipation=(damping(x, x.z - time),))
    assert sign_lost(m, {"x": 1.0}, 3.9) == []
    (found,) = sign_lost(m, {"x": 1.0}, 4.5)  # z = 4
    assert found.eigenvalue == pytest.approx(-0.5) and found.values == {"z of x": 4.0, "time": 4.5}


def test_a_run_keeps_the_state_of_its_least_dissipation():
    built = build_model(model())
    result = run(Monolithic(built, PythonInstance(built)), Options(stop=0.35, step=0.01))
    t, signals = result.least["softens"]
    i = int(np.argmin(np.abs(result.time - t)))
    assert signals == dict(zip(result.names, result.values[i], strict=True))
    q, v = result.column("q"), result.column("v")
    power = 0.4 * (4 - q**2) * v**2
    assert abs(int(np.argmin(power)) - i) <= 1 and power[i] < 0


def test_the_message_of_a_run(tmp_path: Path, capsys, monkeypatch):
    monkeypatch.chdir(tmp_path)
    Path("m.py").write_text(MODEL)
    for target, name in (("m.py:softens", "softens"), ("m.py:pair", "wild")):
        assert main(["run", target, "--stop", "1", "--step", "0.01", "--engine", "python", "--quiet"]) == 4
        lines = [line for line in capsys.readouterr().err.splitlines() if "not positive semidefinite" in line]
        (line,) = lines
        where = "v" if name == "softens" else "wild.v"
        assert (
            line.startswith(f"phfmu: {name}: R is not positive semidefinite at t = ") and f"R block on {where}" in line
        )
    assert main(["run", "m.py:softens", "--stop", "0.1", "--step", "0.01", "--engine", "python", "--quiet"]) == 0
    assert capsys.readouterr().err == ""
