"""A run or a step as a function of CasADi, with forward and reverse derivatives, so that Opti and its solvers take it."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import casadi as ca
import numpy as np

from phfmu.doors.function import Differentiable, restricted
from phfmu.doors.step_function import CALLED, StepFunction, plain


def casadi_function(of: Differentiable | StepFunction, free: Sequence[str] | None = None) -> ca.Function:
    """A Function of the blocks of a `RunFunction` or `StepFunction`, called by their names.

    free:  the arguments that it has, in their order; others are what the model declares (default: it has all)
    Of a step it has derivatives of any order, the second ones that IPOPT takes among them, and sparse matrices.  Of a run it has
    the first ones: give a solver `hessian_approximation: limited-memory`.  It lives as long as the process.
    Errors: KeyError for an argument that there is not.
    """
    own = restricted(of, free)
    chosen = [b.name for b in own.inputs]
    symbols = {b.name: ca.MX.sym(b.name, b.n) for b in own.inputs}
    if isinstance(of, StepFunction):
        given = [symbols.get(b.name, ca.MX(ca.DM(v))) for b, v in zip(of.inputs, of.start, strict=True)]
        results = of.function.call(given)
    else:
        results = _Values(own).call(list(symbols.values()))
    return ca.Function(plain(of.name), list(symbols.values()), results, chosen, [b.name for b in of.outputs])


class _Values(ca.Callback):
    """Values of a function of arrays; its derivatives are called as well."""

    def __init__(self, of: Differentiable):
        ca.Callback.__init__(self)
        self._of = of
        self.construct(plain(of.name), {})
        CALLED.append(self)

    def get_n_in(self) -> int:
        return len(self._of.inputs)

    def get_n_out(self) -> int:
        return len(self._of.outputs)

    def get_sparsity_in(self, i: int) -> ca.Sparsity:
        return ca.Sparsity.dense(self._of.inputs[i].n, 1)

    def get_sparsity_out(self, i: int) -> ca.Sparsity:
        return ca.Sparsity.dense(self._of.outputs[i].n, 1)

    def eval(self, arg: Sequence[ca.DM]) -> list[ca.DM]:
        return [ca.DM(v) for v in self._of.values(*map(_flat, arg))]

    def has_forward(self, nfwd: int) -> bool:
        return True

    def get_forward(self, nfwd: int, name: str, inames: Any, onames: Any, opts: Any) -> ca.Function:
        return _Product(self, self._of, nfwd, name, False)

    def has_reverse(self, nadj: int) -> bool:
        return True

    def get_reverse(self, nadj: int, name: str, inames: Any, onames: Any, opts: Any) -> ca.Function:
        return _Product(self, self._of, nadj, name, True)


class _Product(ca.Callback):
    """J times n seeds (forward), or J^T times n (back): of (arguments, results, seeds)."""

    def __init__(self, whole: _Values, of: Differentiable, n: int, name: str, back: bool):
        ca.Callback.__init__(self)
        self._of, self._n, self._back = of, n, back
        given, found = [b.n for b in of.inputs], [b.n for b in of.outputs]
        self._seeds, self._found = (found, given) if back else (given, found)
        self._shapes = [(k, 1) for k in (*given, *found)] + [(k, n) for k in self._seeds]
        self.construct(name, {})
        CALLED.append(self)

    def get_n_in(self) -> int:
        return len(self._shapes)

    def get_n_out(self) -> int:
        return len(self._found)

    def get_sparsity_in(self, i: int) -> ca.Sparsity:
        return ca.Sparsity.dense(*self._shapes[i])

    def get_sparsity_out(self, i: int) -> ca.Sparsity:
        return ca.Sparsity.dense(self._found[i], self._n)

    def eval(self, arg: Sequence[ca.DM]) -> list[ca.DM]:
        n = len(self._of.inputs)
        given, seeds = [_flat(a) for a in arg[:n]], [np.array(a, float) for a in arg[-len(self._seeds) :]]
        product = self._of.reverse if self._back else self._of.forward
        columns = [product(given, [s[:, i] for s in seeds]) for i in range(self._n)]
        return [ca.DM(np.column_stack(own)) for own in zip(*columns, strict=True)]


def _flat(value: ca.DM) -> np.ndarray:
    return np.array(value, float).reshape(-1)
