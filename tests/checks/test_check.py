"""The check of declarations: what it tells together, what it allows, where it looks."""

from dataclasses import replace

import casadi as ca

from phfmu import (
    PHDAE,
    ClosedPair,
    Collocated,
    Holonomic,
    Problem,
    algebraic,
    block,
    check,
    damping,
    energy,
    observable,
    skew,
    state,
    time,
)
from phfmu.cli import main
from tests.checks.broken import (
    FOREIGN,
    NO_POWER,
    machine,
)
from tests.checks.models import FORCE, D, K, M, Q, V, holonomic, oscillator, resistive, rules, source, two_lines

# -- one mutation a rule ---

X2 = ca.vertcat(Q.sx, V.sx)


def test_kirchhoff_at_a_bare_node():
    assert check(two_lines(1.0)) == []
    found = check(two_lines(1.5))
    assert {p.rule for p in found} == {"start"}
    assert [p.entry for p in found] == ["constraint of 'bus.v[1]'", "constraint of 'bus.v[3]'"]
    assert found[0].reason.startswith(("i of a.b and b.a sum to 0.5 A", "i of a.b and b.a sum to -0.5 A"))


def test_all_problems_at_once():
    model = oscillator(
        structure=(block([Q, V], [[0, 1], [1, 0]]),),
        dissipation=(damping(V, -D), block([Q], [[1, 2], [3, 4]])),
        ports=(replace(FORCE, domain=NO_POWER, nominal=0.0),),
        z={V: 3 * V.sx},
        observables=(observable("2x", FOREIGN.sx, unit="cubit"),),
    )
    expected = ["costate", "name", "nominal", "passivity", "shape", "skew", "symbol", "unit", "unit"]
    assert sorted(rules(model)) == expected


def test_follow_ups_are_not_reported():
    """A zero mass makes z infinite and the planner fail: only the mass is named."""
    model = replace(holonomic(("unit",)), E={})
    assert rules(replace(model, E={model.states[1]: 0.0})) == ["mass"]


def test_negative_curvature_and_indefinite_blocks_are_allowed():
    assert check(oscillator(energies=(energy(0.5 * M * V.sx**2), energy(-0.5 * K * Q.sx**2)))) == []
    assert check(oscillator(dissipation=(damping(V, -0.1), damping(V, D)))) == []


def test_points_outside_the_domain_are_skipped():
    gas = energy(-ca.log(Q.sx) + Q.sx)
    model = oscillator(energies=(energy(0.5 * M * V.sx**2), gas), dissipation=(damping(V, ca.sqrt(Q.sx)),))
    assert check(model) == []


def test_time_and_algebraic_variables_may_enter_matrices():
    i, v, model = resistive()
    assert check(replace(model, dissipation=(damping(v, 1 + v.sx**2 + ca.sin(time) ** 2),))) == []
    # the start of an algebraic variable is a guess: not being finite there is no problem of the declaration
    assert check(replace(oscillator(), dissipation=(damping(V, D * (1 + V.z**2)),))) == []
    assert check(source(lambda i: ca.sin(time))) == []


def test_the_scheme_is_that_of_the_caller():
    """Momenta as coordinates fit the plain scheme, not the two-level one."""
    q, p = state("q", 2, unit="m", start=[1.0, 0.0]), state("p", 2, unit="kg.m/s", start=[0.0, 1.0])
    lam = algebraic("lambda", unit="N/m")
    model = PHDAE(
        "pendulum",
        states=(q, p),
        algebraics=(lam,),
        energies=(energy(ca.sumsqr(p.sx) / 4),),
        structure=(skew(q, p, 1.0),),
        constraints=(Holonomic(lam, ca.SX(0.5 * (ca.sumsqr(q.sx) - 1.0))),),
    )
    assert rules(model) == ["solvability"]
    assert "--scheme semi-explicit" in check(model)[0].remedy
    assert check(model, Collocated()) == []


def test_a_closed_pair_of_one_state():
    """H = x^4/4 with E = x: z = x^2, ebar = (x + x')/2 d, zbar = (x^2 + x'^2)/2."""
    x = state("x", start=1.0)
    pair = ClosedPair(
        (x,), x.sx**4 / 4, x.sx, x.sx**2, lambda a, d: (a + d / 2) * d, lambda a, d: (a**2 + (a + d) ** 2) / 2
    )
    model = PHDAE("closed", states=(x,), closed=(pair,), dissipation=(damping(x, 1.0),))
    assert check(model) == []
    assert rules(replace(model, closed=(replace(pair, zbar=lambda a, d: (a + d / 2) ** 2),))) == ["closed-pair"]
    assert rules(replace(model, closed=(replace(pair, E=ca.SX(0), z=ca.SX(1)),))) == ["closed-pair"]  # E^T z = 0


def test_the_E_of_a_pair_may_be_singular():
    x = state("x", 2, start=(1.0, -1.0))
    pair = ClosedPair((x,), x[0] ** 2 / 2, ca.diag(ca.SX([1.0, 0.0])), x.sx, lambda a, d: ca.vertcat(d[0], 0),
                      lambda a, d: a + d / 2)  # fmt: skip
    model = PHDAE("singular", states=(x,), closed=(pair,), structure=(block([x], ca.SX([[0.0, 1.0], [-1.0, 0.0]])),),
                  dissipation=(block([x], ca.diag(ca.SX([0.0, 1.0]))),))  # fmt: skip
    assert check(model) == []
    assert rules(replace(model, closed=(replace(pair, z=2 * x.sx),))) == ["closed-pair"]


def test_a_broken_callable_is_a_problem_not_an_exception():
    def broken(a, d):
        raise RuntimeError("not written yet")

    assert rules(machine(ebar=lambda p: broken)) == ["internal"]


def test_text_of_a_problem():
    p = Problem("skew", "J block on q, v", "J[q, v] = 1 but J[v, q] = 1", "correct the sign")
    assert str(p) == "J block on q, v: J[q, v] = 1 but J[v, q] = 1; correct the sign [skew]"


def test_warnings_are_told_on_request_and_fail_only_where_they_count(monkeypatch, capsys):
    def odd(entries, sample):
        return [Problem("odd", entries.model.name, f"{sample.n} points look odd", "look again", "warning")]

    monkeypatch.setattr("phfmu.checks.check.WARNING_RULES", (odd,))
    assert check(oscillator()) == []
    (found,) = check(oscillator(), strict=True)
    assert found.severity == "warning" and str(found).startswith("warning: oscillator: 6 points look odd; look again")
    wrong = oscillator(dissipation=(block([V], -1.0),))  # an error comes alone: mend it first
    assert {p.severity for p in check(wrong, strict=True)} == {"error"} == {p.severity for p in check(wrong)}
    for arguments, code in (["check", "mass"], 0), (["check", "mass", "--strict"], 1):
        assert main(arguments) == code
        assert capsys.readouterr().out.splitlines()[-1] == "mass: 1 warning"
