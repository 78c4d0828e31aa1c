"""Old and new variables of a system transformation of one model, and the substitutions between them.

Starts of the new variables of a system transformation: phi(x~) = x solved.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import replace
from typing import Any

import casadi as ca
import numpy as np
from numpy.typing import NDArray

from phfmu.declare.entries.coefficients import stacked
from phfmu.declare.error import DeclarationError, Problem
from phfmu.declare.phdae import PHDAE
from phfmu.declare.transform.inverse import inverted
from phfmu.declare.transform.maps import CoordinateMaps
from phfmu.declare.transform.regular import undetermined
from phfmu.declare.variable import Variable, VariableKind, _sx, key, slices

Array = NDArray[Any]

ITERATIONS = 50


def solved_starts(T: CoordinateMaps, old: Array, p: Array, parameters: ca.SX, model: str) -> Array:
    """x~ with phi(x~) = x, by Newton from the starts of the new variables.

    DeclarationError if there is none nearby, or if Dphi or U is singular there.
    """
    f = ca.Function("phi", [T.x, parameters], [T.image, ca.densify(T.jacobian), ca.densify(T.U)])
    x = np.array([s for v in T.new for s in v.start])
    names = [n for v in T.new for n in v.names()]
    size = np.array([s for v in T.old for s in v.nominal]) + np.abs(old)

    def residual(x: Array) -> tuple[Array, Array, Array]:
        value, D, U = (np.array(a) for a in f(x, p))
        return value.ravel() - old, D, U

    r, D, U = residual(x)
    for _ in range(ITERATIONS):
        if not np.isfinite(r).all() or np.max(np.abs(r) / size) <= 1e-15:
            break
        step, scale = np.linalg.lstsq(D, -r, rcond=None)[0], 1.0
        while scale > 1e-4:  # damped: the first guess may be far
            new = residual(x + scale * step)
            if np.isfinite(new[0]).all() and np.linalg.norm(new[0] / size) < np.linalg.norm(r / size):
                break
            scale /= 2
        else:
            break
        x, (r, D, U) = x + scale * step, new
    if np.isfinite(r).all():
        _require_regular({"Dphi": D, "U": U}, x, names, model)
    if not np.isfinite(r).all() or np.max(np.abs(r) / size) > 1e-9:
        worst = int(np.argmax(np.nan_to_num(np.abs(r) / size, nan=np.inf)))
        old_names = [n for v in T.old for n in v.names()]
        raise DeclarationError(
            model,
            f"no start of {', '.join(names)} found with phi(x~) = x: '{old_names[worst]}' is missed by {r[worst]:.6g}",
            "give the new variables starts near the solution",
            "start",
        )
    return x


def _require_regular(matrices: Mapping[str, Array], x: Array, names: list[str], model: str) -> None:
    for what, matrix in matrices.items():
        column = undetermined(matrix)
        if column >= 0:
            raise DeclarationError(
                model,
                f"{what} is singular at {names[column]} = {x[column]:.6g} (singular values {_values(matrix)}); a "
                "transformation is invertible near regular points only",
                "start elsewhere or use other coordinates",
                "singular",
            )


def _values(matrix: Array) -> str:
    if not np.isfinite(matrix).all():
        return "not finite"
    values = np.linalg.svd(matrix, compute_uv=False)
    return f"{values[0]:.3g} .. {values[-1]:.3g}"


POINTS = 5
#: of the sum of absolute values of its parts: an entry below this at every sampled point is zero
ZERO = 1e-12


class VariableChange:
    """Old and new variables of one transformation of one model, with the substitutions between them."""

    def __init__(self, model: PHDAE, T: CoordinateMaps):
        own = {key(v): v for v in (*model.states, *model.algebraics)}
        missing = [v.name for v in T.old if key(v) not in own]
        if missing:
            raise DeclarationError(
                model.name,
                f"there is no state or algebraic variable {', '.join(missing)}",
                f"replace some of {', '.join(v.name for v in own.values())}",
            )
        touched = {key(v) for v in T.old}
        shared = [v for k in model.E for v in stacked(k) if touched & {key(w) for w in stacked(k)}]
        self.model, self.T = model, T.extended([v for v in shared if key(v) not in touched])
        self.old = tuple(own[key(v)] for v in self.T.old)
        self.row: dict[int, slice] = slices(self.old)
        self._require_own_symbols(own)
        parameters = ca.vertcat(*(v.sx for v in model.parameters))
        p = np.array([s for v in model.parameters for s in v.start])
        start = solved_starts(self.T, np.array([s for v in self.old for s in v.start]), p, parameters, model.name)
        parts = np.split(start, np.cumsum([v.n for v in self.T.new])[:-1])
        self.new = tuple(replace(v, start=tuple(map(float, s))) for v, s in zip(self.T.new, parts, strict=True))
        self.column = slices(self.new)
        self.states = [i for v in self.new if v.kind is VariableKind.STATE for i in span(self.column[key(v)])]
        self.algebraics = [i for v in self.new if v.kind is VariableKind.ALGEBRAIC for i in span(self.column[key(v)])]
        self.U, self.inverse = self.T.U, inverted(self.T.U)
        self.given: dict[int, ca.SX] = {}
        around = [v for vs in (model.states, model.algebraics, self.new) for v in vs]
        self._known = {h: value for v in around for h, *value in zip(_hashes(v), v.start, v.nominal, strict=True)}
        self._parameters = {h: value for v in model.parameters for h, value in zip(_hashes(v), v.start, strict=True)}

    def _require_own_symbols(self, own: dict[int, Variable]) -> None:
        if found := [*self._foreign(own), *self._fed(own), *self._paired()]:
            raise DeclarationError.of(found)

    def _foreign(self, own: dict[int, Variable]) -> Iterator[Problem]:
        known = {s.element_hash() for v in self.model.parameters for s in ca.vertsplit(v.sx)}
        mine = {s.element_hash(): v.name for v in own.values() for s in ca.vertsplit(v.sx)}
        for s in self.T.foreign:
            if s.element_hash() in mine:
                name = mine[s.element_hash()]
                yield Problem("symbol", self.model.name, f"phi or U depends on '{name}', which is not replaced",
                              f"list a new variable for it and map '{name}' to that")  # fmt: skip
            elif s.element_hash() not in known:
                yield Problem("symbol", self.model.name, f"phi or U depends on '{s}', not a parameter of this model",
                              "use its own parameters, or declare this one")  # fmt: skip

    def _fed(self, own: dict[int, Variable]) -> Iterator[Problem]:
        mine = {s.element_hash() for v in own.values() for s in ca.vertsplit(v.sx)}
        for port in self.model.ports:
            if any(s.element_hash() in mine and _owner(own, s) in self.row for s in port.bound or ()):
                yield Problem("port", self.model.name, f"port '{port.name}' is fed by a replaced variable",
                              "transform the members, then compose them")  # fmt: skip

    def _paired(self) -> Iterator[Problem]:
        for pair in self.model.closed:
            if any(key(v) in self.row for v in pair.variables):
                names = ", ".join(v.name for v in pair.variables)
                text = f"{names} have a closed-form discrete gradient pair, which is written for these coordinates"
                yield Problem("pair", self.model.name, text, "leave the pair out")

    # -- expressions ------------------------------------------------------------------------------------------------

    def costate(self) -> ca.SX:
        """z~ of all new variables, stacked."""
        return ca.vertcat(*(v.z if v.kind is VariableKind.STATE else self.given.get(key(v), v.sx) for v in self.new))

    def expr(self, e: Any) -> ca.SX:
        """An expression of the old model in new symbols."""
        olds = [v.sx for v in self.old] + [v.z for v in self.old if v.kind is VariableKind.STATE]
        z = ca.mtimes(self.U, self.costate())
        news = [self.T.image] + [z[self.row[key(v)]] for v in self.old if v.kind is VariableKind.STATE]
        return ca.substitute([ca.SX(_sx(e))], [ca.vertcat(*olds)], [ca.vertcat(*news)])[0]

    def at_old(self, e: Any) -> ca.SX:
        """A function of old states only (H, E, z) in new symbols."""
        return ca.substitute([ca.SX(_sx(e))], [ca.vertcat(*(v.sx for v in self.old))], [self.T.image])[0]

    def sampled(self, exprs: Sequence[ca.SX]) -> list[Array]:
        """Each expression at the start and at seeded points around it (points x rows x cols)."""
        rng = np.random.default_rng(4)
        flat = ca.densify(ca.vertcat(*(ca.vec(e) for e in exprs)))
        symbols = ca.symvar(flat)
        f = ca.Function("s", [ca.vertcat(*symbols)], [flat])
        rows = []
        for i in range(POINTS + 1):
            at = []
            for s in symbols:
                draw, h = rng.uniform(-1.0, 1.0), s.element_hash()
                if h in self._known:
                    start, nominal = self._known[h]
                    at.append(start + (0.3 * draw * max(nominal, abs(start)) if i else 0.0))
                elif h in self._parameters:
                    at.append((self._parameters[h] or 1.0) * (1 + 0.3 * draw) if i else self._parameters[h])
                else:
                    at.append(draw)
            rows.append(np.array(f(np.array(at))).ravel())
        out, k = [], 0
        for e in exprs:
            part = np.array([r[k : k + e.numel()] for r in rows])
            out.append(part.reshape(-1, e.shape[1], e.shape[0]).transpose(0, 2, 1))
            k += e.numel()
        return out

    def product(self, left: ca.SX, middle: ca.SX, right: ca.SX) -> tuple[ca.SX, Array]:
        """left middle right without the entries that cancel to zero at every sampled point; and its values there."""
        size = ca.mtimes([ca.fabs(left), ca.fabs(middle), ca.fabs(right)])
        out = ca.mtimes([left, middle, right])
        value, scale = self.sampled([out, size])
        zero = np.asarray((np.abs(value) <= ZERO * scale).all(axis=0))
        for i, j in np.argwhere(zero):
            out[int(i), int(j)] = 0
        return ca.sparsify(out), np.where(zero, 0.0, value)

    def listed(self, variables: tuple[Variable, ...], kind: VariableKind) -> tuple[Variable, ...]:
        """The variables of one kind, the new ones where the first old one was."""
        new = [v for v in self.new if v.kind is kind]
        at = next((i for i, v in enumerate(variables) if key(v) in self.row), len(variables))
        kept = [v for v in variables[at:] if key(v) not in self.row]
        return (*variables[:at], *new, *kept)


def _hashes(v: Variable) -> list[int]:
    return [s.element_hash() for s in ca.vertsplit(v.sx)]


def span(s: slice) -> list[int]:
    return list(range(s.start, s.stop))


def _owner(own: dict[int, Variable], symbol: ca.SX) -> int:
    h = symbol.element_hash()
    return next((k for k, v in own.items() if h in {s.element_hash() for s in ca.vertsplit(v.sx)}), 0)
