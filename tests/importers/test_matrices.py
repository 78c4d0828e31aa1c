"""Linear port-Hamiltonian systems given by matrices: the declaration, what is refused, and the exact solution."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest
import scipy.sparse as sp
from scipy.linalg import expm

from phfmu import (
    TRANSLATIONAL,
    Collocated,
    DeclarationError,
    NativeInstance,
    Port,
    PythonInstance,
    build_model,
    check,
    default_scheme,
    export,
    state,
)
from phfmu.importers import matrices
from tests.wide import wide

Array = np.ndarray


def random_system(n: int, m: int, seed: int, rank: int | None = None) -> dict[str, Array]:
    """A full system; E of rank `rank` has kernels along no coordinate axis, and Q is none of the identity."""
    rng = np.random.default_rng(seed)
    A, L = rng.standard_normal((n, n)), rng.standard_normal((n + m, n + m)) / np.sqrt(n)
    W, skew = L @ L.T, rng.standard_normal((m, m))
    left, right = (np.linalg.qr(rng.standard_normal((n, n)))[0] for _ in range(2))
    kept = np.arange(n) < (n if rank is None else rank)
    H = np.diag(rng.uniform(0.5, 2.0, n))
    # E = U diag(kept) V^T, Q = U H V^T: E^T Q = V diag(kept) H V^T
    return {
        "E": left @ np.diag(kept * 1.0) @ right.T, "Q": left @ H @ right.T, "J": A - A.T, "R": W[:n, :n],
        "G": rng.standard_normal((n, m)), "P": W[:n, n:], "S": W[n:, n:], "N": skew - skew.T,
    }  # fmt: skip


def exact(s: dict[str, Array], x: Array, u: Array, t: float) -> tuple[Array, Array]:
    """x(t) and y(t) for a constant input by the matrix exponential; the kernel of E is eliminated first."""
    U, sigma, Vt = np.linalg.svd(s["E"])  # all of 1 or 0
    r = int(np.count_nonzero(sigma > 1e-9))
    A, B = U.T @ (s["J"] - s["R"]) @ s["Q"] @ Vt.T, U.T @ (s["G"] - s["P"]) @ u
    inner = np.linalg.solve(A[r:, r:], np.column_stack([A[r:, :r], B[r:]]))  # x2 = -inner [x1; 1]
    rate, drift = A[:r, :r] - A[:r, r:] @ inner[:, :-1], B[:r] - A[:r, r:] @ inner[:, -1]
    whole = np.block([[rate, drift[:, None]], [np.zeros((1, r + 1))]])
    x1 = (expm(t * whole) @ np.append((Vt @ x)[:r], 1.0))[:r]
    end = Vt.T @ np.append(x1, -inner @ np.append(x1, 1.0))
    return end, (s["G"] + s["P"]).T @ s["Q"] @ end + (s["S"] - s["N"]) @ u


@pytest.mark.parametrize(
    ("n", "rank", "coordinates"), [(6, None, "given"), (6, None, "energy"), (6, 4, "given"), (6, 4, "energy")]
)
def test_a_full_system_follows_the_exponential(n: int, rank: int | None, coordinates: Any) -> None:
    """All eight matrices, E regular and singular, against expm: order 4 and its constant at two steps."""
    s, x0, u = random_system(n, 2, 3, rank), np.linspace(-1, 1, n), np.array([0.7, -0.4])
    model = matrices(**s, states=[state("w", n, start=x0)], coordinates=coordinates)
    assert check(model) == []
    end, y = exact(s, x0, u, 1.0)
    errors = []
    for steps in (20, 40):
        unit = PythonInstance(build_model(model, Collocated(2)))
        rows = unit.run(0.0, 1.0 / steps, steps, ("stored", "dissipated", "supplied"), inputs=[u] * steps)
        assert abs(rows["stored"] + rows["dissipated"] - rows["supplied"]).max() < 1e-13
        now = unit.signals()
        got = np.append(unit.x if model.observables == () else now["observables"][:n], now["y_end"])
        errors.append(np.abs(got - np.append(end, y)).max())
    assert errors[1] < 1e-6 and 3.7 < np.log2(errors[0] / errors[1]) < 4.3


def test_the_energy_is_that_of_the_matrices() -> None:
    s, x0 = random_system(5, 1, 4), np.arange(5.0)
    for coordinates in ("given", "energy"):
        model = matrices(**s, states=[state("w", 5, start=x0)], coordinates=coordinates)
        unit = PythonInstance(build_model(model))
        assert unit.signals()["H"].sum() == pytest.approx(0.5 * x0 @ s["E"].T @ s["Q"] @ x0, rel=1e-13)


def chain(k: int, seed: int | None = None) -> dict[str, Any]:
    """k masses on springs and dampers between two walls, positions then momenta; all equal, or drawn."""
    rng = np.random.default_rng(seed)
    springs, dampers, masses = (np.ones(j) if seed is None else rng.uniform(0.5, 2.0, j) for j in (k + 1, k + 1, k))
    D = sp.diags([np.ones(k), -np.ones(k)], [0, -1], shape=(k + 1, k))  # elongations
    zero, one = sp.csc_matrix((k, k)), sp.eye(k)
    return {
        "J": sp.bmat([[None, one], [-one, None]]), "R": sp.block_diag([zero, 0.1 * D.T @ sp.diags(dampers) @ D]),
        "Q": sp.block_diag([100.0 * D.T @ sp.diags(springs) @ D, sp.diags(1 / masses)]),
        "G": sp.csc_matrix(([1.0], ([2 * k - 1], [0])), (2 * k, 1)),
    }  # fmt: skip


CHAIN_PORT = Port("tip", TRANSLATIONAL, "effort", {})


def chain_states(k: int) -> list[Any]:
    return [state("q", k, unit="m", nominal=0.1), state("p", k, unit="kg.m/s")]


def test_names_units_and_ports_are_those_given() -> None:
    model = matrices(**chain(3), name="chain", states=chain_states(3), ports=[CHAIN_PORT])
    assert [(v.name, v.unit, v.nominal[0]) for v in model.states] == [("q", "m", 0.1), ("p", "kg.m/s", 1.0)]
    assert model.port("tip").input_names() == ["tip.force"] and model.port("tip").output_names() == ["tip.velocity"]
    assert check(model) == [] and model.observables == ()
    plain = matrices(**chain(3))
    assert [v.names()[0] for v in plain.states] == ["x[1]"] and plain.ports[0].input_names() == ["port.u"]
    assert check(plain, strict=True) == []


@pytest.mark.parametrize("seed", wide([None, 1]))
def test_a_long_chain_keeps_its_equations_and_short_code(seed: int | None) -> None:
    """Springs of 200 masses as a sum: the same rates as the matrices, few functions, none of them long."""
    k = 200
    s = chain(k, seed)
    built = build_model(matrices(**s, states=chain_states(k), ports=[CHAIN_PORT]))
    x, u, h = np.random.default_rng(2).standard_normal(2 * k), np.array([0.3]), 1e-3
    unit = PythonInstance(built)
    unit.set_x(0.0, x)
    unit.run(0.0, h, 1, (), inputs=[u])
    A, B = ((s["J"] - s["R"]) @ s["Q"]).toarray(), s["G"].toarray()
    one = np.eye(2 * k)  # the implicit midpoint rule, which a quadratic energy makes of order 2
    expected = np.linalg.solve(one - h / 2 * A, (one + h / 2 * A) @ x + h * B @ u)
    assert np.abs(unit.x - expected).max() < 1e-12 * np.abs(x).max()
    kernels = {kernel.name: kernel for kernel in built.kernels}.values()
    assert len(kernels) < 20 and max(kernel.function.n_instructions() for kernel in kernels) < 3000


@pytest.mark.slow
def test_a_dense_system_has_one_function_for_all_energies(compiler: None) -> None:
    """100 states, all matrices full: as many small functions as rates of dissipation, and the exact solution."""
    s, x0 = random_system(100, 2, 5), np.ones(100)
    s["J"] /= 10
    model = matrices(**{k: s[k] for k in "EQJRG"}, states=[state("w", 100, start=x0)])
    assert [v.name for v in model.states] == ["xi"]
    built = build_model(model, Collocated(2))
    assert max(k.function.n_instructions() for g in built.step.groups for k in [g.kernel]) < 3000
    unit = PythonInstance(built)
    unit.run(0.0, 0.01, 10, (), inputs=[[0.5, 0.1]] * 10)
    s |= {"P": 0 * s["P"], "S": 0 * s["S"], "N": 0 * s["N"]}
    end, y = exact(s, x0, np.array([0.5, 0.1]), 0.1)
    now = unit.signals()
    assert np.abs(now["observables"][:100] - end).max() < 1e-6 * np.abs(end).max()


def test_states_without_e_become_algebraic_under_their_names() -> None:
    """Two capacitors joined by a resistor, node voltages of a third node algebraic: index 1, E = diag(C1, C2, 0)."""
    g = np.array([[2.0, 0.0, -2.0], [0.0, 1.0, -1.0], [-2.0, -1.0, 3.0]])
    B = np.array([[1.0], [0.0], [0.0]])
    volts = [state("v", 2, unit="V", start=(1.0, 0.0)), state("node", unit="V")]
    model = matrices(np.zeros((3, 3)), g, B, E=np.diag([1e-2, 2e-2, 0.0]), states=volts)
    assert [v.name for v in model.states] == ["v"] and [v.name for v in model.algebraics] == ["node"]
    assert check(model) == [] and model.observables == ()
    mixed = matrices(
        np.zeros((3, 3)), g, B, E=np.diag([1e-2, 2e-2, 0.0]), states=[state("v", 3, start=(1.0, 0.0, 0.0))]
    )
    assert [v.name for v in (*mixed.states, *mixed.algebraics)] == ["v.differential", "v.algebraic"]
    ends = []
    for m in (model, mixed):
        unit = PythonInstance(build_model(m, Collocated(3)))
        unit.run(0.0, 1e-3, 10, (), inputs=[[0.2]] * 10)
        ends.append(np.append(unit.x, unit.signals()["a_end"]))
    C = np.diag([1e-2, 2e-2])
    eliminated = g[:2, :2] - g[:2, 2:] @ g[2:, :2] / 3.0  # the star point at the node
    A = np.block([[-np.linalg.solve(C, eliminated), np.linalg.solve(C, 0.2 * B[:2])], [np.zeros((1, 3))]])
    v = (expm(A * 1e-2) @ [1.0, 0.0, 1.0])[:2]
    assert np.abs(ends[0] - np.append(v, (2 * v[0] + v[1]) / 3)).max() < 1e-9
    assert np.abs(ends[0] - ends[1]).max() < 1e-12


def test_a_velocity_constraint_is_a_multiplier() -> None:
    """Two masses moving as one, v1 = v2: E = diag(m1, m2, 0), J = [0, b; -b^T, 0]; both get f / (m1 + m2)."""
    J = np.array([[0, 0, 1.0], [0, 0, -1.0], [-1.0, 1.0, 0]])
    pull = np.array([[1.0], [0.0], [0.0]])
    model = matrices(J, None, pull, E=np.diag([1.0, 3.0, 0.0]), states=[state("v", 2), state("force")])
    assert check(model) == []
    unit = PythonInstance(build_model(model, default_scheme(model)))
    unit.run(0.0, 0.1, 10, (), inputs=[[8.0]] * 10)
    assert np.abs(unit.x - 2.0).max() < 1e-12


def test_states_without_energy_are_stepped() -> None:
    """A free mass: Q of its position is zero, so q has no effort and p' = u."""
    J = np.array([[0.0, 1.0], [-1.0, 0.0]])
    for coordinates in ("given", "energy"):
        model = matrices(
            J, None, [0.0, 1.0], Q=np.diag([0.0, 0.5]), states=[state("q"), state("p")], coordinates=coordinates
        )
        assert check(model) == []
        unit = PythonInstance(build_model(model, Collocated(2)))
        unit.run(0.0, 0.1, 10, (), inputs=[[1.0]] * 10)
        found = unit.x if coordinates == "given" else unit.signals()["observables"][:2]
        assert np.abs(found - [0.25, 1.0]).max() < 1e-13


