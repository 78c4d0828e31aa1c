"""The public names: one list, loaded when used, known to type checkers."""

from __future__ import annotations

import ast
import inspect
import subprocess
import sys
import tomllib
from importlib import import_module
from importlib.machinery import PathFinder
from importlib.resources import files
from pathlib import Path
from typing import Any

import pytest

import phfmu

STUB = (files("phfmu") / "__init__.pyi").read_text(encoding="utf-8")


def child(code: str) -> str:
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, timeout=60)
    assert done.returncode == 0, done.stderr
    return done.stdout


def test_the_stub_is_the_list() -> None:
    imports = [n for n in ast.parse(STUB).body if isinstance(n, ast.ImportFrom)]
    assert all(len(n.names) == 1 and n.names[0].asname == n.names[0].name for n in imports)  # re-exported, one a line
    listed = {n.names[0].name: n.module for n in imports}
    assert sorted(listed) == phfmu.__all__ and len(imports) == len(listed)
    for name, module in listed.items():
        assert getattr(phfmu, name) is getattr(import_module(str(module)), name)


def test_the_package_lists_no_name_itself() -> None:
    nodes = list(ast.walk(ast.parse((files("phfmu") / "__init__.py").read_text(encoding="utf-8"))))
    words = {n.value for n in nodes if isinstance(n, ast.Constant)} | {
        a.name for n in nodes for a in getattr(n, "names", ())
    }
    assert not words & set(phfmu.__all__)


def test_a_star_gives_every_name() -> None:
    space: dict[str, Any] = {}
    exec("from phfmu import *", space)
    assert set(phfmu.__all__) <= set(space) and set(phfmu.__all__) <= set(dir(phfmu))


def test_importing_the_package_loads_nothing_heavy() -> None:
    heavy = child("import sys, phfmu; print([m for m in ('numpy', 'casadi', 'scipy', 'pyarrow') if m in sys.modules])")
    assert heavy.strip() == "[]"


def test_type_checkers_are_told_that_the_package_is_typed() -> None:
    assert (files("phfmu") / "py.typed").is_file()


def test_the_package_runs_as_a_module() -> None:
    done = subprocess.run([sys.executable, "-m", "phfmu", "list"], capture_output=True, text=True, timeout=60)
    assert done.returncode == 0 and "dc_motor" in done.stdout


def test_a_plain_path_to_the_checkout_finds_the_components() -> None:
    """What editors and type checkers do with an editable install: they follow paths, not import hooks."""
    root = Path(__file__).parent.parent
    if not (root / "phfmu" / "components").is_dir():
        pytest.skip("a checkout without links")
    spec = PathFinder.find_spec("phfmu.components", [str(root / "phfmu")])
    assert spec is not None and Path(str(spec.origin)).resolve() == root / "components" / "__init__.py"


def test_every_package_is_listed_for_the_wheel() -> None:
    root = Path(__file__).parent.parent
    listed = tomllib.loads((root / "pyproject.toml").read_text(encoding="utf-8"))["tool"]["setuptools"]["packages"]
    own = {".".join(p.parent.relative_to(root).parts) for p in (root / "phfmu").rglob("__init__.py")}
    library = {
        ".".join(("phfmu", *p.parent.relative_to(root).parts)) for p in (root / "components").rglob("__init__.py")
    }
    assert set(listed) == own | library and len(listed) == len(set(listed))


def test_both_engines_take_the_same() -> None:
    """PythonInstance has the methods of NativeInstance; names and types of arguments agree."""
    for name, method in inspect.getmembers(phfmu.NativeInstance, callable):
        if not name.startswith("_") and name != "set_state":  # a saved state is opaque
            other = getattr(phfmu.PythonInstance, name, None)
            assert other is not None, name
            own, theirs = ([str(p) for p in inspect.signature(m).parameters.values()] for m in (method, other))
            theirs = [p.replace("PythonInstance", "NativeInstance") for p in theirs]
            assert own == theirs, name


def test_a_family_of_components_gives_the_functions_that_the_library_lists() -> None:
    """`from phfmu.components.control import relay` is the function, as for every other name of the list."""
    from phfmu.components.library import LIBRARY, builder

    for name, (_, module, _) in LIBRARY.items():
        family = import_module(module.rpartition(".")[0])
        assert getattr(family, name) is builder(name), name
        assert name in family.__all__
        assert family.__all__ == sorted(family.__all__)


def test_every_file_of_c_is_in_the_package() -> None:
    """Files of the runtime are compiled where they are installed: package-data names the folders that hold them."""
    root = Path(__file__).parent.parent
    data = tomllib.loads((root / "pyproject.toml").read_text(encoding="utf-8"))["tool"]["setuptools"]["package-data"]
    listed = {f for name, patterns in data.items() for p in patterns for f in (root / name.replace(".", "/")).glob(p)}
    sources = {f for end in ("c", "h", "inc") for f in (root / "phfmu").rglob(f"*.{end}")}
    assert sources and sources <= listed
