"""Every rule of the check of declarations catches its own mutation."""

from dataclasses import replace

import casadi as ca
import numpy as np
import pytest

from phfmu import (
    Block,
    Energy,
    Observable,
    block,
    check,
    damping,
    energy,
    observable,
    skew,
    strain_energy,
)
from phfmu.components.mechanical.four_particle import four_particle
from tests.checks.broken import (
    FOREIGN,
    NO_POWER,
    OTHER_M,
    SCALED,
    degenerate,
    lonely,
    machine,
    machine_with,
    no_conductance,
    quartic,
    two_sources,
    with_variable,
)
from tests.checks.models import FORCE, D, K, M, Q, V, holonomic, oscillator, resistive, source, two_lines

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