GOOD = {"J": np.array([[0.0, 1.0], [-1.0, 0.0]]), "R": np.diag([0.0, 1.0]), "G": np.array([[0.0], [1.0]])}


@pytest.mark.parametrize(
    ("changed", "words"),
    [
        (
            {"J": np.array([[0.0, 1.0], [-0.9, 0.0]])},
            ["J: is not skew-symmetric: [q, p] = 1, [p, q] = -0.9", "into -R"],
        ),
        (
            {"R": np.array([[1.0, 2.0], [2.0, 1.0]])},
            ["R: is not positive semidefinite", "= -1 for v = 0.707", "0.707 q"],
        ),
        ({"R": np.array([[1.0, 0.5], [0.0, 1.0]])}, ["R: is not symmetric: [q, p] = 0.5, [p, q] = 0"]),
        ({"P": np.array([[0.5], [0.0]])}, ["[R, P; P^T, S]: is not positive semidefinite: v^T M v = -0.5", "port.u"]),
        ({"S": np.array([[-2.0]])}, ["[R, P; P^T, S]: is not positive semidefinite: v^T M v = -2 for v = 1 port.u"]),
        ({"N": np.array([[1.0]])}, ["N: is not skew-symmetric: [port.u, port.u] = 1"]),
        ({"Q": np.diag([2.0, -3.0])}, ["E^T Q: is not positive semidefinite: v^T M v = -3 for v = 1 p", "H = 1/2"]),
        ({"Q": np.array([[1.0, 0.2], [0.0, 1.0]])}, ["E^T Q: is not symmetric: [q, p] = 0.2, [p, q] = 0"]),
        ({"E": np.diag([1.0, 0.0]), "Q": np.diag([1.0, 0.0])}, ["E v = 0 and Q v = 0 for v = 1 p", "leave them out"]),
        ({"G": np.ones((3, 1))}, ["G: is 3 x 1, expected 2 x 1"]),
        ({"R": np.array([[0.0, np.nan], [0.0, 1.0]])}, ["R: its entry [1, 2] is nan"]),
        ({"R": "x"}, ["R: is no matrix of real numbers"]),
        ({"J": np.array([[0.0, 1j], [-1j, 0.0]])}, ["J: is no matrix of real numbers (it is complex)"]),
        ({"states": [state("q", 3)]}, ["states: they have 3 entries (q: 3), J has 2 rows"]),
        (
            {"ports": [Port("a", TRANSLATIONAL, "effort", {}, size=2)]},
            ["ports: they have 2 inputs (a: 2), G has 1 columns"],
        ),
    ],
)
def test_what_does_not_fit_is_refused_by_name(changed: dict[str, Any], words: list[str]) -> None:
    with pytest.raises(DeclarationError) as error:
        matrices(**({**GOOD, "states": [state("q"), state("p")]} | changed))
    assert all(w in str(error.value) for w in words), str(error.value)


