"""Every operation of CasADi's scalar functions: interpreted and compiled give the same bits, whatever the numbers are.

NaN is NaN whatever its sign and payload, which the processor takes from whichever operand the compiler puts first.
"""

from __future__ import annotations

import ctypes

import casadi as ca
import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from phfmu.engine.build.compile import CompilerMissing, host_flags, require_compiler
from phfmu.engine.build.operations import NotInterpreted, interpreted, names, operations
from phfmu.engine.native import code
from phfmu.engine.native.code import Functions

#: operations of scalar functions that are compiled only
COMPILED_ONLY = {
    "ERFINV": "CasADi writes it as a function of its own, of some sixty operations",
    "PRINTME": "it prints",
}
#: not operations on numbers
OTHER = {"CONST", "INPUT", "OUTPUT", "PARAMETER", "CALL", "ASSIGN", "LIFT"}
#: instances of each operation: segments as long as lanes and not
N = 7
CONSTANTS = (0.0, -0.0, 1.0, -1.0, 0.5, -0.5, 2.0, 3.0, 10.0, 1 / 3, 2.5, np.inf, 1e-320)
FOLDED = (
    "POW",
    "CONSTPOW",
    "FMIN",
    "FMAX",
    "ATAN2",
    "HYPOT",
    "FMOD",
    "REMAINDER",
    "COPYSIGN",
    "IF_ELSE_ZERO",
    "MUL",
    "DIV",
)


def scalar() -> dict[str, int]:
    """Name -> operands of the operations that a function of scalars has."""
    x, y, found = ca.SX.sym("x"), ca.SX.sym("y"), {}
    for op, name in names().items():
        if name in OTHER:
            continue
        f = ca.Function("f", [x, y], [ca.SX.binary(op, x, y)])
        ids = [f.instruction_id(i) for i in range(f.n_instructions())]
        if op in ids:
            found[name] = ids.count(ca.OP_INPUT)
        elif name == "CONSTPOW":
            found[name] = 2
    return found


def cases() -> dict[str, list[ca.SX]]:
    """Each operation on N pairs of numbers; with constants, which compilers know rules for; and what they might contract."""
    x, y = ca.SX.sym("x", N), ca.SX.sym("y", N)
    found = {}
    for op, (_, arity) in interpreted().items():
        pairs = [(x[i], y[i]) for i in range(N)]
        found[names()[op]] = [ca.SX.binary(op, *p) if arity == 2 else ca.SX.unary(op, p[0]) for p in pairs]
    for name in FOLDED:
        op = getattr(ca, f"OP_{name}")
        for c in CONSTANTS:
            found[f"{name}(x, {c!r})"] = [ca.SX.binary(op, x[i], ca.SX(c)) for i in range(N)]
            found[f"{name}({c!r}, x)"] = [ca.SX.binary(op, ca.SX(c), x[i]) for i in range(N)]
    found["x y + x"] = [x[i] * y[i] + x[i] for i in range(N)]
    found["exp(log x)"] = [ca.exp(ca.log(x[i])) for i in range(N)]
    found["exp x exp y"] = [ca.exp(x[i]) * ca.exp(y[i]) for i in range(N)]
    found["sqrt(x x)"] = [ca.sqrt(x[i] * x[i]) for i in range(N)]
    found["x / 3 + y / 3"] = [x[i] / 3 + y[i] / 3 for i in range(N)]
    found["arguments"] = [x, y]
    return found


def _function() -> tuple[list[str], ca.Function]:
    found = cases()
    every = [ca.densify(ca.vertcat(*e)) for e in found.values()]
    x, y = found["arguments"]
    labels = [name for name, e in zip(found, every, strict=True) for _ in range(e.numel())]
    return labels, ca.Function("every", [x, y], [ca.vertcat(*every)])


class Called:
    """A function through its ph_function."""

    def __init__(self, f: ca.Function, made: Functions):
        self._made, self._row = made, code.FunctionRow.from_address(made.of(0))
        pointer = ctypes.c_void_p
        call = ctypes.CFUNCTYPE(ctypes.c_int, *[pointer] * 5, ctypes.c_int)(self._row.call)
        self._out = np.zeros(f.nnz_out(0))
        self._w, self._iw = np.zeros(self._row.w + 1), np.zeros(self._row.iw + 1, np.int32)
        self._call = lambda arguments: call(
            made.of(0), (pointer * max(2, self._row.arg))(*(a.ctypes.data for a in arguments)),
            (pointer * max(1, self._row.res))(self._out.ctypes.data), self._iw.ctypes.data, self._w.ctypes.data, 0,
        )  # fmt: skip

    def __call__(self, *arguments: np.ndarray) -> np.ndarray:
        assert self._call(arguments) == 0
        return self._out.copy()


