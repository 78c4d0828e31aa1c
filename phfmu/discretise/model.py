"""A discretised model: the step plan, the instant plan and the start values, everything an engine needs."""

from __future__ import annotations

from dataclasses import dataclass, field

import casadi as ca
import numpy as np
from numpy.typing import NDArray

from phfmu.declare.phdae import PHDAE, _starts
from phfmu.declare.variable import Variable
from phfmu.discretise.collocated import Collocated
from phfmu.discretise.extract import extract
from phfmu.discretise.instant import Check, instant_plan
from phfmu.discretise.onestep import step_plan
from phfmu.discretise.plan import Kernel, Plan
from phfmu.discretise.terms import Terms

Array = NDArray[np.float64]

#: A start is consistent if every hidden constraint is below this fraction of its natural size.
CONSISTENCY = 1e-8


@dataclass(frozen=True, eq=False)
class Model:
    """Plans and start values of one declaration under one scheme.

    x0 (nx), a0 (na), u0 (nu), p0 (np): starts;  `checks`, `check_scale`: hidden constraints, reported as the last
    observables, and their natural size at the start;  `row_names`, `instant_names`: a name per residual row.
    """

    name: str
    declaration: PHDAE
    scheme: Collocated
    step: Plan
    instant: Plan
    x0: Array
    a0: Array
    u0: Array
    p0: Array
    t0: float = 0.0
    checks: tuple[Check, ...] = ()
    check_scale: Array = field(default_factory=lambda: np.zeros(0))
    row_names: tuple[str, ...] = ()
    instant_names: tuple[str, ...] = ()
    members: tuple[str, ...] = ("",)
    observable_names: tuple[str, ...] = ()

    @property
    def kernels(self) -> list[Kernel]:
        """Kernels of both plans, in order of appearance; the same object may appear twice."""
        return [g.kernel for plan in (self.step, self.instant) for g in plan.groups]

    @property
    def nodes(self) -> Array:
        """The k quadrature nodes on [0, 1]."""
        from phfmu.discretise.quadrature import nodes

        return nodes(self.scheme.k).c


def _stack(variables: tuple[Variable, ...]) -> Array:
    return np.array([s for v in variables for s in v.start], float)


def build_model(declaration: PHDAE, scheme: Collocated | None = None) -> Model:
    """Discretise `declaration`; DeclarationError names what does not fit.  Default: `default_scheme`."""
    scheme = default_scheme(declaration) if scheme is None else scheme
    terms = extract(declaration, joint=scheme.joint)
    step, layout = step_plan(terms, scheme)
    instant, checks = instant_plan(terms)
    p0, x0 = _stack(declaration.parameters), _stack(declaration.states)
    u0 = [s for p in declaration.ports if p.external for s in _starts(p)]
    return Model(
        declaration.name, declaration, scheme, step, instant, x0, _stack(declaration.algebraics), np.array(u0, float), p0,
        checks=tuple(checks), check_scale=_scales(terms, checks, x0, p0), row_names=tuple(layout.names()),
        instant_names=tuple(_instant_equation_names(terms, instant)), members=tuple(terms.members),
        observable_names=tuple(terms.observable_names),
    )  # fmt: skip


discretise = build_model


def default_scheme(declaration: PHDAE, order: int = 2) -> Collocated:
    """Two-level with holonomic constraints, plain collocation else."""
    two_level = bool(declaration.constraints)
    return Collocated(order // 2, two_level=two_level, name="two-level" if two_level else "collocated")


def _instant_equation_names(terms: Terms, instant: Plan) -> list[str]:
    states = [n for v in terms.model.states for n in v.names()]
    names = [f"rate of {n}" for n in states] if instant.nw > terms.na + len(terms.solved_costates) else []
    names += [f"costate of {states[i]}" for i in terms.solved_costates]
    return names + [f"equation of {n}" for v in terms.model.algebraics for n in v.names()]


def _scales(terms: Terms, checks: list[Check], x0: Array, p0: Array) -> Array:
    """Natural size of each check: sum over states of |d check / d x| nominal, and of the terms that cancel in it."""
    if not checks:
        return np.zeros(0)
    model = terms.model
    nominal = np.array([v.nominal[j] for v in model.states for j in range(v.n)])
    size = np.maximum(nominal, np.abs(x0))
    parameters = ca.vertcat(*(p.sx for p in model.parameters))
    t = ca.SX.sym("t")
    rows = _check_rows(terms, checks)
    jac = ca.Function("j", [model.x, parameters, t], [ca.jacobian(ca.vertcat(*rows), model.x)])
    return np.abs(np.array(jac(x0, p0, 0.0))) @ size + 1e-300


def _check_rows(terms: Terms, checks: list[Check]) -> list[ca.SX]:
    """The undifferentiated hidden rows as expressions of the model's own symbols (inputs and time left out)."""
    model = terms.model
    z = ca.densify(ca.gradient(model.hamiltonian, model.x)) if terms.n1 else ca.SX(0, 1)
    mass = {t.rows[0][1]: t for t in terms.terms if t.kind == "mass"}
    p = ca.vertcat(*(v.sx for v in model.parameters))
    for i, t in mass.items():
        local = t.local.get("p", ca.SX(0, 1))
        (m,) = ca.substitute([t.data["m"]], [local], [p[list(t.index.get("p", ()))]]) if local.numel() else [t.data["m"]]
        z[i] = z[i] / m
    for t in terms.terms:
        if t.kind == "closed":
            value = ca.substitute([t.data["z"]], *_globals(t, model.x, z, p))[0]
            for j, (_, i) in enumerate(t.rows):
                z[i] = value[j]
    wanted = {(c.row, c.level): n for n, c in enumerate(checks)}
    rows = [ca.SX(0) for _ in checks]
    for kind, row, source, i, value in terms.constants:
        if kind == "a" and (row, "velocity") in wanted and source == "z":
            rows[wanted[(row, "velocity")]] += value * z[i]
    for t in terms.terms:
        if t.kind == "flow" and any(k == "a" and (i, "velocity") in wanted for k, i in t.rows):
            f = ca.substitute([t.data["f"]], *_globals(t, model.x, z, p))[0]
            for j, (k, i) in enumerate(t.rows):
                if k == "a" and (i, "velocity") in wanted:
                    rows[wanted[(i, "velocity")]] += f[j]
        elif t.kind == "constraint":
            g = t.data["g"]
            exprs = [g, ca.gradient(g, t.local["x"])]
            value, grad = ca.substitute(exprs, *_globals(t, model.x, z, p))
            q = t.index["x"]
            v = ca.vertcat(*(z[terms.velocity_of[i]] for i in q))
            rows[wanted[(t.rows[0][1], "velocity")]] += ca.dot(grad, v)
            rows[wanted[(t.rows[0][1], "position")]] += value
    return rows


def _globals(t, x: ca.SX, z: ca.SX, p: ca.SX) -> tuple[list[ca.SX], list[ca.SX]]:
    """Old and new symbols that bring a local expression back to the model's; inputs become 0."""
    old, new = [], []
    for kind, source in (("x", x), ("z", z), ("p", p)):
        if kind in t.local and not (t.kind == "closed" and kind == "z"):
            old.append(t.local[kind])
            new.append(source[list(t.index[kind])])
    for kind in ("a", "u"):
        if kind in t.local:
            old.append(t.local[kind])
            new.append(ca.SX.zeros(t.local[kind].numel(), 1))
    return old, new
