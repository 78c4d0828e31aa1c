"""The same network with members that the compiled master steps itself, and with the same members called back."""

from __future__ import annotations

from dataclasses import replace
from typing import Any
from unittest.mock import patch

from phfmu import (
    Collocated,
    Coupled,
    EngineMember,
    NativeInstance,
    Network,
    build_model,
)
from phfmu.network.couplings.compiled.called_share import CalledShare

SAME = 1e-12  # of the size of a column: rounding


def members(net: Network, k: int, engine: Any = NativeInstance) -> list[Any]:
    models = {n: build_model(replace(d, name=n), Collocated(k)) for n, d in net.declared.items()}
    return [EngineMember(n, m, engine(m)) for n, m in models.items()]


def called_back(stepper: Coupled, called: bool = True) -> Coupled:
    """The same, whose members are all called back if they are to be."""
    if called:
        with patch("phfmu.network.couplings.compiled.master.own_share", lambda _: CalledShare):
            assert stepper.master.calls
    return stepper


class Impatient(dict[bytes, Any]):
    """Masters that give an iteration up after so many trials."""

    def __init__(self, known: dict[bytes, Any], trials: int):
        self._trials = trials
        for key, master in known.items():
            self[key] = master

    def __setitem__(self, key: bytes, master: Any) -> None:
        master.rules.iterations = self._trials
        super().__setitem__(key, master)


def impatient(stepper: Coupled, trials: int = 1) -> Coupled:
    """The same, which begins as it should and then gives an iteration up after so many trials."""
    prepare = stepper.prepare

    def then_stopped(t0: float, h: float) -> None:
        prepare(t0, h)
        stepper._masters = Impatient(stepper._masters, trials)

    stepper.prepare = then_stopped  # type: ignore[method-assign]
    return stepper
