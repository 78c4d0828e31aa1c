"""Dimensions: units of states, parameters, ports and observables have to fit where they are used."""

from __future__ import annotations

from dataclasses import replace
from fractions import Fraction

import casadi as ca
import pytest

from phfmu import (
    ELECTRICAL,
    PHDAE,
    ROTATIONAL,
    Holonomic,
    Port,
    algebraic,
    check,
    damping,
    energy,
    observable,
    parameter,
    skew,
    state,
    time,
)
from phfmu.cli import main
from phfmu.components.electrical.machines.dc_motor import dc_motor
from phfmu.components.library import LIBRARY, build
from phfmu.components.mechanical.net import net
from phfmu.declare.expressions.dimension import JOULE, Dimension, DimensionAnalysis, of_unit
from phfmu.declare.expressions.units import unit_text
from tests.wide import wide


def told(model: PHDAE) -> list[str]:
    assert check(model) == []
    found = check(model, strict=True)
    assert {(p.rule, p.severity) for p in found} <= {("dimension", "warning"), ("kink", "warning")}
    return [str(p) for p in found if p.rule == "dimension"]


def with_units(model: PHDAE, **units: str) -> PHDAE:
    return model.mapped(lambda v: replace(v, unit=units.get(v.name, v.unit)), lambda p: p)


@pytest.mark.parametrize(
    "name", wide(LIBRARY, "synchronous_machine", "dc_motor", "four_particle", "pi_controller", "drive", "breaker")
)
def test_the_units_of_the_library_fit(name):
    item = build(name)
    assert told(item if isinstance(item, PHDAE) else item.declaration()) == []


@pytest.mark.parametrize(
    ("units", "words"),
    [
        ({"L": "F"}, ("energy term 1", "kg3.m6/s8/A4", "an energy is in J")),
        ({"flux": "mWb"}, ("energy term 1", "is in uJ", "an energy is in J")),
        ({"J": "g.m2"}, ("energy term 2", "mJ", "an energy is in J")),
        ({"R": "mohm"}, ("R block on flux", "is in mohm", "row 'flux' and column 'flux' need ohm")),
        ({"R": "S"}, ("R block on flux", "is in S", "need ohm")),
        ({"k": "N.m"}, ("J block on flux, w", "need Wb")),
        ({"d": "N.m"}, ("R block on w", "is in J")),
    ],
)
def test_a_wrong_unit_of_the_motor_is_told_where_it_does_not_fit(units, words):
    found = told(with_units(dc_motor(), **units))
    assert any(all(w in text for w in words) for text in found), found


@pytest.mark.parametrize("unit", ["N.m/A", "Wb", "V.s", "V.s/rad", "J/A"])
def test_units_with_the_same_dimension_are_the_same(unit):
    assert told(with_units(dc_motor(), k=unit)) == []


def test_ports_sources_and_observables():
    model = dc_motor()
    (found,) = told(replace(model, observables=(observable("i", model.states[0].z, unit="V"),)))
    assert "observable 'i': is in A, but it is declared in V" in found
    (found,) = told(replace(model, observables=(observable("i", model.states[0].z),)))
    assert "is in A, but it is declared in 1" in found
    flux = model.states[0]
    (found,) = told(replace(model, ports=(Port("shaft", ROTATIONAL, "effort", {flux: 1.0}), model.ports[0])))
    assert "port 'shaft': B on 'flux': is in 1, but row 'flux' and column 'shaft.torque' need 1/Wb" not in found
    assert "port 'shaft': B on 'flux': is in 1" in found
    amplitude, omega = parameter("a", 1.0, unit="V"), parameter("omega", 1.0, unit="1/s")
    for source, fits in ((amplitude * ca.sin(omega * time), True), (amplitude * time, False), (ca.SX(24.0), True)):
        port = Port("terminal", ELECTRICAL, "effort", {flux: 1.0}, source=source)
        assert (told(replace(model, parameters=(*model.parameters, amplitude, omega), ports=(port,))) == []) == fits


def pendulum(unit: str, angle) -> PHDAE:
    theta, p = state("theta", unit=unit, start=0.5), state("p", unit="kg.m2/s")
    inertia, weight = parameter("I", 0.5, unit="kg.m2"), parameter("mgl", 9.81, unit="N.m")
    H = energy(p**2 / (2 * inertia)), energy(weight * (1 - ca.cos(angle(theta.sx))))
    return PHDAE(
        "pendulum", states=(theta, p), parameters=(inertia, weight), energies=H, structure=(skew(theta, p, 1.0),)
    )


