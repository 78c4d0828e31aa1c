"""The common part of native instances of a model: the runtime, tables and code, made once."""

from __future__ import annotations

import ctypes
from dataclasses import dataclass, replace
from threading import RLock
from typing import get_args
from weakref import WeakKeyDictionary

from phfmu.engine.build.kernels import Kernels
from phfmu.engine.build.tables import CTables
from phfmu.engine.model import Model, first, kernels
from phfmu.engine.native.code import Announce, Code, Interpreted, Kind, code_of
from phfmu.engine.native.library import runtime


@dataclass(frozen=True)
class Made:
    """The part that instances share and never write to."""

    lib: ctypes.CDLL
    tables: CTables
    kernels: Kernels
    code: Code


#: those whose kernels may be compiled, and those that were asked for interpreted
_MADE: dict[bool, WeakKeyDictionary[Model, Made]] = {False: WeakKeyDictionary(), True: WeakKeyDictionary()}


#: threads of a sweep begin with the same model at the same time
_ONE = RLock()


def made_of(model: Model, kind: Kind = "auto", announce: Announce = None) -> Made:
    """The common part for a model; `announce` is called before a compiler runs that has to be waited for."""
    if kind not in get_args(Kind):
        raise ValueError(f"kernels '{kind}': expected auto, compiled or interpreted")
    with _ONE:
        return _made(model, kind, announce)


def _made(model: Model, kind: Kind, announce: Announce) -> Made:
    known = _MADE[kind == "interpreted"]
    made, alike = known.get(model), first(model)
    if made is None and alike is not None:
        shared = _made(alike, kind, announce)
        made = known[model] = replace(shared, tables=shared.tables.like(model))
    elif made is None:
        _, lib = runtime(announce)
        found = Kernels(kernels(model))
        code = code_of(found, model.step.schur, kind, found.work(model.step), announce)
        made = known[model] = Made(lib, CTables(model, found.index, code.address), found, code)
    if kind == "compiled" and isinstance(made.code, Interpreted):
        if model.step.schur is not None:  # begun without a compiler, which would have been waited for
            del known[model]
            return _made(model, kind, announce)
        made.code.compile(announce)
    return made
