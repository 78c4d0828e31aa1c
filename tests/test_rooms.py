"""The house: imports of the package go down, and no files import each other in a circle."""

from __future__ import annotations

import ast
import os
import re
from collections.abc import Mapping
from functools import cache
from pathlib import Path

import phfmu
from tests.sources import nodes

ROOT = Path(phfmu.__file__).parent
TESTS = Path(__file__).parent

#: from the ground up; a room may import those before it
ROOMS = (
    "listed_names", "words", "files", "processors", "collector", "interrupt", "html", "pick", "matching", "declare", "terms",
    "gradients", "plan", "schemes", "schur",
    "outcome", "events", "discretise", "engine", "checks", "signals", "results", "importers", "audit", "fmu",
    "network", "network.scene",
    "network.members", "network.interface", "network.impulses", "network.couplings", "network.as_unit",
    "runs", "network.check_scene", "ssp", "references", "vet", "operating", "components", "arguments", "target", "report",
    "sweeps", "derivatives", "doors", "studies", "cli",
)  # fmt: skip


C_WORDS, C_COMMENT = re.compile(r"\b[A-Za-z_]\w*\b"), re.compile(r"/\*.*?\*/|//[^\n]*", re.DOTALL)
C_FUNCTION = re.compile(
    r"^(?!typedef|struct|enum|static const|#)\w[^;={]*?(\w+)\([^;{]*\) \{$(.*?)^\}$", re.MULTILINE | re.DOTALL
)


@cache
def imports() -> dict[str, set[str]]:
    """Module -> modules of the package it imports, also inside functions and for type checkers."""
    files = {module(p): p for p in walked()}
    return {name: {n for m in imported(p) if (n := known(m, files)) not in ("", name)} for name, p in files.items()}


def walked() -> list[Path]:
    """Files of the package; its components may be a link."""
    found = os.walk(ROOT, followlinks=True)
    return [Path(folder) / name for folder, _, names in found for name in names if name.endswith(".py")]


def module(path: Path) -> str:
    parts = path.relative_to(ROOT).with_suffix("").parts
    return ".".join(parts[:-1] if parts[-1] == "__init__" else parts)


def imported(path: Path) -> list[str]:
    """`module.name` of each name that a file imports from the package, and modules that it imports whole."""
    found: list[str] = []
    for node in nodes(path):
        if isinstance(node, ast.ImportFrom) and node.module != "phfmu":  # its public names come from their own modules
            found += [f"{source(path, node)}.{a.name}" for a in node.names]
        elif isinstance(node, ast.Import):
            found += [a.name for a in node.names]
    return [name.removeprefix("phfmu.") for name in found if name.startswith("phfmu.")]


def source(path: Path, node: ast.ImportFrom) -> str:
    """The module that names are imported from, relative ones by their whole name."""
    if not node.level:
        return node.module or ""
    parts = path.resolve().with_suffix("").parts
    package = parts[len(parts) - parts[::-1].index("phfmu") - 1 : -node.level]
    return ".".join([*package, *filter(None, [node.module])])


def known(name: str, files: dict[str, Path]) -> str:
    """The file of `module.name`, "" for what is none."""
    return name if name in files else name.rpartition(".")[0] if name.rpartition(".")[0] in files else ""


def room_of(name: str) -> str:
    """The room of a module, or the room within a room; "" for the package itself and folders that only hold rooms."""
    parts = name.split(".")
    return next((r for n in range(len(parts), 0, -1) if (r := ".".join(parts[:n])) in ROOMS), "")


def upward(graph: dict[str, set[str]]) -> set[tuple[str, str]]:
    level = {room: i for i, room in enumerate(ROOMS)}
    return {
        (name, other)
        for name, others in graph.items()
        for other in others
        if (room := room_of(name)) and level[room] < level[room_of(other)]
    }


def circles(graph: dict[str, set[str]]) -> set[frozenset[str]]:
    """Largest sets of files of which each reaches each other."""
    reach: dict[str, set[str]] = {}
    for name in graph:
        found, todo = set[str](), [name]
        while todo:
            new = graph.get(todo.pop(), set()) - found
            found |= new
            todo += new
        reach[name] = found
    return {frozenset(m for m in reach[name] if name in reach[m]) for name in graph if name in reach[name]}


def calls(texts: Mapping[str, str]) -> dict[str, set[str]]:
    """C file -> C files whose functions it names, from their texts; a function that two files define is nobody's."""
    codes = {name: C_COMMENT.sub("", text) for name, text in texts.items()}
    homes: dict[str, set[str]] = {}
    for name, code in codes.items():
        for m in C_FUNCTION.finditer(code):
            if not m[0].startswith("static"):
                homes.setdefault(m[1], set()).add(name)
    own = {word: next(iter(files)) for word, files in homes.items() if len(files) == 1}
    return {name: {own[w] for w in set(C_WORDS.findall(code)) & own.keys()} - {name} for name, code in codes.items()}


