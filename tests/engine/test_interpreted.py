"""Interpreted kernels: the same bits as compiled ones, from the first step on; when compiled ones take their place."""

from __future__ import annotations

import time
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from phfmu import NativeInstance, Scene, build_model
from phfmu.components.library import LIBRARY, RUNS, build
from phfmu.declare.error import DeclarationError
from phfmu.engine.build.compile import CompilerMissing
from phfmu.engine.native import code as native_code
from phfmu.engine.native.code import COMPILING, SAVED, InterpretedCode
from phfmu.engine.native.native_model import native_model
from phfmu.engine.switched import stepped
from phfmu.outcome.status import StepFailure
from phfmu.schemes.named import named_scheme
from tests.sanitized import output
from tests.wide import turning, wide

ORDERS = (2, 4, 6)
USUAL = {("smib", 2), ("smib", 4), ("dc_motor", 6), ("four_particle", 2), ("bouncing_ball", 2), ("diode", 2)}
STEPS = 60


def model(name: str, order: int = 2) -> Any:
    """Of the library, without Schur stepper, and the step of its runs."""
    made = build(name)
    declaration = made.declaration() if isinstance(made, Scene) else made
    h = made.step if isinstance(made, Scene) else RUNS.get(name, (1, 1e-3))[1]
    found = build_model(declaration, named_scheme(declaration, "auto", order))
    return replace(found, step=replace(found.step, schur=None)), h


def told(instance: Any, h: float) -> tuple[list[bytes], str, dict[str, int], Any]:
    """Signals of every step, the refusal if there is one, counters, and derivatives."""
    rows, refusal, t0 = [], "", instance.model.t0
    try:
        for i in range(STEPS):
            instance.do_step(t0 + i * h, h)
            rows.append(b"".join(v.tobytes() for v in instance.signals().values()))
    except StepFailure as failure:
        refusal = str(failure)
    derivatives: Any = None
    try:
        if instance.model.step.nu and not refusal:
            found = instance.node_sensitivity(None, False, end=True)
            derivatives = [v.tobytes() for v in vars(found).values() if isinstance(v, np.ndarray)]
    except StepFailure as failure:
        derivatives = str(failure)
    return rows, refusal, instance.counts, derivatives


@pytest.mark.parametrize(("name", "order"), turning(LIBRARY, ORDERS, *sorted(USUAL)))
def test_the_library_gives_the_same_bits(compiler: None, name: str, order: int) -> None:
    """The whole signal table, counters, refusals; compiled kernels and tangents against interpreted ones."""
    try:
        found, h = model(name, order)
    except DeclarationError as refused:
        pytest.skip(str(refused))
    one, other = (stepped(found, lambda m, k=k: NativeInstance(m, kernels=k)) for k in ("compiled", "interpreted"))
    assert (one.kernels, other.kernels) == ("compiled", "interpreted")
    expected, seen = told(one, h), told(other, h)
    assert seen == expected and (len(seen[0]) == STEPS or seen[1])


@pytest.mark.parametrize("name", wide(["mass", "dc_motor", "rl_line", "synchronous_machine"], "dc_motor"))
def test_impulses_at_ports_give_the_same_bits(compiler: None, name: str) -> None:
    found, h = model(name)
    seen = []
    for kernels in ("compiled", "interpreted"):
        instance = NativeInstance(found, kernels=kernels)
        n = instance._ports.kernels.n
        if not n:
            pytest.skip("no port takes impulses")
        for i in range(5):
            instance.set_impulses(0.1 * np.arange(1, n + 1), -0.05 * np.arange(1, n + 1))
            instance.do_step(i * h, h)
        dy = instance.node_sensitivity(impulses=True, end=True)
        seen.append((instance.get_state(), instance.jump().tobytes(), *(v.tobytes() for v in vars(dy).values())))
    assert seen[0] == seen[1]


def test_a_state_saved_by_the_one_is_one_of_the_other(compiler: None) -> None:
    found, h = model("smib", 4)
    one, other = (NativeInstance(found, kernels=k) for k in ("compiled", "interpreted"))
    one.run(0.0, h, 20)
    other.set_state(one.get_state())
    one.run(20 * h, h, 20)
    other.run(20 * h, h, 20)
    assert one.get_state() == other.get_state()


class Uncached:
    """As if the cache had no kernels: what `auto` begins with."""

    def __init__(self, patch: pytest.MonkeyPatch) -> None:
        patch.setattr(native_code, "_found", lambda _: False)


@pytest.fixture
def uncached(monkeypatch: pytest.MonkeyPatch) -> None:
    Uncached(monkeypatch)


def enough(found: Any) -> float:
    """Steps that earn the compiler's time."""
    made = native_model(found, "interpreted")
    work = made.kernels.work(found.step)
    return (COMPILING[0] + COMPILING[1] * made.kernels.size) / (SAVED * work)


def compiled_soon(instance: NativeInstance) -> bool:
    late = time.monotonic() + 60
    while instance.kernels == "interpreted" and time.monotonic() < late:
        time.sleep(0.01)
    return instance.kernels == "compiled"


