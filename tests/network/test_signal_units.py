"""Units of measurement of signals: those that an FMU does not tell are unknown, which is told once; others have to fit."""

from __future__ import annotations

from pathlib import Path

import pytest

from phfmu import PHDAE, Network, signal_input, state
from phfmu.cli import main
from phfmu.network.junction import ConnectionError
from phfmu.network.wires import without_unit
from tests.fmu import foreign

IN = '<ScalarVariable name="u" valueReference="1" causality="input"><Real start="0"{unit}/></ScalarVariable>'
OUT = '<ScalarVariable name="y" valueReference="2" causality="output"><Real{unit}/></ScalarVariable>'
DEFINED = """<UnitDefinitions><Unit name="rad/s"><BaseUnit rad="1" s="-1"/></Unit><Unit name="knot"><BaseUnit m="1" s="-1"
factor="0.514444"/></Unit><Unit name="1"><BaseUnit/></Unit></UnitDefinitions>"""


def passing(path: Path, unit_in: str = "", unit_out: str = "") -> Path:
    """A unit with y = 2 u + t; "" tells no unit of measurement."""
    units = (f' unit="{u}"' if u else "" for u in (unit_in, unit_out))
    variables = "".join(text.format(unit=u) for text, u in zip((IN, OUT), units, strict=True))
    return foreign.unit(path, "2.0", variables, before=DEFINED)


def pair(tmp_path: Path, out: str, into: str) -> Network:
    net = Network("pair")
    net.add("a", passing(tmp_path / "a.fmu", unit_out=out))
    net.add("b", passing(tmp_path / "b.fmu", unit_in=into))
    net.signal("a.y", "b.u")
    return net


@pytest.mark.parametrize(("out", "into"), [("", "rad/s"), ("rad/s", ""), ("", ""), ("knot", "knot"), ("rad/s", "1/s")])
def test_a_unit_that_is_not_told_fits_any(tmp_path: Path, out: str, into: str) -> None:
    net = pair(tmp_path, out, into)
    told = without_unit(net.members, net.wires)
    end = {("", "rad/s"): "a.y", ("rad/s", ""): "b.u"}.get((out, into))
    assert told == (f"no unit of measurement is told of {end} (taken for rad/s)" if end else "")


@pytest.mark.parametrize(("out", "into"), [("1", "rad/s"), ("knot", "m/s"), ("rad/s", "N"), ("rad/s", "knot")])
def test_units_that_are_told_have_to_fit(tmp_path: Path, out: str, into: str) -> None:
    with pytest.raises(ConnectionError, match=f"unit mismatch: a.y is in {out}, b.u in {into}"):
        pair(tmp_path, out, into)


def test_beside_declarations(tmp_path: Path) -> None:
    """A declaration tells its units, unless they are 1; two declarations always do."""
    u, x = signal_input("u", unit="rad/s"), state("x", unit="s")
    net = Network("mixed")
    net.add("a", passing(tmp_path / "a.fmu"))
    net.add("b", PHDAE("b", states=(x,), parameters=(u,), energies=(), z={x: u}))
    net.signal("a.y", "b.u")
    assert without_unit(net.members, net.wires) == "no unit of measurement is told of a.y (taken for rad/s)"


def test_it_is_told_once(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    passing(tmp_path / "a.fmu"), passing(tmp_path / "b.fmu", "rad/s")
    scene = tmp_path / "scene.py"
    scene.write_text(
        "from phfmu import Network\ndef scene():\n    net = Network('pair')\n"
        "    net.add('a', 'a.fmu')\n    net.add('b', 'b.fmu')\n    net.signal('a.y', 'b.u')\n    return net\n"
    )
    line = "no unit of measurement is told of a.y (taken for rad/s)"
    assert main(["run", f"{scene}", "--stop", "0.1", "--step", "0.01"]) == 0
    assert capsys.readouterr().out.count(line) == 1
    assert main(["info", f"{scene}"]) == 0
    assert f"note: {line}" in capsys.readouterr().out
