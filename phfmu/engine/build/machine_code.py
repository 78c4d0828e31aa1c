"""Functions of CasADi in machine code."""

from __future__ import annotations

from pathlib import Path

import casadi as ca

from phfmu.engine.build.compile import CompilerMissing, compile


def compiled(f: ca.Function, jacobians: bool = False) -> ca.Function:
    """`f` compiled with the project's flags and loaded as an external; `f` itself without a C compiler.

    jacobians: with its derivatives, for solvers that ask the function for them.
    """
    generator = ca.CodeGenerator(f"{f.name()}.c", {"with_header": False})
    generator.add(f)
    if jacobians:
        generator.add(f.forward(1))
        generator.add(f.reverse(1))
        generator.add(f.jacobian())
    try:
        # symbols must stay visible for the loader
        path: Path = compile({f"{f.name()}.c": generator.dump()}, flags=("-fvisibility=default",)).path
    except CompilerMissing:
        return f
    return ca.external(f.name(), str(path))
