"""Limits of parameters: declared and derived, in the check, before a run, in descriptions and in units."""

from __future__ import annotations

import time
from dataclasses import replace
from inspect import signature
from pathlib import Path

import casadi as ca
import numpy as np
import pytest
from lxml import etree

from phfmu import (
    ELECTRICAL,
    PHDAE,
    Event,
    FMUInstance,
    Port,
    Scene,
    block,
    build_model,
    check,
    check_values,
    damping,
    energy,
    export,
    parameter,
    state,
)
from phfmu.cli import main
from phfmu.components.control import exac1, gast, hygov, ieeest, ieeex1, pss1a, sexs, st1a, tgov1
from phfmu.components.electrical.machines.dc_motor import dc_motor
from phfmu.components.library import LIBRARY, build
from phfmu.components.mechanical.net import net
from phfmu.declare.entries.parameter_limits import ParameterLimit, limits
from phfmu.fmu.export.description import ExportedUnit
from phfmu.fmu.version import VERSIONS


def texts(model: PHDAE) -> dict[str, str]:
    return {name: str(limit) for name, limit in limits(model).items()}


def one(p, *, H=None, R=None, E=None) -> dict[str, str]:
    """Limits of the parameter p in a model of one state x."""
    x = state("x", start=0.5)
    terms = (energy(0.5 * x**2 if H is None else H(x.sx, p.sx)),)
    blocks = () if R is None else (damping(x, R(x.sx, p.sx)),)
    return texts(PHDAE("m", states=(x,), parameters=(p,), energies=terms, E={} if E is None else {x: E(p.sx)},
                       dissipation=blocks))  # fmt: skip


def test_what_a_declaration_proves():
    p = parameter("p", 2.0)
    assert one(p, R=lambda x, p: p) == {"p": "at least 0"}
    assert one(p, R=lambda x, p: 1 / p) == {"p": "above 0"}  # a resistance as a conductance
    assert one(p, R=lambda x, p: p * (1 + x**2)) == {"p": "at least 0"}
    assert one(p, H=lambda x, p: x**2 / (2 * p)) == {"p": "above 0"}  # an inductance
    assert one(p, H=lambda x, p: p * x**2 / 2) == {"p": "at least 0"}  # a stiffness
    assert one(p, H=lambda x, p: p * x**2 / 2, E=lambda p: p) == {"p": "above 0"}  # a mass
    # no proof: sums, squares, signs that are the other way round or depend on the state, energies bounded in x
    for R in (lambda x, p: 1 + p, lambda x, p: p**2, lambda x, p: -p, lambda x, p: p * x, lambda x, p: p * p - p):
        assert one(p, R=R) == {}
    assert one(p, H=lambda x, p: p * x**2 + x**4) == {}
    assert one(p, H=lambda x, p: p * (1 - ca.cos(x))) == {}


def test_what_is_declared_goes_before_what_is_proven():
    def R(x, p):
        return p

    assert one(parameter("p", 2.0, min=-np.inf), R=R) == {}
    assert one(parameter("p", 2.0, max=5), R=R) == {"p": "at least 0 and at most 5"}
    assert one(parameter("p", 2.0, min=1), R=R) == {"p": "at least 1"}
    assert one(parameter("p", 2.0, positive=True), R=lambda x, p: p * x) == {"p": "above 0"}
    assert one(parameter("p", (2.0, 3.0), 2, max=(4.0, np.inf))) == {"p[1]": "at most 4"}


#: parameters of controllers without unit: gains, limits and references of either sign
GAINS = {n for b in (sexs, exac1, ieeex1, st1a, tgov1, hygov, gast, pss1a, ieeest) for n in signature(b).parameters}
GAINS = (GAINS | {"A_SE", "B_SE"}) - {"R", "r", "u_base"}


#: places and axes of joints, springs and contacts of a mechanism
PLACES = ("at_", "x_axis_", "y_axis_", "z_axis_", "normal")


@pytest.mark.parametrize("name", LIBRARY)
def test_every_parameter_of_the_library_that_must_be_positive_says_so(name):
    model = getattr(build(name), "declaration", lambda: build(name))()
    found = limits(model)
    free = {
        "phase",
        "amplitude",
        "omega",
        "Q",
        "M",
        "n",
        "k",
        "l10",
        "w",
        "L_fkd",
        "kp",
        "ki",
        "lower",
        "upper",
        "low",
        "high",
    }  # signs are a matter of direction
    for v in model.parameters:
        base = v.name.rsplit(".", 1)[-1]
        signless = v.signal or base in free or base.startswith(("M_", *PLACES))
        signless = signless or base.endswith(("_at", "_second")) or (v.unit == "1" and base in GAINS)
        signless = signless or v.name.endswith((".gear_ratio", ".gear_start"))
        signless = signless and not (base == "k" and v.unit != "V.s/rad")  # a stiffness, not a torque constant
        for n, value in zip(v.names(), v.start, strict=True):
            assert (n in found) != signless or base.endswith(("_at", "_second")), n
            assert signless or (found[n].min == 0.0 and found[n].allows(value) and not found[n].allows(-1e-9)), n