def test_every_room_is_in_the_order() -> None:
    folders = {room.rpartition(".")[0] for room in ROOMS} - set(ROOMS)
    assert {name for name in imports() if not room_of(name)} == folders | {"__main__"}
    assert {room_of(name) for name in imports()} - {""} == set(ROOMS)


def test_every_import_names_a_file() -> None:
    files = {module(p): p for p in walked()}
    assert [(str(p), m) for p in files.values() for m in imported(p) if not known(m, files)] == []


def bound(path: Path) -> set[str]:
    """Names that a file binds outside its functions and classes; those of a package's stub are loaded when they are used."""
    stub = path.with_suffix(".pyi")
    files = [path, stub] if stub.is_file() else [path]
    found, todo = set[str](), [n for f in files for n in ast.iter_child_nodes(nodes(f)[0])]
    while todo:
        node = todo.pop()
        if isinstance(node, ast.FunctionDef | ast.AsyncFunctionDef | ast.ClassDef):
            found.add(node.name)
            continue
        if isinstance(node, ast.alias):
            found.add((node.asname or node.name).partition(".")[0])
        elif isinstance(node, ast.Name) and isinstance(node.ctx, ast.Store):
            found.add(node.id)
        todo += ast.iter_child_nodes(node)
    return found


def test_every_name_imported_is_in_its_file() -> None:
    """Also inside functions, which no other import would notice."""
    files = {module(p): p for p in walked()}
    names = {name: bound(path) for name, path in files.items()}
    public = set(phfmu.__all__)
    wrong = [
        (str(p), m)
        for p in files.values()
        for m in imported(p)
        if m not in files and (m.rpartition(".")[2] not in names[known(m, files)] | (public if "." not in m else set()))
    ]
    assert wrong == []


def test_imports_go_down() -> None:
    assert upward(imports()) == set()


def test_no_files_import_each_other_in_a_circle() -> None:
    assert circles(imports()) == set()


def test_no_c_files_call_each_other_in_a_circle() -> None:
    texts = {p.relative_to(ROOT).as_posix(): p.read_text() for p in ROOT.rglob("*.c")}
    assert len(texts) > 40
    assert circles(calls(texts)) == set()


def test_a_circle_of_c_calls_is_seen() -> None:
    texts = {"a.c": "int one(void) {\n    return two();\n}\n", "b.c": "int two(void) {\n    return one();\n}\n"}
    assert circles(calls(texts)) == {frozenset({"a.c", "b.c"})}
    texts["b.c"] = "static int one(void) {\n    return 1;\n}\n/* one */ int two(void) {\n    return 1;\n}\n"
    assert circles(calls(texts)) == set()


def test_a_public_class_name_means_one_class() -> None:
    """A reader who looks for a class by its name finds one."""
    places: dict[str, list[str]] = {}
    for path in walked():
        for node in nodes(path):
            if isinstance(node, ast.ClassDef) and not node.name.startswith("_"):
                places.setdefault(node.name, []).append(module(path))
    assert {name: files for name, files in places.items() if len(files) > 1} == {}


def test_components_are_written_against_public_names() -> None:
    found = {other for name, others in imports().items() if name.startswith("components") for other in others}
    assert {n for n in found if n and not n.startswith("components")} <= {
        "listed_names",  # how a family lists its own
        "operating",
        "importers.grid",
        "importers.mechanism",
    }  # public names


def test_imports_of_every_form_are_seen(tmp_path: Path) -> None:
    path = tmp_path / "phfmu" / "plan" / "a.py"
    path.parent.mkdir(parents=True)
    path.write_text("import os, phfmu.words\nfrom .b import C\nfrom ..cli import d\nfrom phfmu.terms import e\n")
    assert sorted(imported(path)) == ["cli.d", "plan.b.C", "terms.e", "words"]


def test_an_import_upward_and_a_circle_are_seen() -> None:
    graph = {"plan.a": {"schemes.b"}, "schemes.b": {"plan.c"}, "plan.c": {"plan.a"}, "cli.d": {"plan.a"}}
    assert upward(graph) == {("plan.a", "schemes.b")}
    assert upward({"network.members.a": {"network.couplings.b"}}) == {("network.members.a", "network.couplings.b")}
    assert circles(graph) == {frozenset({"plan.a", "schemes.b", "plan.c"})}