def test_a_short_run_stays_interpreted_and_a_long_one_begins_so(compiler: None, uncached: None) -> None:
    found, h = model("smib")
    short = NativeInstance(found, steps=enough(found) / 2)
    short.run(0.0, h, 10)
    time.sleep(0.05)
    assert short.kernels == "interpreted"
    other, _ = model("smib", 4)
    long = NativeInstance(other, steps=2 * enough(other))
    long.do_step(0.0, h)
    assert isinstance(native_model(other).code, InterpretedCode) and compiled_soon(long)


def test_steps_that_were_taken_count(compiler: None, uncached: None, monkeypatch: pytest.MonkeyPatch) -> None:
    """One by one, in runs, and those of other instances of the model."""
    monkeypatch.setattr(native_code, "SAVED", 1e-3)
    found, h = model("dc_motor")
    code = native_model(found).code
    assert isinstance(code, InterpretedCode)
    one, other = NativeInstance(found), NativeInstance(found)
    left = code._left
    one.do_step(0.0, h)
    one.do_step(h, 2 * h, 2)
    other.run(0.0, h, 5)
    assert code._left == left - 8
    other.expect(left)
    assert compiled_soon(one) and other.kernels == "compiled"
    one.do_step(3 * h, h)
    assert one._step is one._lib.ph_step


def test_compiled_kernels_that_come_in_between_change_no_bit(
    compiler: None, uncached: None, monkeypatch: pytest.MonkeyPatch
) -> None:
    """While steps go on, in a run and one by one; the saved state too."""
    found, h = model("smib", 4)
    twin = NativeInstance(found, kernels="interpreted")
    instance = NativeInstance(found)
    instance.expect(1e12)
    taken, switched = 0, 0
    while taken < 400 or (not switched and taken < 40000):
        instance.run(taken * h, h, 20)
        taken += 20
        switched = switched or (instance.kernels == "compiled" and taken)
    assert switched
    for i in range(0, taken, 20):
        twin.run(i * h, h, 20)
    assert twin.kernels == "interpreted" and instance.get_state() == twin.get_state()


def _missing(*_: Any, **__: Any) -> None:
    raise CompilerMissing("none here")


def test_without_a_compiler_a_model_runs_interpreted(compiler: None, monkeypatch: pytest.MonkeyPatch) -> None:
    found, h = model("smib")
    expected = told(NativeInstance(found, kernels="interpreted"), h)

    monkeypatch.setattr("phfmu.engine.build.compile._find", _missing)
    other, _ = model("smib")
    other = replace(other, x0=other.x0.copy())
    instance = NativeInstance(other)
    instance.expect(1e12)
    assert instance.kernels == "interpreted" and told(instance, h) == expected
    with pytest.raises(CompilerMissing):
        NativeInstance(other, kernels="compiled")


def test_tangents_do_without_a_compiler_that_kernels_had(compiler: None, monkeypatch: pytest.MonkeyPatch) -> None:
    found, h = model("dc_motor", 4)
    found = replace(found, x0=found.x0.copy())
    seen = []
    for kernels in ("interpreted", "compiled"):
        instance = NativeInstance(found, kernels=kernels)
        instance.do_step(0.0, 3 * h, 3)
        if kernels == "compiled":
            monkeypatch.setattr(native_code, "compile", _missing)
        seen.append((instance.sensitivity().tobytes(), instance.kernels))
    assert seen[0][0] == seen[1][0] and seen[1][1] == "compiled"


def test_a_model_with_a_schur_stepper_waits_for_the_compiler(compiler: None, uncached: None) -> None:
    found = build_model(build("four_particle"))
    assert NativeInstance(found).kernels == "compiled"
    one = NativeInstance(found, kernels="interpreted")
    one.do_step(0.0, 0.01)
    assert one.kernels == "interpreted" and one.counts["schur"] == 0 and one.counts["iterations"] > 0


def test_words_for_kernels(compiler: None) -> None:
    found, _ = model("mass")
    with pytest.raises(ValueError, match="kernels 'fast': expected auto, compiled or interpreted"):
        NativeInstance(found, kernels="fast")  # type: ignore[arg-type]


SANITIZED = """
import hashlib
from dataclasses import replace
from phfmu import NativeInstance, build_model
from phfmu.components.library import build
from phfmu.engine.switched import stepped
for name in ("dc_motor", "four_particle", "bouncing_ball", "diode"):
    made = build(name)
    made = made.declaration() if hasattr(made, "declaration") else made
    model = build_model(made)
    for kernels in ("compiled", "interpreted"):
        one = stepped(replace(model, step=replace(model.step, schur=None)), lambda m: NativeInstance(m, kernels=kernels))
        for i in range(20):
            one.do_step(i * 1e-3, 1e-3)
        one.do_step(0.02, 3e-3, 3)
        if model.step.nu and model.modes is None:
            one.sensitivity()
        print(hashlib.sha256(one.x.tobytes()).hexdigest())
"""


@pytest.mark.slow
def test_interpreted_kernels_under_sanitizers(tmp_path: Path) -> None:
    found = output(SANITIZED, tmp_path)
    assert len(found) == 8 and found[::2] == found[1::2]