def motor_values(**values: float):
    return check_values(dc_motor(), values)


def test_values_are_told_as_by_check_with_name_number_and_remedy():
    assert motor_values(R=0.0, d=0.0) == []
    for values in ({"R": -1.5}, {"J": -1.0}, {"J": 0.0}, {"L": 0.0}, {"L": -2.0, "d": -1e-9}):
        found = motor_values(**values)
        told = [p for p in found if p.rule == "limit"]
        assert [p.entry for p in told] == [f"parameter '{n}'" for n in values]
        assert all(f"is {v:g} " in p.reason and f"give {n} a value" in p.remedy
                   for p, (n, v) in zip(told, values.items(), strict=True))  # fmt: skip
        assert {str(p) for p in found} <= {str(p) for p in check(dc_motor().with_starts(values))}
    assert [p.rule for p in motor_values(flux=float("nan"))] == ["start"]
    with pytest.raises(KeyError, match="no parameter, state or input 'RR'"):
        motor_values(RR=1.0)


def test_a_declared_sign_that_is_meant_is_waived():
    x, k = state("x", start=0.1), parameter("k", -3.0, min=-np.inf)
    soft = PHDAE("soft", states=(x,), parameters=(k,), energies=(energy(k * x**2 / 2),), dissipation=(damping(x, 1.0),))
    assert check(soft) == [] and check_values(soft) == []
    strict = soft.mapped(lambda v: replace(v, min=None) if v is k else v, lambda p: p)
    (found,) = check(strict)
    assert found.rule == "limit" and "declare min=-inf" in found.remedy


def test_parameter_values_that_events_bring_are_checked():
    coupling = parameter("c", 0.5)
    x = state("x", 2, start=1.0)
    model = PHDAE("coupled", states=(x,), parameters=(coupling,), energies=(energy(0.5 * ca.sumsqr(x.sx)),),
                  dissipation=(block([x], ca.blockcat([[1, coupling.sx], [coupling.sx, 1]])),))  # fmt: skip
    assert check_values(model, events=[Event(0.1 * i, "c", 0.9 - 0.1 * i) for i in range(18)]) == []
    (found,) = check_values(model, events=[Event(0.1, "c", 0.2), Event(0.3, "c", 1.25), Event(0.4, "c", -1.5)])
    assert found.rule == "passivity" and "eigenvalue -0.5" in found.reason and "c = -1.5 at t = 0.4 s" in found.reason
    assert check_values(model, events=[Event(0.3, "u", 1.25)]) == []  # no parameter: not its business


def test_the_values_of_a_run_are_checked_before_it(tmp_path: Path, capsys, monkeypatch):
    monkeypatch.chdir(tmp_path)

    def refused(line: str, *words: str) -> None:
        assert main(line.split()) == 2
        err = capsys.readouterr().err
        assert all(w in err for w in words), err

    refused("run dc_motor --set R=-1.5 --stop 0.01", "parameter 'R': is -1.5 ohm", "at least 0", "[passivity]")
    refused("export dc_motor --set J=0 -o out", "parameter 'J': is 0 kg.m2", "above 0")
    refused("run drive --set motor.R=-1 --coupling newton", "parameter 'motor.R': is -1 ohm")
    Path("in.csv").write_text("time,R\n0,0.4\n0.005,-0.1\n")
    refused("run dc_motor --input in.csv --stop 0.01", "R = -0.1 at t = 0.005 s")
    Path("late.py").write_text(
        "from phfmu import Event, Scene\nfrom phfmu.components.electrical.machines.dc_motor import dc_motor\n"
        "def s(): return Scene('late', dc_motor(), 0.02, 1e-3, (Event(0.01, 'd', -1.0),))\n"
    )
    refused("run late.py:s", "parameter 'd': is -1 N.m.s/rad after the event d = -1 at t = 0.01 s")
    assert not Path("out").exists()
    # an active resistor that starts at rest stays there: nothing else would refuse it
    assert main("run dc_motor --set R=-1.5 --stop 0.01 --engine python --no-check --quiet".split()) == 0


MODELS = """
import casadi as ca
from phfmu import Event, PHDAE, Scene, block, energy, parameter, state
def oscillator(potential, turn=-1.0, **more):
    q, p = state('q', start=0.5), state('p', start=1.0)
    return PHDAE('oscillator', states=(q, p), energies=(energy(p**2 / 2), energy(potential(q.sx))), **more,
                 structure=(block([q, p], ca.DM([[0, 1], [turn, 0]])),))
def jumps():
    return Scene('jumps', oscillator(lambda q: q**2 + ca.if_else(q > 1, 3.0, 0.0)), 0.02, 1e-3)
def later():
    c = parameter('c', 0.0)
    model = oscillator(lambda q: q**2 + ca.if_else(q > 1, c.sx, 0.0), parameters=(c,))
    return Scene('later', model, 0.02, 1e-3, (Event(0.01, 'c', 3.0),))
def turned():
    return Scene('turned', oscillator(lambda q: q**2, turn=+1.0), 0.02, 1e-3)
"""