def test_angles():
    assert told(pendulum("rad", lambda a: a)) == []
    assert any("takes cos of deg" in text for text in told(pendulum("deg", lambda a: a)))
    assert not any("cos" in text for text in told(pendulum("deg", lambda a: a * (ca.pi / 180))))
    assert any("takes cos of m" in text for text in told(pendulum("m", lambda a: a)))


def particle(**changes) -> PHDAE:
    q, v = state("q", 2, unit="m", start=(1.0, 0.0)), state("v", 2, unit="m/s")
    m, g = parameter("m", 2.0, unit="kg"), parameter("g", 9.81, unit="m/s2")
    lam = algebraic("lambda", unit=changes.pop("multiplier", "N/m"))
    H = energy(m * ca.sumsqr(v.sx) / 2), energy(changes.pop("weight", m * g) * q[1])
    return PHDAE("particle", states=(q, v), algebraics=(lam,), parameters=(m, g), energies=H, E={v: m},
                 structure=(skew(q, v, 1.0),), constraints=(Holonomic(lam, (ca.sumsqr(q.sx) - 1) / 2),))  # fmt: skip


def test_constraints_have_the_unit_that_makes_their_multiplier_an_energy():
    assert told(particle()) == []
    (found,) = told(particle(multiplier="N"))
    assert "constraint 'lambda': is in m2, but its multiplier in N needs m" in found


def test_numbers_may_be_quantities_but_formulas_are_not_excused_by_theirs():
    x, k = state("x", unit="m", start=0.1), parameter("k", 2.0, unit="N/m")
    n = parameter("n", 2.0)

    def energies(*terms) -> list[str]:
        return told(PHDAE("m", states=(x,), parameters=(k, n), energies=tuple(map(energy, terms)),
                          structure=(), dissipation=(damping(x, 1e-3),)))  # fmt: skip

    assert energies(k * x**2 / 2) == [] == energies(k * x**2 / 2, 9.81 * x**2) == energies(20 * ca.fmax(x - 1, 0) ** 2)
    assert energies(k * (x - 0.25) ** 2 / 2) == []  # a summand has the unit of what it is subtracted from
    assert "is in N, but an energy is in J" in energies(k * x / 2)[0]
    assert "is in kg.m3/s2 (the number 3 counted as dimensionless)" in energies(3 * k * x**3)[0]
    assert "adds J and N" in energies(k * x**2 / 2 + k * x)[0]
    assert "raises m to a power" in energies(k * x.sx**n.sx / 2)[0]
    assert energies(k * ca.sqrt(x**4 + x**2 * x**2) / 2) == []


def test_a_model_without_units_is_not_judged():
    x = state("x", start=0.5)
    assert told(PHDAE("m", states=(x,), energies=(energy(x**2 + x**4),), dissipation=(damping(x, 1.0),))) == []
    assert told(net(2)) == []


def test_the_command_line_warns_and_is_strict_on_request(tmp_path, capsys, monkeypatch):
    monkeypatch.chdir(tmp_path)
    (tmp_path / "wrong.py").write_text(
        "from dataclasses import replace\nfrom phfmu.components.electrical.machines.dc_motor import dc_motor\n"
        "def m(): return dc_motor().mapped(lambda v: replace(v, unit='F') if v.name == 'L' else v, lambda p: p)\n"
    )
    for arguments, code in (["check", "wrong.py:m"], 0), (["check", "wrong.py:m", "--strict"], 1):
        assert main(arguments) == code
        lines = capsys.readouterr().out.splitlines()
        assert lines[0].startswith("warning: energy term 1: is in") and lines[-1] == "wrong.py:m: 1 warning"


def test_algebra():
    a, b = ca.SX.sym("a"), ca.SX.sym("b")
    known = {a.element_hash(): of_unit("V"), b.element_hash(): of_unit("A")}
    for expr, unit in ((a * b, "W"), (a / b, "ohm"), (ca.sqrt(a * a), "V"), (ca.atan2(a, a * 2), "1"),
                       (ca.if_else(a > 1, b, 0), "A"), (ca.fabs(-a) + 2, "V"), (1 / (a / b), "S")):  # fmt: skip
        walk = DimensionAnalysis(expr, known)
        (found,) = walk.entries()
        assert isinstance(found, Dimension) and found.fits(of_unit(unit)) and not walk.clashes
        assert str(found) == unit
    walk = DimensionAnalysis(ca.fmax(a, b), known)
    assert walk.entries() == [None] and walk.clashes == ["it compares V and A"]
    assert str(JOULE.to_the(Fraction(1, 2))) == "kg1/2.m/s" and unit_text(JOULE.exponents, 1e-3) == "mJ"
