"""Members that are ideal switches and nothing else: no steps to take, but rows of the interface in their own unknowns.

    0 = J(s) a + B(s) u,    y = B(s)^T a,    J skew but for the rows -a of switches that are off,

s the modes.  They take no power.  Between inputs that are given a closed switch determines nothing, so such a member has no step
of its own: its unknowns a are found with those of the junctions, at the same nodes.
"""

from __future__ import annotations

from typing import Any

import casadi as ca
import numpy as np
from numpy.typing import ArrayLike, NDArray

from phfmu.declare.variable import time
from phfmu.discretise.model import Model
from phfmu.engine.instance import Signals
from phfmu.events.modes import Modes

Array = NDArray[np.float64]

#: what a step books by component, besides what ports supply
UNMOVED = ("stored", "dissipated", "numerical", "moved")


def is_relation(modes: Modes) -> bool:
    """Whether a declaration is of ideal switches and nothing else, so that it can be rows of the interface."""
    d = modes.declaration
    if not d.switches or d.states or d.dissipation or any(not p.external or p.signal for p in d.ports):
        return False
    rows, a, u, t = _rows(modes)
    matrix = ca.jacobian(rows, ca.vertcat(a, u))
    at_zero = ca.substitute(rows, ca.vertcat(a, u), ca.DM.zeros(a.numel() + u.numel()))
    varying = ca.depends_on(matrix, ca.vertcat(a, u, t))
    return not varying and bool(ca.sparsify(ca.simplify(at_zero)).nnz() == 0)


def _rows(modes: Modes) -> tuple[ca.SX, ca.SX, ca.SX, ca.SX]:
    """The rows, a, u and the time as symbols."""
    equations = modes.system.equations
    return equations.rows[3], equations.a, equations.u, time


def _product(a: Array, M: Array) -> Array:
    """a M, added term after term as compiled code does (`as_unit/runtime/relation.c`)."""
    out = np.zeros((*a.shape[:-1], M.shape[1]))
    for j, row in enumerate(M):
        out = out + a[..., j, None] * row
    return out


def _sum(values: Array) -> float:
    """The sum, added one after the other."""
    return float(np.cumsum(values)[-1]) if len(values) else 0.0


class RelationInstance(Signals):
    """Such a member as an instance that is told its values: at nodes by the interface, at instants by `tell`.

    Node inputs are [u | a] (k x (nu + na)); node outputs [y | 0].
    """

    happened = ()
    rest_changes = ()

    def __init__(self, model: Model):
        assert model.modes is not None
        self.model, self._modes = model, model.modes.modes
        rows, a, u, _ = _rows(self._modes)
        p = self._modes.system.equations.p
        self._matrix = ca.Function("rows", [p], [ca.densify(ca.jacobian(rows, ca.vertcat(u, a)))])
        self.na, self.nu = a.numel(), u.numel()
        #: names of the unknowns a, and their nominal values
        self.names = [n for v in model.declaration.algebraics for n in v.names()]
        self.nominal = self._modes.system.nominal
        step = model.step
        self._p, self._u, self.time = model.p0.copy(), model.u0.copy(), model.t0
        self._at_nodes = np.zeros((step.k, self.nu + self.na))
        self._a, self._observed = model.a0.copy(), np.zeros(len(model.observable_names))
        self._sums = np.zeros(step.nq)
        self._pairs, self._mean = np.zeros(step.nq), np.zeros(self.nu + self.na)
        self._join()

    def _join(self) -> None:
        #: B (na x nu) and J (na x na) in the present modes
        self.B, self.J = self.rows(self._p)

    def rows(self, p: Array) -> tuple[Array, Array]:
        """B and J under parameters p, modes among them."""
        found = np.array(self._matrix(p))
        return found[:, : self.nu], found[:, self.nu :]

    @property
    def modes(self) -> list[int]:
        """Parameters that are modes of its switches."""
        return list(self._modes.system.places)

    @property
    def given_by(self) -> list[str]:
        """Parameters besides the modes that its rows follow from."""
        p = self._modes.system.equations.p
        names = [n for v in self.model.declaration.parameters for n in v.names()]
        matrix = self._matrix(p)
        return [n for i, n in enumerate(names) if i not in self.modes and ca.depends_on(matrix, p[i])]

    # -- what it is told ------------------------------------------------------------------------------------------------

    def tell(self, t: float, a: Array, observed: Array) -> None:
        """Its unknowns and observables at an instant."""
        self.time, self._a, self._observed = t, a.copy(), observed[: len(self._observed)].copy()

    @property
    def unknown(self) -> Array:
        """a at the last instant that it was told of."""
        return self._a

    def set_input(self, u: ArrayLike) -> None:
        self._u = np.array(u, float)

    def set_node_inputs(self, u: Array) -> None:
        self._at_nodes = np.array(u)

    def set_parameters(self, p: ArrayLike) -> None:
        """All parameters, modes among them."""
        self._p = np.array(p, float)
        self._join()

    def initialise(self) -> None:
        """Means take the values of the instant."""
        self._mean = np.concatenate([_product(self._a, self.B), self._a])

    def step_exactly(self, t: float, h: float) -> None:
        """Books a step under the node inputs."""
        b, (u, a) = self.model.scheme.nodes.b, np.split(self._at_nodes, [self.nu], axis=1)
        y = _product(a, self.B)
        self._pairs, self._mean = h * _product(b, u * y), np.concatenate([_product(b, y), _product(b, a)])
        self._sums = self._sums + self._pairs
        self.time = t + h

    # -- an instance ----------------------------------------------------------------------------------------------------

    @property
    def x(self) -> Array:
        return np.zeros(0)

    @property
    def unknowns(self) -> Array:
        return np.zeros(0)

    @property
    def parameters(self) -> Array:
        return self._p.copy()

    @property
    def counts(self) -> dict[str, int]:
        return {"substeps": 0}

    def node_output(self) -> Array:
        y = _product(self._at_nodes[:, self.nu :], self.B)
        return np.hstack([y, np.zeros((len(y), self.na))])

    def output(self) -> Array:
        return self._mean[: self.nu].copy()

    def ledger(self) -> dict[str, Array]:
        n = self.model.step.ncomp
        return dict.fromkeys(UNMOVED, np.zeros(n)) | {
            "supplied": np.full(n, _sum(self._pairs)),
            "pairs": self._pairs.copy(),
        }

    def signals(self) -> dict[str, Array]:
        n, supplied = self.model.step.ncomp, _sum(self._sums)
        y, a = np.split(self._mean, [self.nu])
        return {
            "x": self.x, "time": np.array([self.time]), "a": a, "y_step": y, "energy": self._sums,
            "supplied": np.full(n, supplied), "dissipated": np.zeros(n), "residual": np.full(n, -supplied),
            "a_end": self._a, "y_end": _product(self._a, self.B), "observables": self._observed, "H": np.zeros(n),
        }  # fmt: skip

    def signal(self, block: str) -> Array:
        return self.signals()[block].copy()

    def get_state(self) -> Any:
        return self._p, self._u, self.time, self._at_nodes, self._a, self._observed, self._sums, self._pairs, self._mean

    def set_state(self, state: Any) -> None:
        """Restores what `get_state` gave."""
        modes = self._p
        (
            self._p, self._u, self.time, self._at_nodes, self._a, self._observed, self._sums, self._pairs, self._mean,
        ) = state  # fmt: skip
        if modes is not self._p:
            self._join()

    restore = set_state