@pytest.mark.parametrize("verb", ["run", "export"])
@pytest.mark.parametrize(
    ("scene", "words"),
    [("jumps", ("energy term 2", "H jumps by 3 J at q = 1")), ("turned", ("J[q, p] = 1 but J[p, q] = 1", "skew"))],
)
def test_energies_that_jump_and_numbers_that_are_not_skew_are_refused_before_a_step(
    verb, scene, words, tmp_path: Path, capsys, monkeypatch
):
    """The steps from 0.5 m do not reach the jump at 1 m, and the ledger of what does not move stays closed."""
    monkeypatch.chdir(tmp_path)
    Path("models.py").write_text(MODELS)
    assert main([verb, f"models.py:{scene}"]) == 2
    err = capsys.readouterr().err
    assert all(w in err for w in (*words, "--no-check goes on anyway")), err
    assert [f.name for f in tmp_path.iterdir() if f.suffix != ".pyc" and f.is_file()] == ["models.py"]


def test_a_jump_that_an_event_makes_is_refused_and_the_brave_go_on(tmp_path: Path, capsys, monkeypatch):
    monkeypatch.chdir(tmp_path)
    Path("models.py").write_text(MODELS)
    line = ["run", "models.py:later", "--engine", "python", "--quiet"]
    assert main(line) == 2
    assert "H jumps by 3 J at q = 1, after the event c = 3 at t = 0.01 s" in capsys.readouterr().err
    assert main([*line, "--no-check"]) == 0
    assert main([*line, "--stop", "0.005"]) == 0  # the event is not reached


def test_the_check_of_values_costs_little():
    model = Scene("s", build("smib").system, 1.0, 1.0).declaration()
    spent = []
    for _ in range(3):
        begin = time.process_time()
        assert check_values(model, {"gen.d": 0.0}) == []
        spent.append(time.process_time() - begin)
    assert min(spent) < 0.5  # 0.05 s on the machine it was written on


def test_the_check_of_values_is_cheap_beside_the_plan_of_a_large_model():
    sheet = net(9)  # 243 velocities; with dense blocks the check took three times as long as the plan
    spent = []
    for call in check_values, build_model:
        begin = time.process_time()
        call(sheet)
        spent.append(time.process_time() - begin)
    assert spent[0] < spent[1]


def description(version: str) -> dict[str, dict[str, str]]:
    """Attributes of the variables of the motor."""
    declaration = dc_motor()
    unit = ExportedUnit(build_model(declaration), 1e-3)
    root = etree.fromstring(VERSIONS[version].description(unit))
    found = root.findall(".//ScalarVariable" if version == "2.0" else ".//Float64")
    return {v.get("name"): dict(v.attrib) | dict(v[0].attrib if len(v) else {}) for v in found}


@pytest.mark.parametrize("version", ["2.0", "3.0"])
def test_limits_stand_in_the_description(version):
    rows = description(version)
    assert {n for n, v in rows.items() if "min" in v} == {"L", "R", "J", "d"}
    assert all(float(rows[n]["min"]) == 0.0 and "max" not in rows[n] for n in "LRJd")


def coil() -> PHDAE:
    x = state("flux", unit="Wb", start=0.1)
    L, R = parameter("L", 0.2, unit="H"), parameter("R", 1.5, unit="ohm", max=100.0)
    return PHDAE("coil", states=(x,), parameters=(L, R), energies=(energy(x**2 / (2 * L)),),
                 dissipation=(damping(x, R),), ports=(Port("terminal", ELECTRICAL, "effort", {x: 1.0}),))  # fmt: skip


def test_a_unit_refuses_parameters_outside_their_limits(tmp_path: Path):
    paths = export(build_model(coil()), tmp_path, step=1e-3)
    for path in paths:
        for name, value, text in (("R", -1.5, "R = -1.5 must be at least 0"), ("L", 0.0, "L = 0 must be above 0"),
                                  ("R", 101.0, "R = 101 must be at most 100")):  # fmt: skip
            with pytest.raises(Exception, match=f"the parameter {text}"):
                FMUInstance(path, starts={name: value}).do_step(0.0, 1e-3)
        unit = FMUInstance(path, starts={"R": 0.0})
        unit.do_step(0.0, 1e-3)


def test_text_of_a_limit():
    assert str(ParameterLimit(0.0, 3.0, above=True)) == "above 0 and at most 3"
