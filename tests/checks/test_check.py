"""The check of declarations: every rule catches its own mutation."""

from dataclasses import replace
from typing import Any

import casadi as ca
import numpy as np
import pytest

from phfmu import (
    ELECTRICAL,
    PHDAE,
    Block,
    ClosedPair,
    Collocated,
    Domain,
    Energy,
    Holonomic,
    Network,
    Observable,
    Port,
    Problem,
    algebraic,
    block,
    check,
    damping,
    energy,
    observable,
    parameter,
    skew,
    state,
    strain_energy,
    time,
)
from phfmu.cli import main
from phfmu.components.electrical.sources import voltage_source
from phfmu.components.electrical.synchronous_machine import synchronous_machine
from phfmu.components.mechanical.four_particle import four_particle
from tests.checks.models import FORCE, D, K, M, Q, V, holonomic, oscillator, resistive, rules, source, two_lines


def with_variable(old, **changes: Any) -> PHDAE:
    """The oscillator with a variable changed everywhere."""
    return oscillator().mapped(lambda v: replace(v, **changes) if v is old else v, lambda p: p)


# -- one mutation a rule ---

X2 = ca.vertcat(Q.sx, V.sx)
FOREIGN = parameter("mu", 1.0)
OTHER_M = parameter("m", 1.0)
NO_POWER = Domain("broken", "force", "N", "position", "m", "flow")
SCALED = Domain("scaled", "force", "kN", "velocity", "m/s", "flow")


def two_sources() -> PHDAE:
    net = Network("loop")
    net.add("a", voltage_source(1.0))
    net.add("b", voltage_source(2.0))
    net.junction("bus", ["a.terminal", "b.terminal"])
    return net.compose()


def no_conductance() -> PHDAE:
    """A conductance that is given its current and is zero: the voltage is undetermined."""
    v, G = algebraic("v", unit="V"), parameter("G", 0.0, unit="S")
    port = Port("pin", ELECTRICAL, "flow", {v: 1.0}, start=1.0)
    return PHDAE("open", algebraics=(v,), parameters=(G,), dissipation=(damping(v, G),), ports=(port,))


def degenerate() -> PHDAE:
    """q^2 = 0 instead of q = 0."""
    q, v, lam = state("q", unit="m"), state("v", unit="m/s"), algebraic("lambda")
    return PHDAE(
        "wall",
        states=(q, v),
        algebraics=(lam,),
        energies=(energy(0.5 * v.sx**2),),
        structure=(skew(q, v, 1.0),),
        constraints=(Holonomic(lam, q.sx**2),),
    )


def machine(**changes: Any) -> PHDAE:
    """The synchronous machine in current coordinates with a mutated closed-form pair."""
    model = synchronous_machine(coordinates="current")
    pair = model.closed[0]
    new = {k: f(pair) for k, f in changes.items()}
    return replace(model, closed=(replace(pair, **new),))


def machine_with(**changes: Any) -> PHDAE:
    model = synchronous_machine(coordinates="current")
    return replace(model, **{k: f(model) for k, f in changes.items()})


def lonely() -> PHDAE:
    _, _, model = resistive()
    return replace(model, algebraics=(*model.algebraics, algebraic("idle", unit="V")))


def quartic(s: ca.SX) -> ca.SX:
    return 0.25 * s**2


