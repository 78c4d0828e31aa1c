"""Functions of the Schur stepper in reverse as C text, for the way back over its steps (`reverse/schur_back.inc`).

The bars of the results of a function become those of its arguments.  Bars of coordinates and rates are wanted in every sweep,
those of parameters and inputs once a step.
"""

from __future__ import annotations

import hashlib
from collections.abc import Sequence

import casadi as ca

from phfmu.schur.lane_groups import LaneGroup, in_order
from phfmu.schur.lanes import NUMBERS, LaneKernel, require_lanes
from phfmu.schur.stepper import SchurStepper
from phfmu.schur.text import INNER, KINDS, LANE, NUMBER, function_text, include, kernel_text, operations_text

#: per kind: places of the arguments whose bars a sweep wants, of those that are wanted once; results whose bars are given
PLACES = {
    "constraint": ((0, 1), (2,), 2),
    "strain": ((0,), (1,), 1),
    "force": ((0, 1), (2, 3), 1),
    "pointwise": ((0,), (1,), 1),
    "stress": ((0, 1), (2,), 1),
    "start": ((0, 1), (), 1),
    "mass": ((0,), (), 1),
    "load": ((0,), (), 1),
}
#: kinds that are evaluated at the solution of a step, and in a sweep of the way back
LINEAR, SWEPT = ("constraint", "strain"), ("constraint", "strain", "force")

HEAD = """\
/* Generated. The way back over steps of constrained particles. */
#include "schur_back.h"

#include "phfmu.h"
#if defined(__GNUC__)
#pragma GCC diagnostic ignored "-Wunused"
#define PH_INLINE static inline __attribute__((always_inline))
"""


def _depends(kernel: LaneKernel, by: Sequence[int]) -> bool:
    """Do the results whose bars are given depend on some of these arguments?"""
    args = kernel.function.sx_in()
    results = kernel.function.call(args)[: PLACES[kernel.kind][2]]
    return any(ca.depends_on(r, args[i]) for r in results for i in by if args[i].numel())


def _back(kernel: LaneKernel, by: Sequence[int]) -> tuple[str, str]:
    """Name and C text of the function in reverse, to the bars of the arguments `by`; NoLanes."""
    (_, lane_in, lane_out), n = KINDS[kernel.kind], PLACES[kernel.kind][2]
    args = kernel.function.sx_in()
    results = kernel.function.call(args)[:n]
    if kernel.kind == "mass":
        results = [1 / results[0]]  # m, which may be zero
    bars = [ca.SX.sym(f"b{i}", r.numel()) for i, r in enumerate(results)]
    whole = sum((ca.dot(b, r) for b, r in zip(bars, results, strict=True)), ca.SX(0))
    found = [ca.densify(ca.gradient(whole, args[i])) if args[i].numel() else ca.SX(0, 1) for i in by]
    made = ca.Function("f", [*args, *bars], ca.cse(found))
    require_lanes(kernel.kind, made)
    name = f"back_{hashlib.sha256((kernel.kind + made.serialize()).encode()).hexdigest()[:16]}"
    one = NUMBER if kernel.kind in NUMBERS else LANE
    kinds = [LANE if kind == INNER else kind for kind in (*lane_in, *lane_out[:n])]
    return name, function_text(name, made, kinds, [one] * len(by))


def back_text(schur: SchurStepper) -> str:
    """C text of `const ph_schur_back ph_schur_backwards`; NoLanes where a derivative has an operation that lanes do not have."""
    found: dict[str, str] = {}
    loops: dict[str, str] = {}
    calls: list[tuple[str, str]] = []
    for g in in_order(schur.groups):
        name, loops_text = _loops(g, found)
        loops[name] = loops_text
        calls.append((name, g.kernel.kind))
    kernels = {k.name: kernel_text(k) for g in schur.groups for k in (g.kernel, g.stress) if k}
    bodies = "".join(text for _, text in sorted((kernels | found).items()))
    light = f"#define PH_LIGHT {len(schur.light)}\n" if len(schur.light) else ""
    text = f'{HEAD}#define PH_K {schur.k}\n{light}#include "lanes_back.h"\n\n{operations_text(bodies)}{bodies}\n'
    text += "".join(loops[name] for name in sorted(loops))
    forward = "const ph_lane_group *g, const ph_sweep *s"
    backward = "const ph_lane_group *g, const ph_back_sweep *s"
    parts = [
        ("start_groups", forward, ("start",), "{loop}(g + {i}, s, 0, g[{i}].n);"),
        ("parameter_groups", forward, ("mass", "load"), "{loop}(g + {i}, s, 0, g[{i}].n);"),
        ("linear_groups", backward, LINEAR, "{loop}_linear(g + {i}, s);"),
        ("back_groups", f"{backward}, int last", SWEPT, "{loop}_back(g + {i}, s, last);"),
        ("end_groups", f"{backward}, int last", ("start", "mass", "load"), "{loop}_back(g + {i}, s, last);"),
    ]
    for name, arguments, kinds, call in parts:
        lines = "".join(f"    {call.format(loop=loop, i=i)}\n" for i, (loop, kind) in enumerate(calls) if kind in kinds)
        text += f"static void {name}({arguments}) {{\n{lines}}}\n\n"
    return text + '#include "schur_back.inc"\n#else\n' + NONE + "#endif\n"


NONE = "PH_API extern const ph_schur_back ph_schur_backwards;\nconst ph_schur_back ph_schur_backwards = {0};\n"


def _loops(g: LaneGroup, found: dict[str, str]) -> tuple[str, str]:
    """Name and text of the loops of a group; the functions in reverse that they call are put into `found`."""
    kernel, stress = g.kernel, g.stress
    name = "_".join(["loop", kernel.name, *([stress.name] if stress else [])])
    macros = {"LINEAR": f"{name}_linear", "BACK": f"{name}_back"}
    macros |= {KINDS[stress.kind][0]: stress.name} if stress else {}
    for label, k in (("KERNEL", kernel), *([("STRESS", stress)] if stress else [])):
        swept, once, _ = PLACES[k.kind]
        for suffix, by in (("BACK", swept), *([("ALONG", once)] if _depends(k, once) else [])):
            made, found_text = _back(k, by)
            macros[f"{label}_{suffix}"], found[made] = made, found_text
    forward = "" if kernel.kind in SWEPT else include(kernel, {"NAME": name}, "lane.inc")
    return name, forward + include(kernel, macros, "lane_back.inc")
