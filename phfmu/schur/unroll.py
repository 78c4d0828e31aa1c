"""A small model's evaluation of the Schur stepper as straight-line C text: the loops of lane.inc and schur.inc written out.

Displacements, shifts and forces of the degrees of freedom are local variables instead of arrays; every operation is
the same and in the same order but for sums that begin with zero, and for the size of an update, which has several sums.
"""

from __future__ import annotations

import re
from collections.abc import Iterable, Iterator, Sequence

import numpy as np

from phfmu.schur.lane_groups import LaneGroup
from phfmu.schur.stepper import SchurStepper

#: a model with more degrees of freedom, or instances, keeps the loops
MOST = 40

#: partial sums of the size of an update: one sum would be a chain of dependent additions at the end of every sweep
SUMS = 4

ORDER = ("constraint", "strain", "force")


def unrolled(schur: SchurStepper) -> str:
    """Definitions of `evaluate` and `project` for this model, or nothing if it is too large."""
    groups = sorted((g for g in schur.groups if g.kernel.kind in ORDER), key=lambda g: ORDER.index(g.kernel.kind))
    if schur.ndof > MOST or sum(g.n for g in groups) > MOST or len(schur.load_kind) and schur.load_kind.any():
        return ""
    lines = [
        *_start(schur),
        *(line for g in groups for i in range(g.n) for line in _instance(schur, g, i)),
        *_end(schur),
    ]
    bodies = {
        "void take_state(ph_work *w, const double *restrict x, const double *restrict rest)": _state(schur),
        "void look_from(ph_work *w, const double *restrict last, const ph_lane *restrict ahead)": _look(schur),
        "void evaluate(ph_work *w)": [*_pointers(lines), *lines],
        "int factor(ph_work *w)": _factor(schur),
        "double project(ph_work *w)": _project(schur),
        "void write_step(ph_work *w, double *restrict y)": _write(schur),
    }
    text = "#define PH_UNROLLED\n\n"
    for head, body in bodies.items():
        text += f"static {head} {{\n" + "".join(f"    {line}\n" for line in body) + "}\n\n"
    return text


def _state(schur: SchurStepper) -> Iterator[str]:
    yield "const double *restrict constant = w->constant;"
    yield "double *restrict velocity = w->velocity, *restrict point = w->point;"
    yield "ph_lane *restrict base = w->base;"
    for d, v in enumerate(schur.velocity):
        yield f"base[{d}] = PH_SPREAD(constant[{d}]), velocity[{d}] = x[{v}];"
    for e, (plus, minus) in enumerate(zip(schur.point_plus, schur.point_minus, strict=True)):
        a = schur.position[plus]
        if minus == schur.ndof:
            yield f"point[{e}] = x[{a}] - rest[{a}];"
        else:
            b = schur.position[minus]
            yield f"point[{e}] = (x[{a}] - x[{b}]) + (rest[{b}] - rest[{a}]);"


def _look(schur: SchurStepper) -> Iterator[str]:
    k = schur.k
    yield "const double *restrict velocity = w->velocity;"
    yield "ph_lane *restrict f = w->f;"
    for j in range(k + 1):
        yield f"const ph_lane a{j} = ahead[{j}];"
    for d in range(schur.ndof):
        terms = "".join(f" + last[{schur.w_position[d * k + j]}] * a{j + 1}" for j in range(k))
        yield f"f[{d}] = velocity[{d}] * a0{terms};"


#: arrays of the work space that `evaluate` uses by a name of its own, so that the compiler knows them apart
ARRAYS = {
    "const double": ("point", "parameters = p", "start", "velocity", "inverse_mass"),
    "double": ("slope",),
    "const ph_lane": ("f", "base", "multiplier", "input = u"),
    "ph_lane": ("slot", "n", "force", "next", "stresses = stress"),
}


def _pointers(lines: Sequence[str]) -> Iterator[str]:
    words = set(re.findall(r"\w+", " ".join(lines)))
    for ctype, names in ARRAYS.items():
        for name, _, member in (n.partition(" = ") for n in names):
            if name in words:
                yield f"{ctype} *restrict {name} = w->{member or name};"


