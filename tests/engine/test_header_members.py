"""Members of C structures as they are read from headers: all of them, in order, or an error that names one."""

from __future__ import annotations

import ctypes

import pytest

from phfmu.engine.build.tables import declared, for_ctypes
from phfmu.runs.march.native_march import HEADER as MARCH
from phfmu.sweeps.native_runs import HEADER as RUNS


def header(*members: str) -> str:
    return "typedef struct thing {\n" + "".join(f"    {m};\n" for m in members) + "} thing;\n"


def test_a_member_over_two_lines_is_read() -> None:
    text = header("int n", "const double\n        *weight /* n */", "int a,\n        b", "const int *\n        last")
    fields = declared(text, ("thing",))["thing"]
    assert [(f.name, f.ctype, f.pointer) for f in fields] == [
        ("n", "int", False), ("weight", "double", True), ("a", "int", False), ("b", "int", False), ("last", "int", True),
    ]  # fmt: skip
    assert ctypes.sizeof(for_ctypes({"thing": fields})["thing"]) == 32


@pytest.mark.parametrize("member", ["const double **weight", "double weight[3]", "void (*call)(int)", "int n, *weight"])
def test_a_member_of_another_kind_is_refused_by_name(member: str) -> None:
    with pytest.raises(ValueError, match="thing: the member '.*(weight|call)"):
        declared(header("int n", member, "int last"), ("thing",))


def test_all_headers_are_of_this_form() -> None:
    assert MARCH.fields["ph_march"]
    assert RUNS.fields["ph_runs"]
