"""The compiled master as Python sees it: the structures of `runtime/master.h`, and its functions of the runtime."""

from __future__ import annotations

import ctypes
from functools import cache
from pathlib import Path

from phfmu.engine.native.library import drivers
from phfmu.engine.native.structures import Header
from phfmu.network.couplings.acceptance import RULES
from phfmu.outcome.limits import defined

RUNTIME = Path(__file__).parent.parent / "runtime"
#: prefixes of the versions of the standard whose functions it calls
CALLED = ("fmi2", "fmi3")
HEADERS = (
    RULES,
    *(RUNTIME / f"{name}.h" for name in ("clock", "native", "unit", "held", "master", "anderson", "in_turn")),
)
STRUCTURES = (
    "ph_rules",
    "ph_progress",
    "ph_clock",
    "ph_native",
    "ph_scalars",
    "ph_unit",
    "ph_share",
    "ph_master",
    "ph_anderson",
    "ph_in_turn",
    "ph_held",
)
#: steps that tell the start of a run
START_TRIALS = int(defined(RUNTIME / "master.h")["START_TRIALS"])
HEADER = Header(HEADERS, STRUCTURES)


@cache
def library() -> ctypes.CDLL:
    """The library with the signatures of the master; CompilerMissing, CompileError."""
    lib = drivers()
    pointer, integer = ctypes.c_void_p, ctypes.c_int
    lib.ph_master_lu_size.restype, lib.ph_master_lu_size.argtypes = ctypes.c_size_t, [integer] * 3
    lib.ph_master_lu_init.restype, lib.ph_master_lu_init.argtypes = None, [pointer]
    run = lib.ph_master_run
    run.restype, run.argtypes = (
        integer,
        [pointer, *[ctypes.c_double] * 2, integer, ctypes.c_longlong, integer],
    )
    prepare = lib.ph_master_prepare
    prepare.restype, prepare.argtypes = integer, [pointer, *[ctypes.c_double] * 2, integer, *[pointer] * 3]
    lib.ph_master_remembered.restype, lib.ph_master_remembered.argtypes = integer, [pointer]
    for name, arguments in (
        ("forget", [pointer]),
        ("save", [pointer] * 2),
        ("load", [pointer] * 2),
        ("further", [pointer, ctypes.c_double]),
    ):
        function = getattr(lib, f"ph_master_{name}")
        function.restype, function.argtypes = None, arguments
    lib.ph_shares_finish.restype, lib.ph_shares_finish.argtypes = integer, [pointer, integer]
    lib.ph_crew_size.restype, lib.ph_crew_size.argtypes = ctypes.c_size_t, []
    solvers = (f"ph_solver_{name}" for name in ("newton", "anderson", "in_turn"))
    for name in ("ph_kind_native", "ph_kind_unit", *(f"ph_unit_{prefix}" for prefix in CALLED), *solvers):
        getattr(lib, name).restype = pointer
    for name in ("ph_crew_init", "ph_crew_help", "ph_crew_end"):
        function = getattr(lib, name)
        function.restype, function.argtypes = None, [pointer]
    return lib
