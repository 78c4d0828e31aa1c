"""What the command line shows of the library: verbs, lists, tables of a model, names of any kind, output of any width."""

from __future__ import annotations

import csv
import math
import os
import subprocess
import sys
from importlib.resources import files
from pathlib import Path

import numpy as np
import pytest

from phfmu.components.library import LIBRARY, TABLE, build
from phfmu.results.writer import TableWriter
from phfmu.runs.inputs.input_file import read_inputs
from tests.cli.commands import Cli
from tests.wide import wide

VERBS = ("list", "info", "check", "run", "export", "audit")


# -- verbs ---------------------------------------------------------------------------------------------------


def test_help_lists_the_verbs(cli: Cli) -> None:
    code, out, _ = cli("--help")
    assert code == 0 and all(f"\n    {verb} " in out for verb in VERBS)
    assert all(cli(verb, "--help")[0] == 0 for verb in VERBS)
    assert cli("--version")[1].startswith("phfmu ")


def test_list_names_the_whole_library(cli: Cli) -> None:
    code, out, _ = cli("list")
    lines = {line.split()[0]: line for line in out.splitlines() if line.startswith("  ")}
    assert code == 0 and lines.keys() == TABLE.keys()
    assert all(line.endswith(TABLE[name][2]) for name, line in lines.items())


#: a component of each domain and kind, scenes with parts, events and signals
SHOWN = (
    *(
        "synchronous_machine",
        "rlc_load",
        "breaker",
        "transformer",
        "dc_motor",
        "four_particle",
        "mass",
        "pi_controller",
    ),
    *("bouncing_ball", "oscillator", "speed_control", "two_machine"),
)


@pytest.mark.parametrize("target", wide(LIBRARY, *SHOWN))
def test_info_and_check_of_the_library(cli: Cli, target: str) -> None:
    code, out, _ = cli("info", target)
    assert code == 0
    declaration = getattr(build(target), "declaration", lambda: build(target))()
    for variable in (*declaration.states, *declaration.parameters):
        name = variable.name + (f"[1..{variable.size}]" if variable.size else "")
        assert any(line.split()[:2] == [name, variable.unit] for line in out.splitlines()), name
    assert all(f"  {p.name} " in out for p in declaration.ports)
    code, said, _ = cli("check", target)
    if target == "box_on_floor":  # where its rubber begins, forces have a kink
        assert code == 0 and said.count("warning: energy term") == 8 and "meet smoothly" in said
        return
    assert code == 0 and said.endswith(f"{target}: no problems\n")
    assert (said.count("\n") > 1) == (target == "bricard")  # which of its rows are too many
    if target == "two_machine":
        assert "t = 0.1 s: fault.G = 20" in out and "t = 0.2 s: fault.G = 0" in out
        assert "junction bus2: line.b, m2.terminal, load.terminal, fault.terminal" in out


def test_customary_runs_belong_to_names_of_the_library(tmp_path: Path) -> None:
    from phfmu.components.library import RUNS
    from phfmu.target import scene

    assert set(RUNS) <= set(LIBRARY) and all(LIBRARY[name][0] == "component" for name in RUNS)
    for name, (stop, step) in RUNS.items():
        assert (scene(name).stop, scene(name).step) == (stop, step)
    file = tmp_path / "own.py"
    file.write_text("from phfmu import PHDAE\ndef model():\n    return PHDAE('four_particle')\n", encoding="utf-8")
    own = scene(f"{file}:model")  # a model of a user, whatever its name
    assert (own.stop, own.step) == (1.0, 1e-3)


def test_no_verb_knows_a_model_by_name() -> None:
    for source in (files("phfmu") / "cli").iterdir():
        if source.name.endswith(".py"):
            text = source.read_text(encoding="utf-8")
            told = [
                name for name in LIBRARY if f'"{name}"' in text and name not in ("fault", "engine")
            ]  # options are called --fault and --engine, too
            assert not told, source.name


def test_no_progress_bar_in_a_pipe(cli: Cli) -> None:
    call = [sys.executable, "-c", "from phfmu.cli import main; raise SystemExit(main())"]
    words = ["run", "mass", "--engine", "python", "--stop", "0.1"]
    done = subprocess.run([*call, *words], capture_output=True, text=True, check=True)
    assert done.stderr == "" and not {"\r", "\x1b"} & set(done.stdout) and "closed" in done.stdout
    code, out, err = cli("run", "none")
    assert (code, out) == (2, "") and err.startswith("phfmu: no component")


# -- names and the terminal ----------------------------------------------------------------------------------

ODD = ['a"b', "c,d", "e\nf", "größe ω", 'g"",\n"h', "plain[1]"]


def test_names_of_any_kind_survive_a_table(tmp_path: Path) -> None:
    """Quotes, commas, newlines and letters beyond ASCII: what is written is read again, by both readers."""
    writer = TableWriter(tmp_path / "o.csv", ODD, [""] * len(ODD))
    values = np.array([[0.1, 1 / 3, -0.0, 1e300, 5e-324, 7.0], [math.nan, math.inf, -math.inf, 1e-5, 123456789.0, 0.0]])
    writer.add(np.array([0.0, 0.1]), values, np.zeros(2, bool))
    writer.close()
    with open(tmp_path / "o.csv", newline="", encoding="utf-8") as file:
        head, *rows = csv.reader(file)
    assert head == ["time", *ODD] and np.array_equal(np.array(rows, float)[:, 1:], values, equal_nan=True)
    writer = TableWriter(tmp_path / "in.csv", ODD, [""] * len(ODD))
    writer.add(np.array([0.0]), values[:1], np.zeros(1, bool))
    writer.close()
    held = read_inputs(str(tmp_path / "in.csv"), ODD)
    assert held.names == ODD and np.array_equal(held.values, values[:1])


@pytest.mark.parametrize("verb", wide(["info", "check", "run", "list"], "run"))
def test_a_terminal_without_the_letters(tmp_path: Path, verb: str) -> None:
    """The exit code is that of the verb; letters that the terminal does not have are spelled out."""
    (tmp_path / "m.py").write_text(
        "from dataclasses import replace\nfrom phfmu.components.mechanical.translational import mass\n"
        "from phfmu.components.library import TABLE\nTABLE['mass'] = (*TABLE['mass'][:2], 'größe ω')\n"
        "def größe(): return replace(mass(), name='größe_ω', description='größe ω')\n",
        encoding="utf-8",
    )
    target = [str(tmp_path / "m.py:größe")] if verb != "list" else []
    words = [verb, *target, *(["--engine", "python", "--stop", "0.01"] if verb == "run" else [])]
    code = f"import sys; sys.path.insert(0, {str(tmp_path)!r}); import m; from phfmu.cli import main; sys.exit(main({words}))"
    env = os.environ | {"LC_ALL": "C", "PYTHONIOENCODING": "ascii"}
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, env=env)
    assert done.returncode == 0, done.stderr
    assert b"\\xf6" in done.stdout and done.stdout.isascii()


def test_the_package_is_a_command() -> None:
    done = subprocess.run([sys.executable, "-m", "phfmu", "--version"], capture_output=True, text=True)
    assert done.returncode == 0 and done.stdout.startswith("phfmu ")
    done = subprocess.run([sys.executable, "-m", "phfmu", "run", "none"], capture_output=True, text=True)
    assert done.returncode == 2 and done.stderr.startswith("phfmu: no component")
