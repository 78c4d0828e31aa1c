"""E of constant rank: a parametrised semi-explicit pHDAE and an unstructured rest.

A pHDAE whose E is analytic with constant rank r is, locally and up to system transformations,

    [I 0] [x1']                            [grad H1(x1)]
    [0 0] [x2'] = (J - R)(x1, x2, theta)   [z2         ]  + B(x1, x2, theta) u,   y = B^T (grad H1, z2),      (38a)

    theta' + E32(x1, x2, theta) x2' = A31 grad H1 + A32 z2 + B3 u,                                            (38b)

with E = [[I, 0, 0], [0, 0, 0], [0, E32, I]] and z = (grad H1, z2, 0).  As z_theta = 0, the rows (38b) do not enter
z^T E x' = H': A31, A32, B3, E32 are free, and whatever discretises (38b) leaves the balance of (38a) exact.
Source: Kinon, Morandin, Schulze, Appl. Numer. Math. 2026, Theorem 8, Corollary 3, Remark 11.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field, replace
from typing import Any

import casadi as ca
import numpy as np

from phfmu.declare.dense import matrices
from phfmu.declare.error import DeclarationError
from phfmu.declare.phdae import PHDAE, skew
from phfmu.declare.regular import undetermined
from phfmu.declare.transform.inverse import inverted
from phfmu.declare.variable import Variable, _sx, key, slices, time


@dataclass(frozen=True, eq=False)
class Parametrised:
    """The data of (38a) and (38b); `assembled()` is an ordinary declaration of order 2k for k Gauss nodes.

    part:   (38a), a semi-explicit declaration; J, R, B and z2 (`z` of its algebraic variables) may depend on theta
    theta:  states without energy
    E32:    algebraic variable of `part` -> (n_theta x n); absent = 0
    A:      variable of `part` -> (n_theta x n), on its costate: A31 on states, A32 on algebraic variables
    B:      port name -> (n_theta x size)

    All may depend on states, algebraic variables, theta and parameters.  With E11 of `part` other than 1, A31 acts on
    z1 = E11^-T grad H1.
    """

    part: PHDAE
    theta: tuple[Variable, ...]
    E32: Mapping[Variable, Any] = field(default_factory=dict)
    A: Mapping[Variable, Any] = field(default_factory=dict)
    B: Mapping[str, Any] = field(default_factory=dict)

    @property
    def n(self) -> int:
        """Number of entries of theta."""
        return sum(v.n for v in self.theta)

    def assembled(self) -> PHDAE:
        """One declaration with states (x1, theta) and algebraic variables x2.

        x2' is eliminated: with f2(x1, x2, theta) = 0 the rows of x2,
            x2' = -(D_x2 f2)^-1 (D_x1 f2 x1' + D_theta f2 theta'),
        and x1' is what its rows say; (38b) then reads theta' = A31~ grad H1 + A32~ z2 + B3~ u, a block of J whose
        transpose meets z_theta = 0.  DeclarationError: H depends on theta; the rows of x2 with E32 depend on inputs or
        time (x2, and theta with it, would jump); they do not determine x2 (index 2).
        """
        self._require_sound()
        A, B = self._eliminated() if self.E32 else (self._stacked(self.A), self._inputs())
        rows, structure, ports = slices(self.theta), [], []
        columns = slices((*self.part.states, *self.part.algebraics))
        for theta in self.theta:
            for v in (*self.part.states, *self.part.algebraics):
                entry = ca.sparsify(A[rows[key(theta)], columns[key(v)]])
                if entry.nnz():
                    structure.append(skew(theta, v, entry))
        at = 0
        for port in self.part.ports:
            on = dict(port.on)
            for theta in self.theta:
                entry = ca.sparsify(B[rows[key(theta)], at : at + port.n])
                if entry.nnz():
                    on[theta] = entry
            ports.append(replace(port, on=on))
            at += port.n
        return replace(
            self.part,
            states=(*self.part.states, *self.theta),
            structure=(*self.part.structure, *structure),
            ports=tuple(ports),
        )

    # -- the rows of the part as expressions --------------------------------------------------------------------------

    def _stacked(self, given: Mapping[Variable, Any]) -> ca.SX:
        """Matrices on variables as one matrix (n_theta x n_x)."""
        columns = slices((*self.part.states, *self.part.algebraics))
        out = ca.SX(self.n, sum(v.n for v in (*self.part.states, *self.part.algebraics)))
        for v, value in given.items():
            matrix = ca.SX(_sx(value))
            if key(v) not in columns or matrix.shape != (self.n, v.n):
                where = (
                    "is no variable of the part"
                    if key(v) not in columns
                    else f"is {matrix.shape}, expected {(self.n, v.n)}"
                )
                raise DeclarationError(f"{self.part.name}: the entry of (38b) on '{v.name}' {where}")
            out[:, columns[key(v)]] = matrix
        return out

    def _inputs(self) -> ca.SX:
        names = [p.name for p in self.part.ports]
        unknown = [name for name in self.B if name not in names]
        if unknown:
            raise DeclarationError(
                f"{self.part.name} has no port '{unknown[0]}' for B3; it has: {', '.join(names) or 'none'}"
            )
        parts = []
        for port in self.part.ports:
            matrix = ca.SX(_sx(self.B.get(port.name, ca.SX(self.n, port.n))))
            if matrix.shape != (self.n, port.n):
                raise DeclarationError(
                    f"{self.part.name}: B3 on port '{port.name}' is {matrix.shape}, expected {(self.n, port.n)}"
                )
            parts.append(matrix)
        return ca.horzcat(ca.SX(self.n, 0), *parts)

    def _eliminated(self) -> tuple[ca.SX, ca.SX]:
        """A~ = [A31~, A32~] and B3~ with x2' eliminated."""
        part, n1 = self.part, self.part.x.numel()
        whole = matrices(part)
        back, JR, B = inverted(whole.E), whole.J - whole.R, whole.B
        z1 = ca.mtimes(back.T, ca.gradient(part.hamiltonian, part.x))
        z2 = ca.vertcat(*(part.effort(v) for v in part.algebraics))
        f2 = ca.mtimes(JR[n1:, :], ca.vertcat(z1, z2))
        (f2,) = ca.substitute([f2], [ca.vertcat(*(v.z for v in part.states))], [z1])
        x2, theta = ca.vertcat(*(v.sx for v in part.algebraics)), ca.vertcat(*(v.sx for v in self.theta))
        self._require_held(f2, B[n1:, :])
        slope = ca.jacobian(f2, x2)
        self._require_regular("D_x2 f2, with which the rows of the algebraic variables give them,", slope)
        G = ca.mtimes(self._stacked(self.E32)[:, n1:], inverted(slope))
        N = ca.SX.eye(self.n) - ca.mtimes(G, ca.jacobian(f2, theta))
        self._require_regular("1 - E32 (D_x2 f2)^-1 D_theta f2", N)
        drive, first = ca.mtimes([G, ca.jacobian(f2, part.x), back]), inverted(N)
        A = ca.mtimes(first, self._stacked(self.A) + ca.mtimes(drive, JR[:n1, :]))
        return ca.sparsify(A), ca.sparsify(ca.mtimes(first, self._inputs() + ca.mtimes(drive, B[:n1, :])))

    # -- what is refused ----------------------------------------------------------------------------------------------

    def _require_sound(self) -> None:
        name, theta = self.part.name, ca.vertcat(*(v.sx for v in self.theta))
        if not self.theta or any(v.role != "state" for v in self.theta):
            raise DeclarationError(f"{name}: theta is a tuple of one or more states")
        if ca.depends_on(self.part.hamiltonian, theta):
            raise DeclarationError(f"{name}: H depends on theta; a variable with energy belongs to x1")
        wrong = [v.name for v in self.E32 if v.role != "algebraic"]
        if wrong:
            raise DeclarationError(
                f"{name}: E32 acts on algebraic variables, '{wrong[0]}' is a state: put E31 x1' into A31"
            )
        if self.part.constraints or self.part.closed:
            raise DeclarationError(f"{name}: the part has constraints or closed-form pairs; write it without them")

    def _require_held(self, f2: ca.SX, B2: ca.SX) -> None:
        u = ca.vertcat(ca.SX(0, 1), *(p.u for p in self.part.ports))
        what = (
            "a port acts on them" if B2.nnz() else "they depend on inputs" if u.numel() and ca.depends_on(f2, u) else ""
        )
        what = what or ("they depend on time" if ca.depends_on(f2, time) else "")
        if what:
            raise DeclarationError(
                f"{self.part.name}: with E32 the rows of the algebraic variables must be free of inputs and time, but {what}: "
                "x2 would jump with the input, and theta with it; feed the input through a state"
            )

    def _require_regular(self, what: str, matrix: ca.SX) -> None:
        variables = (*self.part.states, *self.part.algebraics, *self.theta, *self.part.parameters)
        start = np.array([s for v in variables for s in v.start])
        f = ca.Function("m", [ca.vertcat(*(v.sx for v in variables))], [ca.densify(matrix)])
        value = np.array(f(start))
        if undetermined(value) >= 0:
            raise DeclarationError(
                f"{self.part.name}: {what} is singular at the start ({np.array2string(value, precision=3)}); the form "
                "(38) needs algebraic variables of index 1"
            )
