"""Natural size of hidden constraints, against which a start is called consistent."""

from __future__ import annotations

import casadi as ca
import numpy as np
from numpy.typing import NDArray

from phfmu.discretise.instant import Check
from phfmu.discretise.terms import Term, Terms

Array = NDArray[np.float64]


def check_scales(terms: Terms, checks: list[Check], x0: Array, p0: Array) -> Array:
    """Natural size of each check: the sum over states of |d check / d x| times the larger of nominal and start."""
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


def _globals(t: Term, x: ca.SX, z: ca.SX, p: ca.SX) -> tuple[list[ca.SX], list[ca.SX]]:
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
