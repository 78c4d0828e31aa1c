"""The common part of native instances of a model: the runtime, tables and code, made once."""

from __future__ import annotations

import ctypes
from dataclasses import dataclass, replace
from threading import RLock
from typing import get_args
from weakref import WeakKeyDictionary

from phfmu.engine.build.kernels import Kernels
from phfmu.engine.build.tables import CTables
from phfmu.engine.model import EngineModel, first, kernels
from phfmu.engine.native.code import Announce, Code, InterpretedCode, Kind, code_of
from phfmu.engine.native.library import runtime


@dataclass(frozen=True)
class NativeModel:
    """The runtime, tables, kernels and code of a model, which its instances share and never write to."""

    lib: ctypes.CDLL
    tables: CTables
    kernels: Kernels
    code: Code


#: native models whose kernels may be compiled, and those that were asked for interpreted
_MODELS: dict[bool, WeakKeyDictionary[EngineModel, NativeModel]] = {
    False: WeakKeyDictionary(),
    True: WeakKeyDictionary(),
}


#: threads of a sweep begin with the same model at the same time
_ONE = RLock()


def native_model(model: EngineModel, kind: Kind = "auto", announce: Announce = None) -> NativeModel:
    """The common part of the instances of a model; `announce` is called before a compiler runs that has to be waited for."""
    if kind not in get_args(Kind):
        raise ValueError(f"kernels '{kind}': expected auto, compiled or interpreted")
    with _ONE:
        return _native_model(model, kind, announce)


def _native_model(model: EngineModel, kind: Kind, announce: Announce) -> NativeModel:
    known = _MODELS[kind == "interpreted"]
    found, alike = known.get(model), first(model)
    if found is None and alike is not None:
        shared = _native_model(alike, kind, announce)
        found = known[model] = replace(shared, tables=shared.tables.like(model))
    elif found is None:
        _, lib = runtime(announce)
        own = Kernels(kernels(model))
        code = code_of(own, model.step.schur, kind, own.work(model.step), announce)
        found = known[model] = NativeModel(lib, CTables(model, own.index, code.address), own, code)
    if kind == "compiled" and isinstance(found.code, InterpretedCode):
        if model.step.schur is not None:  # begun without a compiler, which would have been waited for
            del known[model]
            return _native_model(model, kind, announce)
        found.code.compile(announce)
    return found
