"""Functions of the Schur stepper as C text: lanes where an operand is one, single numbers else."""

from __future__ import annotations

import re
from collections.abc import Sequence

import casadi as ca

from phfmu.schur.lane_groups import LaneGroup, in_order
from phfmu.schur.lanes import LaneKernel
from phfmu.schur.stepper import SchurStepper

#: operations that vectors have too
ARITHMETIC = {
    ca.OP_ADD: "{a} + {b}", ca.OP_SUB: "{a} - {b}", ca.OP_MUL: "{a} * {b}", ca.OP_DIV: "{a} / {b}",
    ca.OP_NEG: "-{a}", ca.OP_SQ: "{a} * {a}", ca.OP_TWICE: "{a} + {a}", ca.OP_INV: "1.0 / {a}",
}  # fmt: skip
#: operations of numbers: name, and expression in x, and y
LOGIC = {
    ca.OP_LT: ("lt", "x < y"), ca.OP_LE: ("le", "x <= y"), ca.OP_EQ: ("eq", "x == y"), ca.OP_NE: ("ne", "x != y"),
    ca.OP_AND: ("and", "x && y"), ca.OP_OR: ("or", "x || y"), ca.OP_NOT: ("not", "!x"),
    ca.OP_IF_ELSE_ZERO: ("if", "x ? y : 0.0"), ca.OP_HYPOT: ("hypot", "hypot(x, y)"), ca.OP_FABS: ("fabs", "fabs(x)"),
}  # fmt: skip
POWER = (ca.OP_POW, ca.OP_CONSTPOW)
FUNCTIONS = {
    ca.OP_SQRT: "sqrt", ca.OP_EXP: "exp", ca.OP_LOG: "log", ca.OP_SIN: "sin", ca.OP_COS: "cos", ca.OP_TAN: "tan",
    ca.OP_TANH: "tanh", ca.OP_ASIN: "asin", ca.OP_ACOS: "acos", ca.OP_ATAN: "atan", ca.OP_SINH: "sinh",
    ca.OP_COSH: "cosh", ca.OP_LOG1P: "log1p", ca.OP_EXPM1: "expm1",
    ca.OP_ERF: "erf", ca.OP_ASINH: "asinh", ca.OP_ACOSH: "acosh", ca.OP_ATANH: "atanh",
}  # fmt: skip
#: expression of an operation of numbers by its name
EXPRESSIONS = dict(LOGIC.values()) | {f: f"{f}(x)" for f in FUNCTIONS.values()} | {"pow": "pow(x, y)"}

#: operands: the same for all runs, a number of each run, a lane of each run, one that is not read at the end (lanes.h)
CONSTANT, NUMBER, LANE, INNER = range(4)
TYPES = ("double", "ph_real", "ph_lane", "ph_inner")
PREFIXES = ("", "number", "lane", "inner")
#: conversions of one into another
RAISED = {
    (CONSTANT, NUMBER): "PH_REAL_SPREAD", (CONSTANT, LANE): "PH_CONSTANT", (NUMBER, LANE): "PH_SPREAD",
    (CONSTANT, INNER): "PH_INNER_CONSTANT", (NUMBER, INNER): "PH_INNER_SPREAD", (LANE, INNER): "PH_INNER",
}  # fmt: skip

#: the loops of a model with more degrees of freedom, or instances, are not written out
MOST = 40

#: kinds that a sweep evaluates
SWEPT = ("constraint", "strain", "force")

#: models without a Schur stepper, and compilers without vectors
NO_STEPPER = "static const ph_schur_code ph_schur_solver = {0};\n"

#: per kind: macro of lane.inc, what its arguments and results are
KINDS = {
    "constraint": ("CONSTRAINT", (LANE, INNER, NUMBER), (LANE, INNER)),
    "strain": ("STRAIN", (INNER, NUMBER), (INNER,)),
    "force": ("FORCE", (INNER, INNER, INNER, NUMBER), (INNER,)),
    "pointwise": ("POINTWISE", (INNER, NUMBER), (INNER, INNER)),
    "stress": ("STRESS", (NUMBER, NUMBER, NUMBER), (NUMBER, NUMBER)),
    "start": ("START", (NUMBER, NUMBER), (NUMBER,)),
    "mass": ("MASS", (NUMBER,), (NUMBER,)),
    "load": ("LOAD", (NUMBER,), (NUMBER,)),
}


def kernel_text(kernel: LaneKernel) -> str:
    """C definition of the function of a kernel."""
    return function_text(kernel.name, kernel.function, *KINDS[kernel.kind][1:])


def function_text(name: str, f: ca.Function, kinds: Sequence[int], results: Sequence[int]) -> str:
    """C definition of one function: pointers to its arguments, then to its results, of these kinds of operands."""
    arguments = [f"const {TYPES[kind]} *a{i}" for i, kind in enumerate(kinds)]
    arguments += [f"{TYPES[kind]} *r{i}" for i, kind in enumerate(results)]
    lines = []
    held: dict[int, tuple[str, int]] = {}  # work place -> (C name or number, what it is)
    for i in range(f.n_instructions()):
        op, inputs, outputs = f.instruction_id(i), f.instruction_input(i), f.instruction_output(i)
        if op == ca.OP_INPUT:
            held[outputs[0]] = (f"a{inputs[0]}[{inputs[1]}]", kinds[inputs[0]])
        elif op == ca.OP_CONST:
            held[outputs[0]] = (_number(f.instruction_constant(i)), CONSTANT)
        elif op == ca.OP_OUTPUT:
            value = _raised(held[inputs[0]], results[outputs[0]])
            lines.append(f"    r{outputs[0]}[{outputs[1]}] = {value};")
        else:
            text, kind = _operation(op, [held[j] for j in inputs])
            lines.append(f"    const {TYPES[kind]} t{i} = {text};")
            held[outputs[0]] = (f"t{i}", kind)
    return f"PH_INLINE void {name}({', '.join(arguments)}) {{\n" + "\n".join(lines) + "\n}\n"