def _start(schur: SchurStepper) -> Iterator[str]:
    k = schur.k
    yield "const ph_lane zero = PH_SPREAD(0.0);"
    for j in range(k):
        yield f"const ph_lane c{j} = w->column[{j}];"
    for d in range(schur.ndof):
        yield f"const ph_lane f{d} = f[{d}], v{d} = f{d} - n[{d}];"
        yield f"const ph_lane x{d} = {' + '.join(f'c{j} * f{d}[{j}]' for j in range(k))};"
        yield f"ph_lane n{d} = zero, g{d} = base[{d}];"


def _difference(schur: SchurStepper, name: str, plus: int, minus: int) -> str:
    return f"{name}{plus}" if minus == schur.ndof else f"({name}{plus} - {name}{minus})"


def _array(ctype: str, name: str, values: Sequence[str]) -> str:
    return f"const {ctype} {name}[] = {{{', '.join(values) or '0.0'}}};"


def _instance(schur: SchurStepper, g: LaneGroup, i: int) -> Iterator[str]:
    nx = g.kernel.nx
    points = range(g.point + i * nx, g.point + (i + 1) * nx)
    ends = [(int(schur.point_plus[e]), int(schur.point_minus[e])) for e in points]
    yield "{"
    yield _array("double", "p", [f"parameters[{int(q)}]" for q in g.pi[i]])
    d = [f"point[{e}] + {_difference(schur, 'x', a, b)}" for e, (a, b) in zip(points, ends, strict=True)]
    yield _array("ph_lane", "d", d) if d else "const ph_lane d[1] = {zero};"
    yield from {"constraint": _constraint, "strain": _strain, "force": _force}[g.kernel.kind](schur, g, i, points, ends)
    yield "}"


def _constraint(schur: SchurStepper, g: LaneGroup, i: int, points: range, ends: list[tuple[int, int]]) -> Iterator[str]:
    n = len(points)
    yield _array("ph_lane", "e", [_difference(schur, "v", a, b) for a, b in ends])
    yield f"const ph_lane lambda = multiplier[{g.first + i}], mu = lambda[PH_K] * PH_NODES;"
    yield f"ph_lane gradient[{n}], turn[{n}];"
    yield f"{g.kernel.name}(d, e, p, gradient, turn);"
    for j, (e, (a, b)) in enumerate(zip(points, ends, strict=True)):
        yield f"const ph_lane shift{j} = gradient[{j}] * mu, pull{j} = gradient[{j}] * lambda + turn[{j}] * mu;"
        begins = [_first_slot(schur, d) == e for d in (a, b)]
        yield f"slot[{e}] = gradient[{j}], n{a} {'=' if begins[0] else '+='} shift{j}, g{a} -= pull{j};"
        if b < schur.ndof:
            yield f"n{b} {'= -' if begins[1] else '-= '}shift{j}, g{b} += pull{j};"


def _first_slot(schur: SchurStepper, dof: int) -> int:
    """The first gradient of a constraint with respect to a degree of freedom."""
    last = schur.row_ptr[schur.nconstraint]
    return int(np.argmax((schur.point_plus[:last] == dof) | (schur.point_minus[:last] == dof)))


def _sum(terms: Iterable[str]) -> str:
    return " + ".join(terms) or "PH_SPREAD(0.0)"


