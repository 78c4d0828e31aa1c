"""The libraries that many threads share have no data that is written: no section for it, their own or of a thread."""

from __future__ import annotations

from pathlib import Path
from struct import unpack_from

import pytest

from phfmu import build_model
from phfmu.components.library import build
from phfmu.engine.build.compile import compile, host_flags, host_target
from phfmu.engine.build.runtime_sources import library_sources
from phfmu.engine.native.native_model import native_model

WRITTEN = {".data", ".bss", ".tdata", ".tbss"}
COUNT = '#include "phfmu.h"\nPH_API long count(void);\nstatic long n;\nlong count(void) { return n++; }\n'

pytest.importorskip("ziglang", reason="other compilers add data of their own")
needs = pytest.mark.skipif("linux" not in host_target(), reason="reads ELF files")


def written(path: str | Path) -> dict[str, int]:
    """Sections of an ELF library of 64 bits that hold data which is written -> bytes."""
    data = Path(path).read_bytes()
    assert data[:6] == b"\x7fELF\x02\x01", "not an ELF file of 64 bits, low bytes first"
    (start,) = unpack_from("<Q", data, 40)
    size, count, names = unpack_from("<HHH", data, 58)
    heads = [unpack_from("<IIQQQQ", data, start + i * size) for i in range(count)]
    text = data[heads[names][4] :]
    found = {text[h[0] : text.index(b"\0", h[0])].decode(): h[5] for h in heads}
    assert ".text" in found
    return {name: n for name, n in found.items() if name in WRITTEN and n}


@needs
def test_libraries_have_no_data_that_is_written() -> None:
    """The runtime, and the code of a model."""
    made = native_model(build_model(build("four_particle")), "compiled")
    assert made.code.build is not None
    for path in (made.lib._name, made.code.build.path):
        assert written(path) == {}, path


@needs
@pytest.mark.slow
def test_a_count_is_found() -> None:
    """One that all instances would share."""
    headers = {p.name: p for p in library_sources().values() if p.suffix == ".h"}
    found = written(compile({**headers, "count.c": COUNT}, flags=host_flags()).path)
    assert sum(found.values()) == 8