def _number(value: float) -> str:
    return f"({value!r})" if value < 0 else repr(value)


def _operation(op: int, operands: Sequence[tuple[str, int]]) -> tuple[str, int]:
    """C text of an operation and the type of its result: arithmetic has constants as they are."""
    kind = max(of for _, of in operands)
    if op in ARITHMETIC:
        a, b = (text if of == CONSTANT else _raised((text, of), kind) for text, of in (operands[0], operands[-1]))
        return ARITHMETIC[op].format(a=a, b=b), kind
    name = "pow" if op in POWER else LOGIC[op][0] if op in LOGIC else FUNCTIONS[op]
    kind = max(kind, NUMBER)
    arguments = ", ".join(_raised(operand, kind) for operand in operands)
    return f"{PREFIXES[kind]}_{name}({arguments})", kind


def _raised(operand: tuple[str, int], kind: int) -> str:
    text, of = operand
    return text if of == kind else f"{RAISED[of, kind]}({text})"


def is_small(schur: SchurStepper) -> bool:
    """Are the loops over the tables of this model written out?"""
    return schur.ndof <= MOST and sum(g.n for g in schur.groups if g.kernel.kind in SWEPT) <= MOST


def stepper_text(schur: SchurStepper, tables: str) -> str:
    """Functions, their loops, and the stepper for the nodes of a step.

    `tables`: those of `schur` as C, which a small model has beside its functions, under the name `small_tables`.
    """
    functions = {kernel.name: kernel for g in schur.groups for kernel in (g.kernel, g.stress) if kernel}
    bodies = "".join(kernel_text(functions[name]) for name in sorted(functions))
    text = f'\n#if defined(__GNUC__)\n#define PH_K {schur.k}\n{_small(schur, tables)}#include "lanes.h"\n\n'
    text += operations_text(bodies) + bodies + "\n"
    loops = {_loop_name(g): g for g in schur.groups}
    text += "".join(_loop(name, loops[name]) for name in sorted(loops)) + _calls(schur)
    return text + f'#include "schur.inc"\n#else\n{NO_STEPPER}#endif\n'


def operations_text(bodies: str) -> str:
    """C definitions of the functions of lanes and of numbers that bodies call."""
    text, found = "", sorted(set(re.findall(r"\b(number|lane|inner)_(\w+)\(", bodies)))
    for kind, f in found:
        if kind != "number":
            text += f"PH_LANE_POWER({kind})\n" if f == "pow" else f"PH_LANE_FUNCTION({kind}, {f})\n"
            continue
        count = "TWO" if re.search(r"\by\b", EXPRESSIONS[f]) else "ONE"
        text += f"PH_NUMBER_OF_{count}({f}, {EXPRESSIONS[f]})\n"
    return text


def _small(schur: SchurStepper, tables: str) -> str:
    light = f"#define PH_LIGHT {len(schur.light)}\n" if len(schur.light) else ""
    if not is_small(schur):
        return light
    return light + f"#define PH_SMALL {schur.ndof}\n#define PH_SMALL_ENTRIES {schur.hard.nentry}\n" + tables


def _loop_name(group: LaneGroup) -> str:
    """Name of the loops of a group; a strain's belong to its stresses too."""
    return "_".join(["loop", group.kernel.name, *([group.stress.name] if group.stress else [])])


def _loop(name: str, group: LaneGroup) -> str:
    kernel, stress = group.kernel, group.stress
    more = {KINDS[stress.kind][0]: stress.name, "RELAX": f"{name}_relax"} if stress else {}
    return include(kernel, {"NAME": name} | more, "lane.inc")


def include(kernel: LaneKernel, macros: dict[str, str], file: str) -> str:
    """The include of loops over the instances of a kernel with its sizes and these macros."""
    macros = {"KERNEL": kernel.name, KINDS[kernel.kind][0]: ""} | macros
    sizes = {"NX": kernel.nx, "NZ": kernel.nz, "NU": kernel.nu, "NP": kernel.np, "NO": kernel.no}
    return (
        "".join(f"#define PH_{m} {v}".rstrip() + "\n" for m, v in (macros | sizes).items()) + f'#include "{file}"\n\n'
    )


def _calls(schur: SchurStepper) -> str:
    """The loops of all groups: those of tile t of a sweep, and the others as a whole."""
    groups = [(i, _loop_name(g), g.kernel.kind) for i, g in enumerate(in_order(schur.groups))]
    whole = "{loop}(g + {i}, s, 0, g[{i}].n);"
    parts = [
        ("sweep_groups", ", int t", SWEPT, "{loop}(g + {i}, s, g[{i}].until[t], g[{i}].until[t + 1]);"),
        ("relax_groups", "", ("strain",), "{loop}_relax(g + {i}, s);"),
        ("start_groups", "", ("start",), whole),
        ("parameter_groups", "", ("mass", "load"), whole),
    ]
    text = ""
    for name, more, kinds, call in parts:
        body = "".join(f"    {call.format(loop=loop, i=i)}\n" for i, loop, kind in groups if kind in kinds)
        text += f"static PH_WRITTEN void {name}(const ph_lane_group *g, const ph_sweep *s{more}) {{\n{body}}}\n\n"
    return text