BAD = {
    "skew: sign": ("skew", lambda: oscillator(structure=(block([Q, V], [[0, 1], [1, 0]]),)), "J[q, v] = 1"),
    "skew: diagonal": (
        "skew",
        lambda: oscillator(structure=(block([Q, V], [[0, 1], [-1, 1e-3]]),)),
        "J[v, v]",
    ),
    "skew: away from the start": (
        "skew",
        lambda: oscillator(structure=(block([Q, V], ca.blockcat([[0, 1], [-1 - Q * (Q - 0.3), 0]])),)),
        "at q =",
    ),
    "skew: depends on z": (
        "skew",
        lambda: oscillator(structure=(block([Q, V], ca.blockcat([[0, 1], [-1 + V.z, 0]])),)),
        "J[q, v] = 1",
    ),
    "symmetry": (
        "symmetry",
        lambda: oscillator(dissipation=(block([Q, V], [[1, 0.3], [0, 1]]),)),
        "R[q, v] = 0.3",
    ),
    "passivity: sign": ("passivity", lambda: oscillator(dissipation=(damping(V, -D),)), "eigenvalue -0.4"),
    "passivity: coupling": (
        "passivity",
        lambda: oscillator(dissipation=(block([Q, V], [[1, 2], [2, 1]]),)),
        "eigenvalue -1",
    ),
    "passivity: sum": (
        "passivity",
        lambda: oscillator(dissipation=(damping(V, D), damping(V, -0.5))),
        "eigenvalue -0.1",
    ),
    "passivity: away from the start": (
        "passivity",
        lambda: oscillator(dissipation=(damping(V, Q - 0.29),)),
        "at q =",
    ),
    "costate": ("costate", lambda: oscillator(z={V: 2 * V.sx}), "given z = -0.4, E^-T grad H = -0.2"),
    "costate: momentum": ("costate", lambda: oscillator(z={V: M * V.sx}), "E^-T grad H"),
    "costate: E block": (
        "costate",
        lambda: oscillator(states=(Q, V), E={V: M, Q: ca.SX(2.0)}, z={Q: K * Q.sx}),
        "z of 'q'",
    ),
    "shape: J": (
        "shape",
        lambda: oscillator(structure=(skew(Q, V, 1.0), Block((Q,), ca.SX(2, 2)))),
        "2 x 2, expected 1 x 1",
    ),
    "shape: R": (
        "shape",
        lambda: oscillator(dissipation=(Block((Q, V), ca.SX(1)),)),
        "1 x 1, expected 2 x 2",
    ),
    "shape: B": (
        "shape",
        lambda: oscillator(ports=(replace(FORCE, on={V: [1.0, 2.0]}),)),
        "2 x 1, expected 1 x 1",
    ),
    "shape: E": ("shape", lambda: oscillator(E={V: ca.SX.eye(3)}, z={}), "3 x 3"),
    "shape: E text": ("shape", lambda: oscillator(E={V: "heavy"}, z={}), "not an expression"),
    "shape: z": ("shape", lambda: oscillator(z={V: [1, 2]}), "z of 'v'"),
    "shape: start": ("shape", lambda: with_variable(V, start=(1.0, 2.0)), "start has 2 entries"),
    "shape: nominal": ("shape", lambda: with_variable(V, nominal=(1.0, 2.0)), "nominal has 2 entries"),
    "shape: input start": (
        "shape",
        lambda: oscillator(ports=(replace(FORCE, start=[1.0, 2.0]),)),
        "start has 2",
    ),
    "shape: observable": (
        "shape",
        lambda: oscillator(observables=(Observable("none", ca.SX(0, 1)),)),
        "0 x 1",
    ),
    "shape: source": ("shape", lambda: source(lambda i: ca.SX(2, 1)), "source of 'pin'"),
    "shape: constraint": (
        "shape",
        lambda: replace(c := holonomic(("unit",)), constraints=(replace(c.constraints[0], g=ca.SX(2, 1)),)),
        "constraint 'lambda'",
    ),
    "unit: power": ("unit", lambda: oscillator(ports=(replace(FORCE, domain=NO_POWER),)), "[1, 2, -2"),
    "unit: factor": ("unit", lambda: oscillator(ports=(replace(FORCE, domain=SCALED),)), "1000 times"),
    "unit: variable": ("unit", lambda: with_variable(V, unit="furlong/s"), "furlong"),
    "unit: observable": (
        "unit",
        lambda: oscillator(observables=(observable("a", V.sx, unit="m//s^2"),)),
        "s^2",
    ),
    "mass: zero": ("mass", lambda: with_variable(M, start=(0.0,), min=(-np.inf,)), "E[v, v] = 0"),
    "mass: block": (
        "mass",
        lambda: replace(
            h := holonomic(("unit",)),
            E={h.states[1]: [[1.0, 1.0], [1.0, 1.0]]},
            algebraics=(),
            constraints=(),
        ),
        "singular",
    ),
    "start: nan": ("start", lambda: with_variable(V, start=(float("nan"),)), "start of v is nan"),
    "start: parameter": ("start", lambda: with_variable(K, start=(float("inf"),)), "value of k is inf"),
    "start: input": (
        "start",
        lambda: oscillator(ports=(replace(FORCE, start=float("inf")),)),
        "start of flange.force",
    ),
    "start: damping": (
        "start",
        lambda: oscillator(dissipation=(damping(V, 1 / (Q - 0.3) ** 2),)),
        "is inf at the start",
    ),
    "start: observable": ("start", lambda: oscillator(observables=(observable("r", 1 / (Q - 0.3)),)), "not finite"),
    "start: position": ("start", lambda: holonomic(("unit",)).with_starts({"r[1]": 1.1}), "g(q) = 0.105"),
    "start: velocity": ("start", lambda: holonomic(("unit",)).with_starts({"w[1]": 0.1}), "Dg(q) v = 0.1"),
    "start: bar": ("start", lambda: four_particle().with_starts({"v[4]": 0.5}), "lambda[1]"),
    "symbol: J": (
        "symbol",
        lambda: oscillator(structure=(skew(Q, V, 1.0), skew(Q, V, FOREIGN))),
        "'mu' is not declared",
    ),
    "symbol: energy": (
        "symbol",
        lambda: oscillator(energies=(energy(OTHER_M * V.sx**2),), z={}),
        "of the same name",
    ),
    "symbol: energy of z": (
        "symbol",
        lambda: oscillator(energies=(energy(V.z**2),), z={}),
        "one of the costates",
    ),
    "symbol: observable": ("symbol", lambda: oscillator(observables=(observable("a", FOREIGN.sx),)), "mu"),
    "symbol: rows": ("symbol", lambda: oscillator(dissipation=(damping(FOREIGN, D),)), "stands on 'mu'"),
    "symbol: parameter row": (
        "symbol",
        lambda: oscillator(dissipation=(damping(K, D),)),
        "one of the parameters",
    ),
    "symbol: E": ("symbol", lambda: replace(r := resistive()[2], E={r.algebraics[0]: 2.0}), "algebraic"),
    "name: twice": ("name", lambda: with_variable(V, name="q"), "used 2 times"),
    "name: port": ("name", lambda: oscillator(ports=(replace(FORCE, name="q"),)), "variable 'q', port 'q'"),
    "name: form": ("name", lambda: with_variable(V, name="2 fast"), "'2 fast' is not a structured name"),
    "name: index": ("name", lambda: with_variable(V, name="v[1]"), "v[1]"),
    "name: signal": (
        "name",
        lambda: oscillator(observables=(observable("flange.velocity_step", V.sx),)),
        "2 reported",
    ),
    "name: ledger": (
        "name",
        lambda: oscillator(observables=(observable("energy.stored", V.sx),)),
        "energy.stored",
    ),
    "name: member": ("name", lambda: replace(m := two_lines(1.0), members=(*m.members, "a")), "used 2 times"),
    "name: owner": (
        "name",
        lambda: oscillator(energies=(*oscillator().energies, energy(Q.sx**2, owner="x"))),
        "'x'",
    ),
    "name: listed twice": ("name", lambda: oscillator(parameters=(M, K, D, K)), "listed twice"),
    "velocity: factor": ("velocity", lambda: holonomic(("double",)), "2 times"),
    "velocity: none": ("velocity", lambda: holonomic(("none",)), "constant"),
    "velocity: varying": ("velocity", lambda: holonomic(("varying",)), "depends on"),
    "velocity: two": ("velocity", lambda: holonomic(("unit", "turning")), "depends on"),
    "velocity: mass": ("velocity", lambda: holonomic(("unit",), E=True), "has a mass"),
    "energy: infinite": (
        "energy",
        lambda: oscillator(energies=(energy(0.5 * M * V.sx**2), energy(-ca.log(Q - 0.3)))),
        "at the start",
    ),
    "energy: gradient": (
        "energy",
        lambda: oscillator(energies=(energy(ca.sqrt(Q - 0.3)),), z={}),
        "dH/d(q) = inf",
    ),
    "energy: not quadratic": (
        "energy",
        lambda: oscillator(energies=(Energy(Q.sx**4, "quadratic"),), z={}),
        "not quadratic",
    ),
    "energy: invariant": (
        "energy",
        lambda: oscillator(energies=(strain_energy(Q.sx**3, quartic),), z={}),
        "C is not",
    ),
    "energy: phi": (
        "energy",
        lambda: oscillator(energies=(Energy(Q.sx**4, "strain", Q.sx**2, quartic),), z={}),
        "phi(C) = 0.002025",
    ),
    "energy: no phi": (
        "energy",
        lambda: oscillator(energies=(Energy(Q.sx**4, "strain"),), z={}),
        "without invariant",
    ),
    "nominal: zero": ("nominal", lambda: with_variable(V, nominal=(0.0,)), "nominal = 0"),
    "nominal: port": ("nominal", lambda: oscillator(ports=(replace(FORCE, nominal=float("nan")),)), "nan"),
    "closed: zbar": (
        "closed-pair",
        lambda: machine(zbar=lambda p: lambda x, d: p.zbar(x, d) * 1.001),
        "zbar^T ebar",
    ),
    "closed: ebar": (
        "closed-pair",
        lambda: machine(ebar=lambda p: lambda x, d: 2 * p.ebar(x, d), zbar=lambda p: lambda x, d: p.zbar(x, d) / 2),
        "E d",
    ),
    "closed: z": ("closed-pair", lambda: machine(z=lambda p: -p.z), "grad H"),
    "closed: H": ("closed-pair", lambda: machine(hamiltonian=lambda p: 2 * p.hamiltonian), "grad H"),
    "closed: energy": (
        "closed-pair",
        lambda: machine_with(energies=lambda m: (energy(m.states[1].sx ** 2),)),
        "'p'",
    ),
    "closed: twice": ("closed-pair", lambda: machine_with(closed=lambda m: m.closed * 2), "as well"),
    "solvability: loop of sources": ("solvability", two_sources, "structurally singular"),
    "solvability: no gradient": ("solvability", degenerate, "gradient of g(q) is zero"),
    "solvability: zero conductance": ("solvability", no_conductance, "singular"),
    "source: state": ("source", lambda: source(lambda i: i.sx), "depends on 'i'"),
    "unused: port": ("unused", lambda: oscillator(ports=(replace(FORCE, on={}),)), "port 'flange'"),
    "unused: zero port": ("unused", lambda: oscillator(ports=(replace(FORCE, on={V: 0}),)), "port 'flange'"),
    "unused: variable": ("unused", lonely, "'idle'"),
}


@pytest.mark.parametrize("case", BAD)
def test_a_mutation_is_caught_by_its_rule_only(case):
    rule, build, text = BAD[case]
    found = check(build())
    assert [p.rule for p in found] == [rule], "\n".join(map(str, found))
    assert text in str(found[0]), str(found[0])
    assert found[0].entry and found[0].remedy and found[0].remedy in str(found[0])


def test_every_rule_has_a_mutation():
    tried = {rule for rule, _, _ in BAD.values()}
    assert tried == {
        "skew", "symmetry", "passivity", "costate", "shape", "unit", "mass", "start", "symbol", "name",
        "velocity",
        "energy", "nominal", "closed-pair", "solvability", "source", "unused",
    }  # fmt: skip


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