def same(a: np.ndarray, b: np.ndarray) -> np.ndarray:
    """Which are: the same bits, or both no number."""
    return (a.view(np.int64) == b.view(np.int64)) | (np.isnan(a) & np.isnan(b))


@pytest.fixture(scope="module", params=["zig", "cc"])
def both(request: pytest.FixtureRequest) -> tuple[list[str], Called, Called]:
    """What is called, interpreted and compiled; the runtime is of the first compiler that is found, kernels of either."""
    try:
        require_compiler()
    except CompilerMissing as missing:
        pytest.skip(str(missing))
    labels, f = _function()
    plain, flags = code.compile, host_flags(request.param)
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(code, "compile", lambda s, **_: plain(s, flags=flags, compiler=request.param))
        try:
            compiled = Functions([f], compiled=True)
        except CompilerMissing as missing:
            pytest.skip(str(missing))
    return labels, Called(f, Functions([f], compiled=False)), Called(f, compiled)


def test_every_scalar_operation_is_interpreted_or_compiled_only() -> None:
    known = {names()[op]: arity for op, (_, arity) in interpreted().items()}
    found = scalar()
    assert known.keys() | COMPILED_ONLY.keys() == found.keys() and not known.keys() & COMPILED_ONLY.keys()
    assert {n: arity for n, arity in found.items() if n in known} == known


NUMBERS = st.floats(allow_nan=True, allow_infinity=True, allow_subnormal=True) | st.sampled_from(
    [0.0, -0.0, 1.0, -1.0, 0.5, 2.0, 1e-310, 5e-324, 1e308, np.inf, -np.inf, np.nan, 709.8, -745.2, np.pi / 2]
) | st.floats(-10, 10)  # fmt: skip


@settings(max_examples=400, deadline=None)
@given(x=st.lists(NUMBERS, min_size=N, max_size=N), y=st.lists(NUMBERS, min_size=N, max_size=N))
def test_every_operation_gives_the_same_bits(both, x: list[float], y: list[float]) -> None:
    labels, one, other = both
    arguments = np.array(x), np.array(y)
    a, b = one(*arguments), other(*arguments)
    wrong = ~same(a, b)
    assert not wrong.any(), [(labels[i], a[i], b[i]) for i in np.flatnonzero(wrong)][:5]


def test_operations_are_those_of_casadi(both) -> None:
    """Against CasADi's own interpreter, where the standard leaves nothing open: not signs of zeros from fmin and fmax."""
    labels, one, _ = both
    _, f = _function()
    rng = np.random.default_rng(3)
    for _ in range(50):
        arguments = rng.normal(size=N) * 3, rng.normal(size=N)
        expected = np.array(f(*arguments)).ravel()
        found = one(*arguments)
        with np.errstate(invalid="ignore"):
            close = np.abs(found - expected) <= 1e-14 * np.abs(expected)
        close |= same(found, expected)
        assert close.all(), [(labels[i], found[i], expected[i]) for i in np.flatnonzero(~close)][:5]


@pytest.mark.parametrize("name", COMPILED_ONLY)
def test_what_is_compiled_only_is_told_by_name(name: str) -> None:
    x, y = ca.SX.sym("x"), ca.SX.sym("y")
    f = ca.Function("f", [x, y], [ca.SX.binary(getattr(ca, f"OP_{name}"), x, y)])
    with pytest.raises(NotInterpreted, match=f"^{name}: "):
        operations(f).program()


def test_results_alone_have_the_operations_that_they_need() -> None:
    x = ca.SX.sym("x", 2)
    f = ca.Function("f", [x], [ca.sin(x[0]) * 3, ca.vertcat(ca.exp(x[1]), x[0], 2.0)])
    table = operations(f)
    first = table.only(1)
    assert [names()[op] for op in first.code[:, 0]] == ["SIN", "MUL"]
    assert len(table.code) == len(first.code) + 1 and table.only(2).digest == table.digest
    assert operations(ca.Function("g", f.sx_in(), f.call(f.sx_in()))).digest == table.digest
