"""JAX and PyTorch: values and derivatives are those of NumPy, also of several at a time, and what is refused."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest

from phfmu import Collocated, NativeInstance, StepFunction, build_model, jax_function, torch_function
from tests.doors.crane import crane
from tests.doors.test_run_function import AT, motor

pytestmark = pytest.mark.usefixtures("compiler")


@pytest.fixture
def jax(monkeypatch: pytest.MonkeyPatch) -> Any:
    monkeypatch.setenv("JAX_PLATFORMS", "cpu")
    found = pytest.importorskip("jax", reason="JAX is not installed (extra jax)")
    found.config.update("jax_enable_x64", True)
    return found


@pytest.fixture
def torch() -> Any:
    return pytest.importorskip("torch", reason="PyTorch is not installed (extra torch)")


@pytest.fixture(scope="module")
def step() -> StepFunction:
    model = build_model(crane(), Collocated(1))
    return StepFunction(model, NativeInstance(model), 0.05, 2)


def test_jax_derives_runs(jax: Any) -> None:
    own = motor("reverse")
    f, J = jax_function(own), own.jacobian(AT)
    np.testing.assert_array_equal(jax.jit(f)(AT), own(AT))
    np.testing.assert_allclose(jax.jacrev(f)(AT), J, rtol=1e-12)
    many = np.stack([AT, 1.1 * AT])
    np.testing.assert_array_equal(jax.vmap(f)(many), [own(v) for v in many])
    slopes = jax.jit(jax.vmap(jax.grad(lambda v: (f(v) ** 2).sum())))(many)
    np.testing.assert_allclose(slopes, [2 * own(v) @ own.jacobian(v) for v in many], rtol=1e-11)


def test_jax_rolls_steps_out(jax: Any, step: StepFunction) -> None:
    """Ten steps in a scan, derived by all forces, beside the chain of matrices."""
    f = jax_function(step, ["x", "u"])

    def last(forces: Any) -> Any:
        return jax.lax.scan(lambda x, u: (f(x, u)[0], None), step.start[0], forces)[0]

    forces = np.linspace(50.0, -40.0, 10)[:, None]
    found = jax.jacrev(last)(forces)[:, :, 0]
    x, expected = step.start[0], np.zeros((4, 10))
    for k, u in enumerate(forces):
        rest = [x, u, *step.start[2:]]
        A, b = np.zeros((4, 4)), step.forward(rest, [np.zeros(4), np.ones(1), np.zeros(4), np.zeros(1)])[0]
        for j, e in enumerate(np.eye(4)):
            A[:, j] = step.forward(rest, [e, np.zeros(1), np.zeros(4), np.zeros(1)])[0]
        expected = A @ expected
        expected[:, k] = b
        x = step(x, u)[0]
    np.testing.assert_allclose(found, expected, rtol=1e-9, atol=1e-12 * np.abs(expected).max())


def test_jax_in_32_bits_is_refused(jax: Any) -> None:
    jax.config.update("jax_enable_x64", False)
    try:
        with pytest.raises(ValueError, match="JAX computes in 32 bits"):
            jax_function(motor())(AT)
    finally:
        jax.config.update("jax_enable_x64", True)


def test_torch_derives_runs_and_steps(torch: Any, step: StepFunction) -> None:
    own = motor("reverse")
    at = torch.tensor(AT, requires_grad=True)
    found = torch_function(own)(at)
    np.testing.assert_array_equal(found.detach().numpy(), own(AT))
    (found * torch.tensor([1.0, -2.0, 0.5])).sum().backward()
    np.testing.assert_allclose(at.grad.numpy(), own.jacobian(AT).T @ [1.0, -2.0, 0.5], rtol=1e-11)
    x, u = (torch.tensor(v, requires_grad=True) for v in ([0.1, 0.2, 3.0, 4.0], [5.0]))
    assert torch.autograd.gradcheck(torch_function(step, ["x", "u"]), (x.double(), u.double()))


def test_torch_in_32_bits_is_refused(torch: Any) -> None:
    with pytest.raises(TypeError, match="theta is torch.float32 on cpu; expected a tensor of torch.float64"):
        torch_function(motor())(torch.tensor(AT, dtype=torch.float32))
    with pytest.raises(TypeError, match="theta is ndarray"):
        torch_function(motor())(AT)
