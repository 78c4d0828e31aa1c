"""Errors are data: every refusal has an entry, a reason and a remedy for each of its problems, and a line for each."""

from __future__ import annotations

import ast
import pickle
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path

import pytest

import phfmu
from phfmu import DeclarationError, InconsistentState, Network, Options, PythonInstance, Refusal, build_model, run
from phfmu.cli import main
from phfmu.components.electrical.machines.machine_data import MachineDataError, machine_set
from phfmu.components.library import build
from phfmu.components.mechanical.translational import mass, spring
from phfmu.network.couplings.monolithic import Monolithic
from phfmu.network.junction import ConnectionError
from tests.sources import nodes

ROOT = Path(phfmu.__file__).parent
KINDS = (DeclarationError, ConnectionError, InconsistentState, MachineDataError)


def itself() -> None:
    net = Network("net")
    net.add("s", spring(1.0))
    net.connect("s.a", "s.a")


def sizes() -> None:
    net = Network("net")
    net.add("m", mass(1.0))
    net.add("line", build("rl_line"))
    net.junction("j", ["m.flange", "line.a"])


def machine() -> None:
    machine_set("kundur555_1q", J=-1.0, Ra=-1.0)


def off() -> None:
    """Both bars of the four particles are 1 mm too long at the start."""
    model = build_model(build("four_particle"))
    run(Monolithic(model, PythonInstance(replace(model, x0=1.001 * model.x0))), Options(stop=0.1, step=0.01))


@pytest.mark.parametrize(
    ("call", "kind", "entries", "reasons"),
    [
        (itself, ConnectionError, ["s.a"], ["joined to itself"]),
        (sizes, ConnectionError, ["m.flange - line.a"], ["m.flange has 1 scalar pairs, line.a has 3"]),
        (machine, MachineDataError, ["machine set 'kundur555_1q'"] * 2, ["J = -1.0 must", "Ra = -1.0 must"]),
        (off, InconsistentState, ["four_particle"] * 2, ["lambda[1]: position", "lambda[2]: position"]),
    ],
    ids=["itself", "sizes", "machine", "off"],
)  # fmt: skip
def test_refusals_are_data(
    call: Callable[[], None], kind: type[Refusal], entries: list[str], reasons: list[str]
) -> None:
    with pytest.raises(kind) as refusal:
        call()
    error = refusal.value
    assert [p.entry for p in error.problems] == entries
    assert all(w in p.reason for w, p in zip(reasons, error.problems, strict=True))
    assert all(p.remedy and p.reason and ";" not in p.reason for p in error.problems)
    assert (error.entry, error.reason, error.remedy) == (entries[0], error.problems[0].reason, error.problems[0].remedy)
    assert str(error).splitlines() == [f"{p.entry}: {p.reason}; {p.remedy}" for p in error.problems]
    again = pickle.loads(pickle.dumps(error))
    assert type(again) is kind and again.problems == error.problems


def test_every_refusal_in_the_package_gives_the_three() -> None:
    """Where one is raised by name, it has an entry, a reason and a remedy."""
    short = [
        (path.name, node.lineno)
        for path in [*ROOT.rglob("*.py"), *(ROOT / "components").rglob("*.py")]
        for node in nodes(path)
        if isinstance(node, ast.Call) and isinstance(node.func, ast.Name) and node.func.id in {k.__name__ for k in KINDS}
        and len(node.args) + len(node.keywords) < 3 and not any(isinstance(a, ast.Starred) for a in node.args)
    ]  # fmt: skip
    assert short == []
    assert all(issubclass(k, Refusal) and issubclass(k, ValueError) for k in KINDS)


TWO = """
from phfmu import PHDAE, Port, ROTATIONAL, energy, state


def bad():
    x, y = state("x", start=(float("nan"),)), state("y", start=(float("inf"),))
    return PHDAE("bad", states=(x, y), energies=(energy(x.sx**2 + y.sx**2),))
"""


def test_every_line_on_the_terminal_says_who_speaks(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    (tmp_path / "bad.py").write_text(TWO)
    code = main(["run", f"{tmp_path / 'bad.py'}:bad", "--stop", "1", "--step", "0.1", "--engine", "python"])
    lines = capsys.readouterr().err.splitlines()
    assert code == 2 and len(lines) == 3 and all(line.startswith("phfmu: ") for line in lines), lines
    assert "variable 'x'" in lines[1] and "variable 'y'" in lines[2]