def test_all_that_is_wrong_is_told_at_once() -> None:
    with pytest.raises(DeclarationError) as error:
        matrices(np.eye(2), np.array([[1.0, 0.5], [0.0, 1.0]]), [0.0, 1.0])
    assert [(p.entry, p.rule) for p in error.value.problems] == [("linear: J", "skew"), ("linear: R", "symmetry")]


@pytest.mark.parametrize("k", wide([5, 300], 5))
def test_one_damper_of_the_wrong_sign_is_found_in_a_chain(k: int) -> None:
    """Small parts are diagonalised, large ones factorised: both name the masses beside the damper."""
    s = chain(k)
    R = sp.lil_matrix(s["R"])
    i, j = k + 2, k + 3
    R[i, i] -= 0.5
    R[j, j] -= 0.5
    R[i, j] += 0.5
    R[j, i] += 0.5
    with pytest.raises(
        DeclarationError, match=r"R: is not positive semidefinite.*= 0\.\d+ p\[[34]\] - 0\.\d+ p\[[34]\]"
    ):
        matrices(s["J"], R, s["G"], Q=s["Q"], states=chain_states(k))


def test_rounding_is_no_reason_to_refuse() -> None:
    s = random_system(20, 2, 8)
    rng = np.random.default_rng(1)
    noisy = {k: v * (1 + 1e-14 * rng.standard_normal(v.shape)) for k, v in s.items()}
    assert check(matrices(**noisy)) == []


