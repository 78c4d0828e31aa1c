"""The compiled library of a model: shared by its instances, read from its header, and what a compiler is needed for."""

from __future__ import annotations

import ctypes
import importlib.util
import shutil
from itertools import product
from typing import Any

import numpy as np
import pytest

from phfmu.engine.build.codegen import kernel_table
from phfmu.engine.build.compile import CompileError, CompilerMissing, compile, host_flags
from phfmu.engine.build.kernels import Kernels
from phfmu.engine.build.runtime_sources import runtime_sources
from phfmu.engine.build.tables import CTables, c_text, ctypes_structures, stamp
from phfmu.engine.model import kernels
from phfmu.engine.native.code import code_of
from phfmu.engine.native.library import load, runtime
from phfmu.engine.native.native import NativeInstance
from phfmu.outcome.status import Status
from tests.engine.hand_made import (
    bar,
    oscillator,
)
from tests.wide import wide


def test_instances_of_a_model_share_its_library_and_tables_and_nothing_else(monkeypatch: pytest.MonkeyPatch) -> None:
    model = oscillator()
    first = NativeInstance(model)
    monkeypatch.setattr("phfmu.engine.native.native_model.code_of", None)  # is not made again
    second = NativeInstance(model)
    state = second.get_state()
    first.do_step(0.0, 0.1)
    assert second.get_state() == state != first.get_state()
    second.do_step(0.0, 0.1)
    assert second.get_state() == first.get_state()


def test_messages_and_layouts_agree_with_the_header() -> None:
    inst = NativeInstance(oscillator())
    _, lib = runtime()
    own = [s for s in Status if s not in (Status.GROWTH,)]
    assert [lib.ph_status_text(i).decode() for i in range(len(own))] == [s.value for s in own]
    assert lib.ph_status_text(len(own)) == b"unknown status"
    code = code_of(Kernels(kernels(inst.model)), None, "compiled")
    tables = CTables(inst.model, code.index, code.address)  # its own: instances share theirs
    given = ctypes_structures()["ph_model"].from_address(tables.pointer)
    assert given.stamp == stamp()
    given.stamp += 1
    assert lib.ph_size(tables.pointer) == 0


@pytest.mark.parametrize(
    ("compiler", "strict"), wide([("zig", ()), *product(["zig", "cc"], [("-Wall", "-Wextra", "-Werror")])], ("zig", ()))
)
def test_tables_as_text_give_the_same_bits(compiler: str, strict: tuple[str, ...], tmp_path: Any) -> None:
    """The same model as C source, with `strict` compiled without a warning, steps bit for bit like the ctypes tables."""
    if compiler == "cc" and shutil.which("cc") is None:
        pytest.skip("no system compiler")
    model, twin = bar(2), bar(2)
    table, same = kernel_table(kernels(model)), kernel_table(kernels(twin))
    text = c_text(model, table.index, "the_model")
    assert table.text == same.text and text == c_text(twin, same.index, "the_model")
    getter = '#include "phfmu.h"\nextern const ph_model the_model;\nPH_API const ph_model *get(void);\n'
    getter += "const ph_model *get(void) {\n    return &the_model;\n}\n"
    sources = {**runtime_sources(), "kernels.c": table.text, "model.c": text, "get.c": getter}
    flags = (*host_flags(compiler), *strict)
    library = compile(sources, out=tmp_path / "model.so", flags=flags, compiler=compiler)
    assert compile(sources, flags=flags, compiler=compiler).reused
    lib = load(library.path)
    lib.get.restype = ctypes.c_void_p
    pointer = lib.get()
    memory = np.zeros(lib.ph_size(pointer) // 8 + 1)
    address = memory.ctypes.data
    assert lib.ph_init(address, pointer) == 0 and lib.ph_initialise(address) == 0
    inst = NativeInstance(model)
    for i in range(5):
        assert lib.ph_step(address, i * 0.01, 0.01) == 0
        inst.do_step(i * 0.01, 0.01)
    saved = ctypes.create_string_buffer(lib.ph_state_size(address))
    lib.ph_save(address, saved)
    assert saved.raw == inst.get_state()


def test_missing_compiler_names_the_remedy(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(importlib.util, "find_spec", lambda name: None)
    with pytest.raises(CompilerMissing, match=r'aarch64-none.*pip install "phfmu\[native\]"'):
        compile({"a.c": "int a;"}, target="aarch64-none")


def test_compile_error_shows_the_compiler() -> None:
    with pytest.raises(CompileError, match="a.c"):
        compile({"a.c": "int a = ;"})