def _strain(schur: SchurStepper, g: LaneGroup, i: int, points: range, ends: list[tuple[int, int]]) -> Iterator[str]:
    assert g.stress is not None
    s, n = g.first + i - schur.nconstraint, len(points)
    yield f"ph_lane gradient[{n}];"
    yield f"{g.kernel.name}(d, p, gradient);"
    yield "if (!w->carry) {"
    rate = [f"gradient[{j}] * {_difference(schur, 'f', a, b)}" for j, (a, b) in enumerate(ends)]
    yield f"    const ph_lane sum = {_sum(rate)};"
    if g.stress.kind == "pointwise":
        chat = " + ".join([f"PH_SPREAD(start[{s}])", *(f"c{j} * sum[{j}]" for j in range(schur.k))])
        yield f"    const ph_lane c = {chat};"
        yield "    ph_lane slopes;"
        yield f"    {g.stress.name}(&c, p, stresses + {s}, &slopes);"
        yield f"    slope[{s}] = slopes[PH_K / 2];"
    else:
        yield f"    const double rate[] = {{{', '.join(f'w->h * sum[{j}]' for j in range(schur.k))}}};"
        yield "    double values[PH_K];"
        yield f"    {g.stress.name}(start + {s}, rate, p, values, slope + {s});"
        for j in range(schur.k):
            yield f"    stresses[{s}][{j}] = values[{j}];"
    yield "}"
    yield f"const ph_lane stress = stresses[{s}];"
    for j, (e, (a, b)) in enumerate(zip(points, ends, strict=True)):
        yield f"const ph_lane pull{j} = gradient[{j}] * stress;"
        yield f"slot[{e}] = gradient[{j}], g{a} -= pull{j};" + (f" g{b} += pull{j};" if b < schur.ndof else "")


def _force(schur: SchurStepper, g: LaneGroup, i: int, points: range, ends: list[tuple[int, int]]) -> Iterator[str]:
    rates = [_difference(schur, "f", int(a), int(b)) for a, b in zip(g.zp[i], g.zm[i], strict=True)]
    yield _array("ph_lane", "e", rates) if rates else "const ph_lane e[1] = {zero};"
    inputs = [f"input[{int(u)}]" for u in g.ui[i]]
    yield _array("ph_lane", "u", inputs) if inputs else "const ph_lane u[1] = {zero};"
    yield f"ph_lane out[{g.kernel.no}];"
    yield f"{g.kernel.name}(d, e, u, p, out);"
    for j, (a, b) in enumerate(zip(g.op[i], g.om[i], strict=True)):
        yield f"g{a} += out[{j}];" + (f" g{b} -= out[{j}];" if b < schur.ndof else "")


def _end(schur: SchurStepper) -> Iterator[str]:
    for d in range(schur.ndof):
        terms = " + ".join(f"c{j} * a{d}[{j}]" for j in range(schur.k))
        yield f"const ph_lane a{d} = inverse_mass[{d}] * g{d}, m{d} = inverse_mass[{d}] * n{d};"
        yield f"force[{d}] = a{d}, n[{d}] = m{d}, next[{d}] = (velocity[{d}] + m{d}) + ({terms});"


def _rows(schur: SchurStepper, first: int, last: int) -> list[list[tuple[int, int, int]]]:
    """Per row (gradient slot, degree of freedom, the one subtracted)."""
    spans = [range(schur.row_ptr[r], schur.row_ptr[r + 1]) for r in range(first, last)]
    return [[(e, int(schur.point_plus[e]), int(schur.point_minus[e])) for e in span] for span in spans]


def _factor(schur: SchurStepper) -> Iterator[str]:
    e, sign = schur.hard, {1.0: "", -1.0: "-"}
    yield "const double *restrict m = w->inverse_mass;"
    yield "const ph_lane *restrict slot = w->slot;"
    for i in range(e.nentry):
        span = range(e.product_ptr[i], e.product_ptr[i + 1])
        products = [
            f"{sign[float(e.product_sign[q])]}m[{e.product_dof[q]}] * slot[{e.product_a[q]}] * slot[{e.product_b[q]}]"
            for q in span
        ]
        yield f"ph_lane e{i} = {_sum(products)};"
    if e.n:
        yield f"const ph_lane {', '.join(f'initial{j} = e{j}' for j in range(e.n))};"
    for j in range(e.n):
        yield f"if (lane_weak(e{j}, initial{j}, {e.n})) return 0;"
        yield f"const ph_lane inverse{j} = 1.0 / e{j};"
        for q in range(e.update_ptr[j], e.update_ptr[j + 1]):
            left, right = e.update_left[q], e.update_right[q]
            yield f"e{e.update_target[q]} = e{e.update_target[q]} - e{left} * (e{right} * inverse{j});"
        yield from (f"e{i} = e{i} * inverse{j};" for i in range(e.column[j], e.column[j + 1]))
        yield f"e{j} = inverse{j};"
    yield from (f"w->hard[{i}] = e{i};" for i in range(e.nentry))
    yield "return 1;"


