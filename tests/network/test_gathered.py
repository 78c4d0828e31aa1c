"""Declared members beside a unit are one composed member: the same columns, ledger rows and values as all members apart."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from contextlib import ExitStack
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from phfmu import (
    Collocated,
    Coupled,
    EngineMember,
    Event,
    FMUInstance,
    NativeInstance,
    Network,
    Options,
    build_model,
    export,
    run,
)
from phfmu.cli import main
from phfmu.components.mechanical.translational import mass, spring
from phfmu.components.scenes.electrical.ladder import ladder
from phfmu.components.scenes.mechanical.oscillator import oscillator
from phfmu.components.scenes.mechanical.speed_control import speed_control
from phfmu.engine.switched import stepped
from phfmu.network.couplings.choice.gathered import composed_members, gathered
from phfmu.network.couplings.gauss_seidel import GaussSeidel
from phfmu.network.couplings.jacobi import Jacobi
from phfmu.network.couplings.newton import newton
from phfmu.network.members.fmu_member import FMUMember
from tests.fmu import foreign
from tests.network.test_coupled_units import row_of_nodes
from tests.wide import slow, wide

PORT = {"flange": {"effort": "F", "flow": "v", "sign": 1}}


def with_unit(net: Network, name: str, folder: Path, k: int, h: float, impulses: bool = False) -> Network:
    """`net` with its member `name` exported to a unit for order 2k."""
    d = net.separate()[name]
    model = build_model(d, Collocated(k))
    (path,) = export(model, folder, ("2.0",), step=h, node_inputs=k > 1, impulses=impulses)
    from phfmu.fmu.importer.unit_file import unit_file

    return replace(net, members={n: unit_file(path) if n == name else m for n, m in net.members.items()})


def coupled(net: Network, k: int, stack: ExitStack, coupling: Any = newton) -> Coupled:
    """Native members of order 2k, and units."""
    members: list[Any] = []
    declared = net.separate()
    for name in net.members:
        if name in net.units:
            file = net.units[name]
            unit = FMUInstance(file.path, file.port_maps, starts=file.starts, start=0.0, name=name)
            members.append(FMUMember(name, stack.enter_context(unit)))
            continue
        model = build_model(declared[name], Collocated(k))
        members.append(EngineMember(name, model, stepped(model, NativeInstance)))
    return Coupled(net, members, coupling)


def both(net: Network, k: int, options: Options, apart: tuple[str, ...] = (), coupling: Any = newton) -> list[Any]:
    with ExitStack() as stack:
        return [run(coupled(n, k, stack, coupling), options) for n in (net, gathered(net, apart))]


def require_same(apart: Any, one: Any, kinds: Mapping[str, str] | None = None, tolerance: float = 1e-9) -> None:
    """`kinds`: of columns; those of the end of a step are not compared then, which members apart take from polynomials."""
    assert one.names == apart.names
    assert one.units == apart.units
    units = dict(zip(apart.names, apart.units, strict=True))
    energy = max(abs(apart.column(n)).max() for n in apart.names if n.endswith("energy.stored"))
    for name in apart.names:
        if kinds is not None and kinds.get(name) not in ("state", "mean", "algebraic", "energy"):
            continue
        a, b = apart.column(name), one.column(name)
        alike = [n for n in apart.names if units[n] == units[name] and ".energy" not in n]
        size = energy if "energy." in name else max(np.abs(apart.column(n)).max() for n in alike)
        assert np.abs(a - b).max() <= tolerance * size, name
    books = [r.ledger.summary() for r in (apart, one)]
    assert books[1].closed == books[0].closed
    for rows in ("components", "junctions", "ports"):
        names = [sorted(_key(row) for row in getattr(book, rows)) for book in books]
        assert names[1] == names[0], rows


def _key(row: Any) -> str:
    return "/".join(str(getattr(row, n)) for n in ("component", "port", "junction", "name") if hasattr(row, n))


def chain(unit: Any = None, n: int = 6) -> Network:
    """Masses and springs in a row; the one in the middle may be a unit, and one more spring holds no other member."""
    net = Network("chain")
    for i in range(n):
        if unit and i == n // 2:
            net.add(f"m{i}", unit, ports=PORT)
        else:
            net.add(f"m{i}", mass(1.0 + i / n, k=0.5, d=0.01, v=0.1 * i + 0.1))
        if i:
            net.add(f"s{i}", spring(100.0 + i))
    for i in range(n):
        ends = [f"m{i}.flange", *([f"s{i}.b"] if i else []), *([f"s{i + 1}.a"] if i < n - 1 else [])]
        net.junction(f"j{i}", ends)
    return net


@pytest.mark.parametrize("coupling", [newton, GaussSeidel, Jacobi])
def test_beside_a_foreign_unit(tmp_path: Path, coupling: Callable[..., Any]) -> None:
    net = chain(foreign.mass(tmp_path / "mass.fmu", "2.0"))
    kind = coupling if coupling is newton else lambda _: coupling()
    apart, one = both(net, 1, Options(stop=0.2, step=0.01), coupling=kind)
    assert one.names == apart.names
    if coupling is newton:
        require_same(apart, one)
        return
    # explicit couplings hold what is exchanged: composed members do not, so that less energy is made
    made = [sum(abs(j.residual) for j in r.ledger.summary().junctions) for r in (apart, one)]
    assert 0 < made[1] < 0.7 * made[0]


#: scenes, members that are units in turn, steps, ends
CASES = {
    "ladder": (lambda: ladder().system, ("gen1", "load2"), 1e-3, 0.02),
    "oscillator": (lambda: oscillator().system, ("mass1", "mass2"), 0.01, 0.1),
    "speed_control": (lambda: speed_control().system, ("rotor", "controller", "actuator"), 1e-3, 0.05),
}


@pytest.mark.parametrize(
    ("name", "k"), wide([(n, k) for n in CASES for k in (1, 2, 3)], ("speed_control", 2), ("oscillator", 2))
)
def test_beside_a_unit_of_this_package(name: str, k: int, tmp_path: Path) -> None:
    make, units, h, stop = CASES[name]
    for one in units:
        net = with_unit(make(), one, tmp_path / one, k, h)
        assert len(composed_members(gathered(net))) > 1
        with ExitStack() as stack:
            kinds = coupled(net, k, stack).kinds
        assert {"state", "mean", "energy"} <= set(kinds.values())
        require_same(*both(net, k, Options(stop=stop, step=h)), kinds if name == "ladder" else None)


@pytest.mark.parametrize("k", [slow(1), 2, slow(3)])
def test_members_that_exchange_impulses_stay_apart(k: int, tmp_path: Path) -> None:
    """Inductors meet at bare nodes: a composed member could not take the impulses that keep the sum of the outer currents."""
    net = with_unit(row_of_nodes(), "far", tmp_path, k, 1e-4, impulses=True)
    assert gathered(net) is net
    plain = with_unit(row_of_nodes(), "far", tmp_path / "plain", 1, 1e-4)
    assert composed_members(gathered(plain)) == ["gen", "near"]
    one = both(plain, 1, Options(stop=1e-3, step=1e-4))[1]
    inside = one.column("gen.terminal.i[1]") + one.column("near.a.i[1]")
    assert np.abs(inside).max() <= 1e-9 * np.abs(one.column("gen.terminal.i[1]")).max()
    assert one.ledger.summary().closed


def test_those_asked_for_apart_stay_apart(tmp_path: Path) -> None:
    net = chain(foreign.mass(tmp_path / "mass.fmu", "2.0"))
    found = gathered(net, ("s1",))
    assert set(composed_members(found)) == {"m2", "s3", "s4", "m4", "s5", "m5"} | {"s2"}
    assert [j.name for j in found.junctions] == ["j0", "j1", "j3"]
    require_same(*both(net, 1, Options(stop=0.1, step=0.01), apart=("s1",)))
    declared = chain()
    assert gathered(declared) is declared


def test_set_and_told_by_their_own_names(tmp_path: Path) -> None:
    """Events set parameters and free inputs of composed members by the names that these have apart."""
    net = chain(foreign.mass(tmp_path / "mass.fmu", "2.0"))
    net.add("free", mass(1.0))
    net.add("rope", spring(3.0))
    net.junction("end", ["free.flange", "rope.a"])
    events = (Event(0.03, "s1.k", 300.0), Event(0.05, "m4.k", 7.0), Event(0.07, "rope.b.velocity", 0.2))
    require_same(*both(net, 1, Options(stop=0.1, step=0.01, events=events)))
    with ExitStack() as stack, pytest.raises(KeyError, match=r"no parameter or input 's1.kk'.*s1\.k"):
        coupled(gathered(net), 1, stack).set_value("s1.kk", 1.0)


def test_command_line(tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]) -> None:
    monkeypatch.chdir(tmp_path)
    foreign.mass(tmp_path / "mass.fmu", "2.0")
    Path("row.py").write_text(ROW)
    assert main(["run", "row.py", "--stop", "0.1", "--step", "0.01", "-o", "one.csv"]) == 0
    told = capsys.readouterr().out
    assert "newton coupling (7 members composed)" in told
    assert "composed to one member: m0, m1, s1, s2, m3, s3, s4 (--member NAME=ENGINE steps one of them apart)" in told
    each = [f"--member={n}=python" for n in ("m0", "s1", "m1", "s2", "s3", "m3", "s4")]
    assert main(["run", "row.py", "--stop", "0.1", "--step", "0.01", "-o", "apart.csv", *each]) == 0
    assert "composed to" not in capsys.readouterr().out
    one, apart = (np.genfromtxt(f, delimiter=",", names=True) for f in ("one.csv", "apart.csv"))
    assert one.dtype.names == apart.dtype.names
    for name in ("m0v", "s4e", "m3v", "m2v"):
        assert np.abs(one[name] - apart[name]).max() <= 1e-9
    assert main(["info", "row.py"]) == 0
    told = capsys.readouterr().out
    assert "junction j0: m0.flange, s1.a; common flow; composed" in told
    assert "junction j2: m2.flange, s2.b, s3.a; common flow; newton: one held value, order 2" in told


ROW = """
from phfmu import Network
from phfmu.components.mechanical.translational import mass, spring

def row():
    net = Network("row")
    for i in range(5):
        if i == 2:
            net.add("m2", "mass.fmu", ports={"flange": {"effort": "F", "flow": "v", "sign": 1}})
        elif i < 4:
            net.add(f"m{i}", mass(1.0, k=0.5, v=0.1 * i + 0.1))
        if 0 < i:
            net.add(f"s{i}", spring(100.0 + i))
    for i in range(4):
        ends = [f"m{i}.flange", *([f"s{i}.b"] if i else []), f"s{i + 1}.a"]
        net.junction(f"j{i}", ends)
    return net
"""
