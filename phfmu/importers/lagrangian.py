"""Mechanical systems given by a Lagrangian of SymPy with a constant mass matrix."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import casadi as ca

from phfmu.declare.block import Block, block, skew
from phfmu.declare.energy import energy
from phfmu.declare.error import DeclarationError
from phfmu.declare.holonomic import Holonomic
from phfmu.declare.phdae import PHDAE
from phfmu.declare.variable import Variable, algebraic, state, time
from phfmu.importers.naming import scalar_names
from phfmu.importers.symbolic import acting, as_parameters, as_ports, shaped, show_matrices
from phfmu.importers.sympy_expressions import Converter


def from_lagrangian(
    L: Any,
    coordinates: Sequence[Any],
    velocities: Sequence[Any] | None = None,
    *,
    constraints: Sequence[Any] | Mapping[str, Any] = (),
    dissipation: Any = None,
    B: Any = None,
    inputs: Sequence[Any] = (),
    parameters: Mapping[Any, float] | Sequence[Variable] = (),
    name: str = "model",
    show: Callable[[str], object] | None = None,
    description: str = "",
) -> PHDAE:
    """The declaration of a Lagrangian L(q, v) = v^T M v / 2 + b(q)^T v - V(q), given in SymPy.

        q' = v,   M v' = -grad V + (Db^T - Db) v - dF/dv - Dg^T lambda + B(q) u,   0 = g(q),   y = B^T v

    Its energy is v^T M v / 2 + V.  Symbols are found by their names; `q(t)` is the coordinate q, and its derivative by time
    the velocity of it, so that expressions of `sympy.physics.mechanics` can be given as they are.

    coordinates: n in total: functions of time, symbols, names, or variables made with `state` (units, starts, nominal values)
    velocities:  n in total, likewise; default: `q_dot` for a coordinate q, the symbol of that name or the derivative of q(t)
    constraints: g, expressions in q (and in `t`, whose work is booked at a port), or label -> expression; with the
                 multipliers `lambda[1]`, ..
    dissipation: Rayleigh's function F(q, v) [W/2], of degree two in v
    B, inputs:   n x m forces of inputs, which are m in total: symbols or names (one port of plain numbers each), or ports made
                 with `Port(name, domain, given, {})`
    parameters:  symbol or name -> value, or variables made with `parameter`
    show:        takes a line for every entry as it was found, e.g. `print`

    DeclarationError names unknown symbols and functions, an entry of M that is not constant, terms in L that are not of
    degree two in v, and shapes that do not fit.
    """
    q = tuple(v if isinstance(v, Variable) else state(_name(v)) for v in coordinates)
    v = _velocities(name, q, velocities)
    p, ports = as_parameters(parameters), as_ports(inputs)
    system = _Symbols(name, scalar_names(q), scalar_names(v))
    if not isinstance(constraints, Mapping):
        constraints = {f"constraint {i}": e for i, e in enumerate(constraints, 1)}
    L, F = system.plain(L), None if dissipation is None else system.plain(dissipation)
    B = None if B is None else system.plain(B)

    symbols = {s: x.sx[i] for x in (*q, *v, *p) for i, s in enumerate(x.names())}
    convert, moving = Converter(name, symbols), Converter(name, {"t": time} | symbols)
    M, b, V = system.split(L)
    found = {"M": convert.matrix("M", M)}
    if not b.is_zero_matrix:
        found["gyroscopic"] = convert.matrix("gyroscopic", system.gyroscopic(b))
    if F is not None:
        found["R"] = convert.matrix("R", system.damping(F))
    m, n = sum(x.n for x in ports), len(system.q)
    if B is not None:
        found["B"] = convert.matrix("B", shaped(name, "B", B, (n, m)))
    elif m:
        raise DeclarationError(f"{name}: B", f"is missing, there are {m} inputs", "give B, n x m", "shape")
    terms = [convert.expression("V", e) for e in _summands(V)]
    gaps = {label: moving.expression(label, system.plain(e)) for label, e in constraints.items()}
    if show is not None:
        show_matrices(show, found, scalar_names(v), scalar_names(ports))
        for line in (*(f"V: {e}" for e in terms), *(f"{label}: 0 = {e}" for label, e in gaps.items())):
            show(line)

    multiplier = algebraic("lambda", len(gaps) if len(gaps) > 1 else None, description="multipliers")
    return PHDAE(
        name,
        states=(*q, *v),
        algebraics=(multiplier,) if gaps else (),
        parameters=p,
        energies=(*_kinetic(v, found["M"]), *(energy(e) for e in terms)),
        E={v: found["M"]},
        structure=(*(skew(a, w, 1.0) for a, w in zip(q, v, strict=True)), *_blocks(v, found.get("gyroscopic"))),
        dissipation=_blocks(v, found.get("R")),
        ports=acting(ports, v, found.get("B")),
        constraints=tuple(
            Holonomic(multiplier.part(i, 1) if len(gaps) > 1 else multiplier, e, label=label)
            for i, (label, e) in enumerate(gaps.items())
        ),
        description=description,
    )  # fmt: skip


@dataclass(frozen=True)
class _Symbols:
    """Names of the coordinates and velocities of a model, and what its expressions are made of in them."""

    model: str
    q: list[str]
    v: list[str]

    def plain(self, e: Any) -> Any:
        """The expression or matrix with symbols in place of functions of time and their derivatives."""
        import sympy

        found, names = {}, dict(zip(self.q, self.v, strict=True))
        for d in e.atoms(sympy.Derivative) if hasattr(e, "atoms") else ():
            of: Any = d.expr
            if isinstance(of, sympy.core.function.AppliedUndef) and len(of.args) == 1 and d.derivative_count == 1:
                found[d] = sympy.Symbol(names.get(of.func.__name__, str(d)))
        for f in e.atoms(sympy.core.function.AppliedUndef) if hasattr(e, "atoms") else ():
            if f.func.__name__ in (*self.q, *self.v) and len(f.args) == 1:
                found[f] = sympy.Symbol(f.func.__name__)
        made = sympy.sympify(e).xreplace(found)
        return made.xreplace({s: sympy.Symbol(s.name) for s in made.free_symbols})

    def split(self, L: Any) -> tuple[Any, Any, Any]:
        """M, b and V; DeclarationError where M depends on q or v."""
        import sympy

        v = [sympy.Symbol(s) for s in self.v]
        M, rest = sympy.hessian(L, v), dict.fromkeys(v, 0)
        for r in range(len(v)):
            for c in range(r, len(v)):
                M[r, c] = M[c, r] = self.constant(f"M[{self.v[r]}, {self.v[c]}]", M[r, c])
        b = sympy.Matrix([sympy.simplify(L.diff(s).xreplace(rest)) for s in v])
        return M, b, -L.xreplace(rest)

    def constant(self, entry: str, e: Any) -> Any:
        """An entry of the mass matrix, simplified where it seems to depend on the motion."""
        import sympy

        moves = {sympy.Symbol(s) for s in (*self.q, *self.v)}
        if not e.free_symbols & moves:
            return e
        e = sympy.simplify(e)
        on = sorted(s.name for s in e.free_symbols & moves)
        if not on:
            return e
        if set(on) & set(self.v):
            reason, remedy = (
                f"= {e}: L is not of degree two in the velocities",
                "give a Lagrangian T - V of classical mechanics",
            )
        else:
            reason = f"= {e} depends on {', '.join(on)}: the mass matrix is not constant"
            remedy = (
                "use coordinates in which it is, as points and directors in Cartesian coordinates, with `constraints`; or give "
                "H(q, p) with momenta to from_sympy"
            )
        raise DeclarationError(f"{self.model}: {entry}", reason, remedy, "mass")

    def gyroscopic(self, b: Any) -> Any:
        """Db^T - Db."""
        import sympy

        slope = b.jacobian([sympy.Symbol(s) for s in self.q])
        return (slope.T - slope).applyfunc(sympy.simplify)

    def damping(self, F: Any) -> Any:
        """R(q) of F = v^T R v / 2; DeclarationError where F is something else."""
        import sympy

        v = [sympy.Symbol(s) for s in self.v]
        R = sympy.hessian(F, v).applyfunc(sympy.simplify)
        x = sympy.Matrix(v)
        rest = sympy.simplify(F - (x.T * R * x)[0] / 2)
        if R.free_symbols & set(v) or rest != 0:
            raise DeclarationError(
                f"{self.model}: dissipation", f"{F} is not of degree two in {', '.join(self.v)}",
                "give Rayleigh's function v^T R(q) v / 2; constant forces are inputs or potentials", "dissipation",
            )  # fmt: skip
        return R


def _name(x: Any) -> str:
    """The name of a symbol, of a function of time, or a name itself."""
    return x if isinstance(x, str) else getattr(getattr(x, "func", None), "__name__", "") if x.args else str(x)


def _velocities(name: str, q: tuple[Variable, ...], given: Sequence[Any] | None) -> tuple[Variable, ...]:
    """A velocity for each coordinate, of its size."""
    if given is None:
        return tuple(state(f"{x.name}_dot", x.size, unit=_per_second(x.unit)) for x in q)
    v = tuple(x if isinstance(x, Variable) else state(_name(x)) for x in given)
    if [x.n for x in v] != [x.n for x in q]:
        sizes = " and ".join(", ".join(f"{x.name} ({x.n})" for x in some) for some in (q, v))
        raise DeclarationError(
            f"{name}: velocities", f"do not fit the coordinates: {sizes}", "give one of its size for each", "shape"
        )
    return v


def _per_second(unit: str) -> str:
    return f"{unit}.s" if "/" in unit else f"{unit}/s"


def _summands(V: Any) -> tuple[Any, ...]:
    import sympy

    return () if V == 0 else sympy.Add.make_args(V)


def _kinetic(v: tuple[Variable, ...], M: ca.SX) -> list[Any]:
    """Kinetic energies: one for each velocity where M is diagonal."""
    x = ca.vertcat(*(w.sx for w in v))
    if all(r == c for r, c in zip(*M.sparsity().get_triplet(), strict=True)):
        return [energy(0.5 * M[i, i] * x[i] ** 2) for i in M.sparsity().get_col()]
    return [energy(0.5 * ca.dot(x, ca.mtimes(M, x)))]


def _blocks(v: tuple[Variable, ...], matrix: ca.SX | None) -> tuple[Block, ...]:
    return () if matrix is None else (block(v, matrix),)