def _project(schur: SchurStepper) -> Iterator[str]:
    rows = _rows(schur, 0, schur.nconstraint)
    yield "const double *restrict m = w->inverse_mass, *restrict weight = w->weight;"
    yield "const ph_lane *restrict slot = w->slot, *restrict hard = w->hard, *restrict f = w->f;"
    yield "ph_lane *restrict next = w->next;"
    for j in range(schur.k + 1):
        yield f"const ph_lane p{j} = w->multiply[{j}];"
    for d in range(schur.ndof):
        yield f"ph_lane f{d} = next[{d}];"
    for r, row in enumerate(rows):
        terms = (f"slot[{e}] * {_difference(schur, 'f', a, b)}" for e, a, b in row)
        yield f"ph_lane r{r} = {_sum(terms)};"
    yield from _solve(schur)
    for r, row in enumerate(rows):
        yield "{"
        added = _sum(f"p{j} * r{r}[{j}]" for j in range(schur.k + 1))
        yield f"const ph_lane added = {added};"
        for e, a, b in row:
            yield f"const ph_lane pull{e} = slot[{e}] * r{r};"
            yield f"f{a} -= m[{a}] * pull{e};" + (f" f{b} += m[{b}] * pull{e};" if b < schur.ndof else "")
        yield f"w->multiplier[{r}] += added, w->row[{r}] = added;"
        yield "}"
    sums = min(SUMS, schur.ndof)
    for d in range(schur.ndof):
        yield f"const ph_lane moved{d} = f{d} - f[{d}];"
        begins = f"ph_lane all{d} =" if d < sums else f"all{d % sums} +="
        yield f"next[{d}] = f{d}; {begins} moved{d} * moved{d} * weight[{d}];"
    yield f"return sum_of({_sum(f'all{i}' for i in range(sums))});"


def _solve(schur: SchurStepper) -> Iterator[str]:
    """elimination.inc on the local right-hand sides r."""
    e = schur.hard
    below = {entry: int(e.below[entry - e.n]) for entry in range(e.n, e.nentry)}
    columns = [(j, int(e.order[j]), range(e.column[j], e.column[j + 1])) for j in range(e.n)]
    for _, row, column in columns:
        yield from (f"r{below[i]} = r{below[i]} - hard[{i}] * r{row};" for i in column)
    for j, row, column in reversed(columns):
        yield f"r{row} = r{row} * hard[{j}];"
        yield from (f"r{row} = r{row} - hard[{i}] * r{below[i]};" for i in column)


def _write(schur: SchurStepper) -> Iterator[str]:
    k, m = schur.k, schur.nconstraint
    yield "const double *restrict m = w->inverse_mass;"
    yield "const ph_lane *restrict slot = w->slot, *restrict f = w->f, *restrict row = w->row;"
    yield from (f"ph_lane a{d} = w->force[{d}];" for d in range(schur.ndof))
    for first, last, open_, close in ((0, m, "", ""), (m, m + schur.nstrain, "if (w->carry) {", "}")):
        yield from [open_] * bool(open_)
        for r, entries in enumerate(_rows(schur, first, last), first):
            for e, a, b in entries:
                yield f"a{a} -= m[{a}] * slot[{e}] * row[{r}];"
                if b < schur.ndof:
                    yield f"a{b} += m[{b}] * slot[{e}] * row[{r}];"
        yield from [close] * bool(close)
    for d in range(schur.ndof):
        yield f"const ph_lane q{d} = w->h * f[{d}], v{d} = w->h * a{d};"
    for i in range(k):
        yield from (f"y[{schur.w_position[d * k + i]}] = q{d}[{i}];" for d in range(schur.ndof))
        yield from (f"y[{schur.w_velocity[d * k + i]}] = v{d}[{i}];" for d in range(schur.ndof))
        yield from (f"y[{schur.costate[d * k + i]}] = f[{d}][{i}];" for d in range(schur.ndof))
    for r in range(m):
        yield f"y[{schur.w_mu[r]}] = w->multiplier[{r}][PH_K];"
        yield from (f"y[{schur.w_lambda[r * k + i]}] = w->multiplier[{r}][{i}];" for i in range(k))
