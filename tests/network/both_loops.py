"""The same network in the loop in Python and in the compiled one."""

from __future__ import annotations

from dataclasses import replace
from typing import Any

from phfmu import (
    Collocated,
    EngineMember,
    NativeInstance,
    Network,
    build_model,
)

SAME = 1e-12  # of the size of a column: rounding


def members(net: Network, k: int, engine: Any = NativeInstance) -> list[Any]:
    models = {n: build_model(replace(d, name=n), Collocated(k)) for n, d in net.declared.items()}
    return [EngineMember(n, m, engine(m)) for n, m in models.items()]
