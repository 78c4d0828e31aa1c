"""Units of models with constraints and with many members."""

from __future__ import annotations

import shutil
import sys

import pytest

from phfmu import (
    PHDAE,
    Domain,
    Holonomic,
    Port,
    algebraic,
    damping,
    energy,
    observable,
    parameter,
    skew,
    state,
)
from phfmu.components.electrical.rl_line import rl_line
from phfmu.components.mechanical.four_particle import four_particle
from phfmu.components.mechanical.translational import mass
from phfmu.discretise.model import Model, build_model
from phfmu.network.network import Network
from phfmu.schemes.collocated import Collocated

#: flags of the sanitizers that hosts and units are compiled with
SANITIZE = ("-fsanitize=address,undefined", "-fno-sanitize-recover=all", "-fno-omit-frame-pointer")
PULL = Domain("pull", "f", "N", "v", "m/s", "flow")


def pendulum() -> PHDAE:
    """A point mass on a rod in the plane, driven by a force: a constraint, a vector port, two observables."""
    q = state("q", 2, unit="m", start=[0.6, -0.8], description="position")
    v = state("v", 2, unit="m/s", description="velocity")
    lam = algebraic("lambda", 1, unit="N/m", description="multiplier of the rod")
    m, g = parameter("m", 1.5, unit="kg"), parameter("g", 9.81, unit="m/s2")
    return PHDAE(
        "pendulum",
        states=(q, v),
        algebraics=(lam,),
        parameters=(m, g),
        energies=(energy(0.5 * m * (v[0] ** 2 + v[1] ** 2)), energy(m.sx * g.sx * q[1])),
        E={v: m},
        structure=(skew(q, v, 1.0),),
        dissipation=(damping(v, 0.1),),
        constraints=(Holonomic(lam, 0.5 * (q[0] ** 2 + q[1] ** 2 - 1.0)),),
        ports=(Port("hand", PULL, "effort", {v: 1.0}, size=2, description="force on the mass"),),
        observables=(
            observable("length", q[0] ** 2 + q[1] ** 2, unit="m2"),
            observable("p", m * v.sx, unit="kg.m/s"),
        ),
        description="pendulum <of> a rod & a mass",
    )


def chain() -> PHDAE:
    """Two lines in series: a composed model with members and a joined port."""
    network = Network("chain")
    network.add("near", rl_line(0.3, 0.2, i=(1.0, -0.5, -0.5)))
    network.add("far", rl_line(0.1, 0.4, i=(1.0, -0.5, -0.5)))
    network.junction("bus", ["near.b", "far.a"])
    return network.compose()


MODELS = {
    "mass": (lambda: mass(2.0, k=100.0, d=0.5, q=0.1), None, 1e-2),
    "line": (lambda: rl_line(0.3, 0.2), Collocated(2), 1e-3),
    "pendulum": (pendulum, None, 5e-3),
    "four_particle": (four_particle, None, 1e-2),
    "chain": (chain, None, 1e-3),
}
#: with parameters, with ports of many entries, with constraints
QUICK = ("mass", "line", "four_particle")


def build(name: str) -> tuple[PHDAE, Model, float]:
    make, scheme, step = MODELS[name]
    declaration = make()
    return declaration, build_model(declaration, scheme), step


needs_cc = pytest.mark.skipif(not shutil.which("cc") or sys.platform != "linux", reason="needs cc on Linux")
