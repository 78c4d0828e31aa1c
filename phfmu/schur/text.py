"""Functions of the Schur stepper as C text: lanes where an operand is one, single numbers else."""

from __future__ import annotations

import re
from collections.abc import Sequence

import casadi as ca

from phfmu.schur.lane_groups import LaneGroup
from phfmu.schur.lanes import LaneKernel
from phfmu.schur.stepper import SchurStepper
from phfmu.schur.unroll import unrolled

BINARY = {
    ca.OP_ADD: "{a} + {b}", ca.OP_SUB: "{a} - {b}", ca.OP_MUL: "{a} * {b}", ca.OP_DIV: "{a} / {b}",
    ca.OP_LT: "{a} < {b}", ca.OP_LE: "{a} <= {b}", ca.OP_EQ: "{a} == {b}", ca.OP_NE: "{a} != {b}",
    ca.OP_AND: "{a} && {b}", ca.OP_OR: "{a} || {b}", ca.OP_IF_ELSE_ZERO: "{a} ? {b} : 0.0",
    ca.OP_HYPOT: "hypot({a}, {b})",
}  # fmt: skip
UNARY = {
    ca.OP_NEG: "-{a}", ca.OP_SQ: "{a} * {a}", ca.OP_TWICE: "{a} + {a}", ca.OP_INV: "1.0 / {a}", ca.OP_NOT: "!{a}",
    ca.OP_FABS: "fabs({a})",
}  # fmt: skip
FUNCTIONS = {
    ca.OP_SQRT: "sqrt", ca.OP_EXP: "exp", ca.OP_LOG: "log", ca.OP_SIN: "sin", ca.OP_COS: "cos", ca.OP_TAN: "tan",
    ca.OP_TANH: "tanh", ca.OP_ASIN: "asin", ca.OP_ACOS: "acos", ca.OP_ATAN: "atan", ca.OP_SINH: "sinh",
    ca.OP_COSH: "cosh", ca.OP_LOG1P: "log1p", ca.OP_EXPM1: "expm1",
    ca.OP_ERF: "erf", ca.OP_ASINH: "asinh", ca.OP_ACOSH: "acosh", ca.OP_ATANH: "atanh",
}  # fmt: skip

#: models without a Schur stepper, and compilers without vectors
NO_STEPPER = "const ph_schur_code ph_schur_solver = {0};\n"

#: per kind: macro of lane.inc, arguments that are lanes, results that are lanes
KINDS = {
    "constraint": ("CONSTRAINT", (True, True, False), (True, True)),
    "strain": ("STRAIN", (True, False), (True,)),
    "force": ("FORCE", (True, True, True, False), (True,)),
    "pointwise": ("POINTWISE", (True, False), (True, True)),
    "stress": ("STRESS", (False, False, False), (False, False)),
    "start": ("START", (False, False), (False,)),
    "mass": ("MASS", (False,), (False,)),
    "load": ("LOAD", (False,), (False,)),
}


def function_text(kernel: LaneKernel) -> str:
    """C definition of one function: pointers to its arguments, then to its results."""
    f, (_, lane_in, lane_out) = kernel.function, KINDS[kernel.kind]
    types = ["double", "ph_lane"]
    arguments = [f"const {types[lane]} *a{i}" for i, lane in enumerate(lane_in)]
    arguments += [f"{types[lane]} *r{i}" for i, lane in enumerate(lane_out)]
    lines = []
    held: dict[int, tuple[str, bool]] = {}  # work place -> (C name or number, is it a lane)
    for i in range(f.n_instructions()):
        op, inputs, outputs = f.instruction_id(i), f.instruction_input(i), f.instruction_output(i)
        if op == ca.OP_INPUT:
            held[outputs[0]] = (f"a{inputs[0]}[{inputs[1]}]", lane_in[inputs[0]])
        elif op == ca.OP_CONST:
            held[outputs[0]] = (_number(f.instruction_constant(i)), False)
        elif op == ca.OP_OUTPUT:
            name, is_lane = held[inputs[0]]
            spread = lane_out[outputs[0]] and not is_lane
            lines.append(f"    r{outputs[0]}[{outputs[1]}] = {f'PH_SPREAD({name})' if spread else name};")
        else:
            text, is_lane = _operation(op, [held[j] for j in inputs])
            lines.append(f"    const {types[is_lane]} t{i} = {text};")
            held[outputs[0]] = (f"t{i}", is_lane)
    return f"PH_INLINE void {kernel.name}({', '.join(arguments)}) {{\n" + "\n".join(lines) + "\n}\n"


def _number(value: float) -> str:
    return f"({value!r})" if value < 0 else repr(value)


def _operation(op: int, operands: Sequence[tuple[str, bool]]) -> tuple[str, bool]:
    (a, is_lane), (b, lane_b) = operands[0], operands[-1]
    if op in BINARY:
        return BINARY[op].format(a=a, b=b), is_lane or lane_b
    if op in UNARY:
        return UNARY[op].format(a=a), is_lane
    if op in (ca.OP_POW, ca.OP_CONSTPOW):
        if is_lane or lane_b:
            return f"lane_pow({_spread(a, is_lane)}, {_spread(b, lane_b)})", True
        return f"pow({a}, {b})", False
    return (f"lane_{FUNCTIONS[op]}({a})" if is_lane else f"{FUNCTIONS[op]}({a})"), is_lane


def _spread(name: str, is_lane: bool) -> str:
    return name if is_lane else f"PH_SPREAD({name})"


def loop_name(group: LaneGroup) -> str:
    """Name of the loops of a group; a strain's belong to its stresses too."""
    return "_".join(["loop", group.kernel.name, *([group.stress.name] if group.stress else [])])


def stepper_text(schur: SchurStepper) -> str:
    """Functions, their loops, and the solver for the nodes of a step."""
    k, groups = schur.k, schur.groups
    functions = {kernel.name: kernel for g in groups for kernel in (g.kernel, g.stress) if kernel}
    bodies = "".join(function_text(functions[name]) for name in sorted(functions))
    used = sorted(set(re.findall(r"\blane_(\w+)\(", bodies)))
    text = f'\n#if defined(__GNUC__)\n#define PH_K {k}\n#include "lanes.h"\n\n'
    text += "".join("PH_LANE_POWER\n" if f == "pow" else f"PH_LANE_FUNCTION({f})\n" for f in used) + bodies + "\n"
    loops = {loop_name(g): g for g in groups}
    rows = []
    for name in sorted(loops):
        kernel, stress = loops[name].kernel, loops[name].stress
        macros = {"NAME": name, "KERNEL": kernel.name, KINDS[kernel.kind][0]: ""}
        macros |= {KINDS[stress.kind][0]: stress.name, "RELAX": f"{name}_relax"} if stress else {}
        macros |= {"NX": kernel.nx, "NZ": kernel.nz, "NU": kernel.nu, "NP": kernel.np, "NO": kernel.no}
        text += "".join(f"#define PH_{m} {v}".rstrip() + "\n" for m, v in macros.items()) + '#include "lane.inc"\n\n'
        rows.append(f"{{{name}, {f'{name}_relax' if stress else 0}}}")
    text += f"static const ph_lane_loop ph_lane_loops[] = {{{', '.join(rows)}}};\n\n"
    return text + f'{unrolled(schur)}#include "schur.inc"\n#else\n{NO_STEPPER}#endif\n'


def loop_index(groups: Sequence[LaneGroup]) -> dict[str, int]:
    """Place of each loop in the table of loops."""
    return {name: i for i, name in enumerate(sorted({loop_name(g) for g in groups}))}
