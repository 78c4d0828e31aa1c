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

from collections.abc import Iterator, Mapping
from dataclasses import dataclass, field, replace
from typing import Any

import casadi as ca
import numpy as np

from phfmu.declare.block import skew
from phfmu.declare.entries.matrices import matrices
from phfmu.declare.error import DeclarationError, Problem
from phfmu.declare.phdae import PHDAE
from phfmu.declare.transform.inverse import inverted
from phfmu.declare.transform.regular import undetermined
from phfmu.declare.variable import Variable, VariableKind, _sx, key, slices, time


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
            out[:, columns[key(v)]] = ca.SX(_sx(value))
        return out

    def _inputs(self) -> ca.SX:
        parts = [ca.SX(_sx(self.B.get(port.name, ca.SX(self.n, port.n)))) for port in self.part.ports]
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
        found = [*self._out_of_form()]
        if self.theta:  # without it no shape is right
            found += [*self._misplaced(), *self._misshapen_inputs()]
        if found:
            raise DeclarationError.of(found)

    def _out_of_form(self) -> Iterator[Problem]:
        name, theta = self.part.name, ca.vertcat(*(v.sx for v in self.theta))
        if not self.theta or any(v.kind is not VariableKind.STATE for v in self.theta):
            yield Problem("symbol", name, "theta is not a tuple of one or more states", "make each with state(..)")
        elif ca.depends_on(self.part.hamiltonian, theta):
            yield Problem("energy", name, "H depends on theta", "a variable with energy belongs to x1")
        for v in self.E32:
            if v.kind is not VariableKind.ALGEBRAIC:
                yield Problem(
                    "symbol", name, f"E32 acts on algebraic variables, '{v.name}' is a state", "put E31 x1' into A31"
                )
        if self.part.constraints or self.part.closed:
            yield Problem("symbol", name, "the part has constraints or closed-form pairs", "write it without them")

    def _misplaced(self) -> Iterator[Problem]:
        """Entries on variables of their own, n_theta x n each."""
        own = {key(v) for v in (*self.part.states, *self.part.algebraics)}
        for v, value in (*self.A.items(), *self.E32.items()):
            entry, shape = f"{self.part.name}: the entry of (38b) on '{v.name}'", ca.SX(_sx(value)).shape
            if key(v) not in own:
                yield Problem("symbol", entry, "is no variable of the part", "use its states and algebraic variables")
            elif shape != (self.n, v.n):
                yield Problem(
                    "shape", entry, f"is {shape}, expected {(self.n, v.n)}", "give a row for each entry of theta"
                )

    def _misshapen_inputs(self) -> Iterator[Problem]:
        ports = {p.name: p for p in self.part.ports}
        for name, value in self.B.items():
            shape = ca.SX(_sx(value)).shape
            if name not in ports:
                there = ", ".join(ports) or "none"
                yield Problem("symbol", self.part.name, f"has no port '{name}' for B3", f"it has: {there}")
            elif shape != (self.n, ports[name].n):
                yield Problem("shape", f"{self.part.name}: B3 on port '{name}'", f"is {shape}, expected "
                              f"{(self.n, ports[name].n)}", "give a row for each entry of theta")  # fmt: skip

    def _require_held(self, f2: ca.SX, B2: ca.SX) -> None:
        u = ca.vertcat(ca.SX(0, 1), *(p.u for p in self.part.ports))
        what = (
            "a port acts on them" if B2.nnz() else "they depend on inputs" if u.numel() and ca.depends_on(f2, u) else ""
        )
        what = what or ("they depend on time" if ca.depends_on(f2, time) else "")
        if what:
            raise DeclarationError(
                self.part.name, "with E32 the rows of the algebraic variables must be free of inputs and time, but "
                f"{what}: x2 would jump with the input, and theta with it", "feed the input through a state",
            )  # fmt: skip

    def _require_regular(self, what: str, matrix: ca.SX) -> None:
        variables = (*self.part.states, *self.part.algebraics, *self.theta, *self.part.parameters)
        start = np.array([s for v in variables for s in v.start])
        f = ca.Function("m", [ca.vertcat(*(v.sx for v in variables))], [ca.densify(matrix)])
        value = np.array(f(start))
        if undetermined(value) >= 0:
            raise DeclarationError(
                self.part.name, f"{what} is singular at the start ({np.array2string(value, precision=3)})",
                "the form (38) needs algebraic variables of index 1", "singular",
            )  # fmt: skip
