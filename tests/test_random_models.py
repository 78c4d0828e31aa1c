"""Random port-Hamiltonian systems: sound by check, exact balance with every scheme, Python = native, mutants caught.

Coefficients are parameters, so that a structure is discretised and compiled once and every example only sets numbers.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from functools import cache
from itertools import product

import casadi as ca
import numpy as np
import pytest
from hypothesis import Phase, given, settings
from hypothesis import strategies as st
from hypothesis.extra.numpy import arrays

import phfmu as ph
from phfmu import PHDAE, Collocated, NativeInstance, Port, PythonInstance, block, build_model, check, energy
from phfmu.gradients.gradient_names import GRADIENTS
from tests.wide import wide

N = 4  # states x (2) and y (2)


@dataclass(frozen=True)
class Structure:
    """What kind of system: algebraic variables, dependence on the state, E of x, energies, a source."""

    algebraic: bool
    varying: bool
    mass: str
    energies: str
    source: bool = False


STRUCTURES = {
    "ode": Structure(False, False, "identity", "quadratic"),
    "ode varying": Structure(False, True, "diagonal", "smooth"),
    "ode strain": Structure(False, True, "varying", "strain"),
    "index 1": Structure(True, False, "full", "quartic"),
    "index 1 varying": Structure(True, True, "varying", "smooth", source=True),
    "index 1 strain": Structure(True, True, "diagonal", "strain", source=True),
}
SCHEMES = {f"order {2 * k}": Collocated(k) for k in (1, 2, 3)}
SCHEMES |= {g: Collocated(1, gradient=g) for g in GRADIENTS if g != "per-term"}
#: cases of both engines
COMPILED = wide(
    product(STRUCTURES, ("order 2", "order 4", "order 6")),
    *(("ode", "order 2"), ("index 1 varying", "order 4")),
)
#: each structure and each scheme
CLOSED = wide(
    product(STRUCTURES, SCHEMES),
    *product(("index 1 varying",), SCHEMES),
    *product(STRUCTURES, ("order 2",)),
    *(("index 1 strain", "order 6"), ("ode strain", "order 4")),
)
STEP = 0.05
PHASES = [Phase.explicit, Phase.reuse, Phase.generate]  # 150 coefficients are not worth shrinking


class Coefficients:
    """Parameters handed out in pieces; all of them lie in [-1, 1]."""

    def __init__(self, n: int):
        self.p, self.used = ph.parameter("p", np.linspace(-1.0, 1.0, n), n), 0

    def take(self, rows: int, columns: int = 1) -> ca.SX:
        n = rows * columns
        self.used += n
        return ca.reshape(self.p[self.used - n : self.used], rows, columns)


def energies_of(kind: str, x: ph.Variable, y: ph.Variable, c: Coefficients) -> tuple[ph.Energy, ...]:
    """A positive definite quadratic part, and what the kind adds."""
    z, root = ca.vertcat(x.sx, y.sx), c.take(N, N)
    base = energy(ca.sumsqr(z) + ca.sumsqr(ca.mtimes(root, z)) / 4)
    k = c.take(2)
    if kind == "quadratic":
        return (base,)
    if kind == "quartic":
        return base, energy(k[0] ** 2 * (x[0] - y[1]) ** 4 / 4 + k[1] * x[1] ** 2 * y[0])
    if kind == "smooth":
        return base, energy(k[0] * ca.cos(x[0] + y[1]), correct=(x, y)), energy(ca.exp(k[1] * y[0]))
    return (
        base,
        ph.strain_energy(ca.sumsqr(x - y), lambda s: k[0] ** 2 * (s - 1) ** 2),
        ph.strain_energy(ca.sumsqr(x), lambda s: k[1] * ca.sqrt(1 + s)),
    )


def mass_of(kind: str, x: ph.Variable, c: Coefficients) -> ca.SX:
    """E of x: regular for all coefficients."""
    e = c.take(2, 2)
    return {
        "identity": ca.SX.eye(2),
        "diagonal": ca.diag(2 + ca.diag(e)),
        "full": 2.5 * ca.SX.eye(2) + e,
        "varying": 2.5 * ca.SX.eye(2) + e * ca.cos(x[0] + x[1]),
    }[kind]


@cache
def declaration(name: str) -> PHDAE:
    s, c = STRUCTURES[name], Coefficients(150)
    x, y = ph.state("x", 2, start=[0.4, -0.3]), ph.state("y", 2, start=[0.2, 0.5])
    a = ph.algebraic("a", 2)
    variables = [x, y, a] if s.algebraic else [x, y]
    n = 6 if s.algebraic else 4
    energies, mass = energies_of(s.energies, x, y, c), mass_of(s.mass, x, c)
    free, root, b = c.take(n, n), c.take(n, n), c.take(n, 2)
    if s.varying:
        free = free * (1 + ca.sin(x[0])) + c.take(n, n) * y[1]
        root = root * (1 + 0.3 * y[0])
        b = b * (1 + x[1] ** 2)
    R = ca.mtimes(root, root.T) / n
    if s.algebraic:
        # each law depends on its own variable, so that the algebraic equations are monotone and have one solution
        R[4:, 4:] += ca.diag(1 + a.sx**2 + x[0] ** 2) if s.varying else ca.SX.eye(2)
    port = {v: b[2 * i : 2 * i + 2, :1] for i, v in enumerate(variables)}
    other = {v: b[2 * i : 2 * i + 2, 1:] for i, v in enumerate(variables)}
    source = ca.sin(3 * ph.time) * c.p[0] if s.source else None
    return PHDAE(
        "random",
        states=(x, y),
        algebraics=(a,) if s.algebraic else (),
        parameters=(c.p,),
        energies=energies,
        E={x: mass} if s.mass != "identity" else {},
        structure=(block(variables, free - free.T),),
        dissipation=(block(variables, R),),
        ports=(
            Port("first", ph.ELECTRICAL, "effort", port),
            Port("second", ph.ELECTRICAL, "flow", other, source=source),
        ),
    )


@cache
def plan(name: str, scheme: str):
    return build_model(declaration(name), SCHEMES[scheme])


@cache
def engine(name: str, scheme: str, native: bool):
    return (NativeInstance if native else PythonInstance)(plan(name, scheme))


unit = st.integers(-1000, 1000).map(lambda i: i / 1000)
numbers = arrays(float, 150, elements=unit)
starts = arrays(float, N, elements=unit)
seeds = st.integers(0, 2**32 - 1)


def drive(instance, p, x, seed, n=4) -> dict[str, np.ndarray]:
    """States, outputs and ledgers of n steps with random inputs at the nodes, from a given start."""
    plan_ = instance.model.step
    rng = np.random.default_rng(seed)
    instance.reset()
    instance.set_parameters(p)
    instance.set_x(0.0, x)
    instance.set_input(np.zeros(plan_.nu))
    instance.initialise()
    rows: dict[str, list] = {"x": [], "y": []}
    for i in range(n):
        instance.set_node_inputs(rng.uniform(-1.0, 1.0, (plan_.k, plan_.nu)))
        instance.do_step(STEP * i, STEP)
        rows["x"].append(instance.x)
        rows["y"].append(instance.node_output())
        for what, values in instance.ledger().items():
            rows.setdefault(what, []).append(values)
    return {what: np.array(values) for what, values in rows.items()}


def gap(rows) -> np.ndarray:
    """Defect of the balance of each step, relative to the energies that moved (1e-3 J at least)."""
    moved = sum(np.abs(rows[r]).sum(axis=1) for r in ("stored", "dissipated", "supplied", "pairs"))
    total = rows["stored"].sum(axis=1) + rows["dissipated"].sum(axis=1) - rows["supplied"].sum(axis=1)
    return np.abs(total) / (1e-3 + moved)


@pytest.mark.parametrize(("name", "scheme"), CLOSED)
@settings(max_examples=4, deadline=None, phases=PHASES)
@given(p=numbers, x=starts, seed=seeds)
def test_every_scheme_closes_the_balance(name, scheme, p, x, seed):
    rows = drive(engine(name, scheme, False), p, x, seed)
    assert np.max(gap(rows)) <= 1e-12
    assert np.min(rows["dissipated"]) >= -1e-15
    assert rows["supplied"].sum() == pytest.approx(rows["pairs"].sum(), rel=1e-12, abs=1e-15)


@pytest.mark.parametrize(("name", "scheme"), COMPILED)
@settings(max_examples=8, deadline=None, phases=PHASES)
@given(p=numbers, x=starts, seed=seeds)
def test_engines_agree_and_the_native_ledger_closes(name, scheme, p, x, seed):
    python, native = (drive(engine(name, scheme, how), p, x, seed) for how in (False, True))
    assert np.max(gap(native)) <= 1e-12
    for what, values in python.items():
        size = 1e-3 + np.max(np.abs(values), initial=0.0)
        assert np.max(np.abs(native[what] - values), initial=0.0) <= 1e-10 * size, what


@pytest.mark.parametrize("name", wide(STRUCTURES, "index 1 varying"))
@settings(max_examples=5, deadline=None, phases=PHASES)
@given(p=numbers, x=starts)
def test_check_finds_nothing_to_complain_about(name, p, x):
    assert list(map(str, check(with_numbers(name, p, x)))) == []


def with_numbers(name: str, p, x) -> PHDAE:
    """The declaration with these coefficients and start."""
    values = {f"p[{i + 1}]": float(v) for i, v in enumerate(p)}
    values |= {f"{v}[{i + 1}]": float(x[2 * j + i]) for j, v in enumerate("xy") for i in range(2)}
    return declaration(name).with_starts(values)


# -- mutants --------------------------------------------------------------------------------------------------


def mutant(model: PHDAE, rule: str, i: int, j: int, size: float) -> PHDAE:
    """One entry of J, R or one start value made wrong."""
    (J,), (R,) = model.structure, model.dissipation
    bump = ca.SX.zeros(*J.matrix.shape)
    bump[i, j] = size
    if rule == "skew":
        return replace(model, structure=(block(J.variables, J.matrix + bump),))
    if rule == "symmetry":
        return replace(model, dissipation=(block(R.variables, R.matrix + bump),))
    loss = 30.0 * ca.SX.eye(R.matrix.shape[0])
    return replace(model, dissipation=(block(R.variables, R.matrix - loss),))


@pytest.mark.parametrize("rule", ["skew", "symmetry", "passivity"])
@pytest.mark.parametrize("name", wide(STRUCTURES, "index 1 varying"))
@settings(max_examples=4, deadline=None, phases=PHASES)
@given(p=numbers, x=starts, place=st.tuples(st.integers(0, 3), st.integers(0, 3)), size=st.floats(0.01, 10.0))
def test_check_catches_mutants(name, rule, p, x, place, size):
    if rule == "symmetry" and place[0] == place[1]:
        place = (0, 1)
    found = {problem.rule for problem in check(mutant(with_numbers(name, p, x), rule, *place, size))}
    assert rule in found and found <= {"skew", "symmetry", "passivity", "solvability"}


@pytest.mark.parametrize("name", STRUCTURES)
def test_the_ledger_sees_a_matrix_that_is_not_skew(name):
    """What check would have refused shows as a defect of the balance, of the size of z_i z_j h."""
    model = build_model(mutant(declaration(name), "skew", 0, 2, 1.0))
    rows = drive(PythonInstance(model), np.linspace(-1, 1, 150), np.array([0.4, -0.3, 0.2, 0.5]), 1)
    assert np.max(gap(rows)) > 1e-4