def test_a_system_without_ports_keeps_its_energy() -> None:
    unit = PythonInstance(build_model(matrices(GOOD["J"], None, states=[state("q", start=1.0), state("p")])))
    unit.run(0.0, 0.1, 100, ())
    assert abs(unit.signals()["H"].sum() - 0.5) < 1e-14


def test_units_do_not_count_in_what_is_semidefinite() -> None:
    """Rows in pascal beside rows in metres: a small negative eigenvalue is told, a large scale is not."""
    scale = np.diag([1e9, 1.0, 1e-6])
    good = scale @ np.array([[2.0, -1, 0], [-1, 2, -1], [0, -1, 2]]) @ scale
    bad = scale @ np.array([[2.0, -1, 0], [-1, 2, -3], [0, -3, 2]]) @ scale
    assert matrices(np.zeros((3, 3)), good)
    with pytest.raises(DeclarationError, match="R: is not positive semidefinite"):
        matrices(np.zeros((3, 3)), bad)


def test_a_chain_becomes_a_unit_that_other_tools_run(compiler: None, tmp_path: Any) -> None:
    """Matrices -> declaration -> FMU -> FMPy, against the exponential for a constant force."""
    from fmpy import simulate_fmu

    s = chain(4, 2)
    model = matrices(**s, name="chain", states=chain_states(4), ports=[CHAIN_PORT])
    built = build_model(model, Collocated(2))
    native = NativeInstance(built)
    native.run(0.0, 0.01, 50, (), inputs=[[1.0]] * 50)
    (file,) = export(built, tmp_path, ("2.0",), step=0.01)
    rows = simulate_fmu(str(file), stop_time=0.5, output_interval=0.01, start_values={"tip.force": 1.0},
                        output=["q[4]", "tip.velocity"])  # fmt: skip
    A, b = ((s["J"] - s["R"]) @ s["Q"]).toarray(), s["G"].toarray()
    x = (expm(0.5 * np.block([[A, b], [np.zeros((1, 9))]])) @ np.append(np.zeros(8), 1.0))[:8]
    assert rows["q[4]"][-1] == pytest.approx(x[3], rel=1e-5) and native.x[3] == pytest.approx(x[3], rel=1e-5)
    assert rows["tip.velocity"][-1] == pytest.approx((s["Q"] @ x)[7], rel=1e-4)
