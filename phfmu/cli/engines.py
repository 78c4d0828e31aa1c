"""The engine that steps a model: Python, native, or a unit that is exported for the run."""

from __future__ import annotations

import sys
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from phfmu.declare.phdae import PHDAE


def engine_of(engine: str) -> str:
    """`auto` resolved: native if a compiler is found, else python, which is said on stderr."""
    if engine != "auto":
        return engine
    from phfmu.engine.compile import CompilerMissing, require_compiler

    try:
        require_compiler()
    except CompilerMissing as error:
        print(f"phfmu: no C compiler ({error}); using the Python engine", file=sys.stderr)
        return "python"
    return "native"


def instance_of(model: Any, engine: str) -> Any:
    """A Python or native instance of a discretised model."""
    from phfmu.engine.switched import stepped

    if engine == "python":
        from phfmu.engine.python import PythonInstance

        return stepped(model, PythonInstance)
    from phfmu.engine.native import NativeInstance

    return stepped(model, lambda m: NativeInstance(m, _announce))


def _announce() -> None:
    """The first run of a set of equations on a machine waits for the compiler; say so on a terminal."""
    if sys.stderr.isatty():
        print("phfmu: compiling the equations for this machine, once (--engine python runs without)", file=sys.stderr)


def as_fmu(
    declaration: PHDAE,
    scheme: Any,
    fmi: str | None,
    step: float,
    node_inputs: bool = False,
    impulses: bool = False,
) -> Any:
    """The declaration exported to a temporary folder and loaded again."""
    import atexit
    import shutil
    import tempfile

    from phfmu.discretise.model import build_model
    from phfmu.fmu.export import export
    from phfmu.fmu.reader import FMUInstance
    from phfmu.fmu.version import LATEST

    folder = tempfile.mkdtemp(prefix="phfmu-")
    atexit.register(shutil.rmtree, folder, ignore_errors=True)
    model, versions = build_model(declaration, scheme), (fmi or LATEST,)
    modes = {*model.declaration.modes}  # which state events set, inside the unit
    tunable = [n for v in declaration.parameters if not v.signal for n in v.names() if n not in modes]
    (path,) = export(
        model, folder, versions, step=step, node_inputs=node_inputs, impulses=impulses, tunable=tunable
    )  # fmt: skip
    return FMUInstance(path)
