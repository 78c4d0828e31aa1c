"""The tree in numbers: what the rules of the house ask for, measured on its text alone."""

from __future__ import annotations

import ast
import io
import subprocess
import sys
import tarfile
import tempfile
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from functools import cached_property
from importlib import import_module
from pathlib import Path
from types import ModuleType

from pages import ROOT, PageBlock, table

#: the tree that the page compares with: engine, couplings and units in three flat folders
BEFORE = "1f76368"
SHORT_FILE, LONG_FILE, LONG_FUNCTION, WINDOW, FULL = 60, 450, 60, 8, 15
#: first words of docstrings that do not say what they are about
HEADLESS = {"What", "Of", "How", "Where", "Which", "Who", "Whose", "As"}
#: kind of part -> words of one there is and the folders a new one could touch; files with such a word are what is touched
KINDS = {
    "component": (("heavy_top",), ("phfmu", "components")),
    "domain": (("HYDRAULIC",), ("phfmu", "components")),
    "scheme": (("GradientPair", "gradient-pair", "gradient_pair"), ("phfmu",)),
    "coupling": (
        ("Newton", "newton", "Coupled"),
        ("phfmu/__init__.py", "phfmu/__init__.pyi", "phfmu/network", "phfmu/cli"),
    ),
    "coupling that takes steps once": (
        ("Jacobi", "jacobi"),
        ("phfmu/__init__.py", "phfmu/__init__.pyi", "phfmu/network", "phfmu/cli"),
    ),
    "FMI version": (("fmi3", "3.0", "fmi2", "2.0"), ("phfmu/fmu", "phfmu/cli")),
}


def house(trees: Sequence[Path] = ()) -> PageBlock:
    """Length of files and functions, circles, imports upward, repeated lines, and files to touch for a new part."""
    if trees:
        return compared({str(t): Tree(t) for t in trees})
    with tempfile.TemporaryDirectory() as folder:
        return compared({BEFORE: Tree(of_commit(BEFORE, Path(folder))), "now": Tree(ROOT)})


def compared(trees: dict[str, Tree]) -> PageBlock:
    """One column a tree; the notes are about the last."""
    columns = [t.numbers() for t in trees.values()]
    rows = [[name, *(c[name] for c in columns)] for name in columns[0]]
    return table(["", *trees], rows, notes=tuple([*trees.values()][-1].notes()))


def of_commit(commit: str, folder: Path) -> Path:
    """The files of a commit of this repository."""
    done = subprocess.run(["git", "-C", str(ROOT), "archive", commit], capture_output=True)
    if done.returncode:
        words = done.stderr.decode().strip()
        raise SystemExit(f"{words}\nno commit {commit} here: fetch the whole history, or give trees with --tree PATH")
    with tarfile.open(fileobj=io.BytesIO(done.stdout)) as archive:
        archive.extractall(folder, filter="data")
    return folder


def rooms() -> ModuleType:
    """tests/test_rooms.py of this tree, which knows the order of rooms and what a circle is."""
    if str(ROOT) not in sys.path:
        sys.path.append(str(ROOT))
    return import_module("tests.test_rooms")


@dataclass(frozen=True)
class Span:
    """A function or a file: what it is called and how many lines it has."""

    name: str
    lines: int


@dataclass(frozen=True)
class Tree:
    """A tree of the repository by its path."""

    path: Path

    def files(self, *folders: str) -> list[Path]:
        """Sources below folders, or files themselves; links are passed by, so that nothing counts twice."""
        found = [
            p for f in folders for p in ([self.path / f] if (self.path / f).is_file() else (self.path / f).rglob("*"))
        ]
        kept = [p for p in found if p.suffix in (".py", ".pyi", ".c", ".h", ".inc") and p.is_file()]
        return sorted(p for p in kept if not any(q.is_symlink() for q in p.parents))

    @cached_property
    def sources(self) -> list[Path]:
        return self.files("phfmu", "components")

    def name(self, path: Path) -> str:
        return path.relative_to(self.path).as_posix()

    def long_files(self, files: Sequence[Path]) -> list[Span]:
        spans = [Span(self.name(p), len(text(p).splitlines())) for p in files]
        return longest([s for s in spans if s.lines > LONG_FILE])

    def long_functions(self, suffixes: Sequence[str]) -> list[Span]:
        spans = [s for p in self.sources if p.suffix in suffixes for s in functions(p, self.name(p))]
        return longest([s for s in spans if s.lines > LONG_FUNCTION])

    @cached_property
    def graph(self) -> dict[str, set[str]]:
        """Module -> modules of the package it imports."""
        known, imported = rooms().known, rooms().imported
        files = {module(self.name(p)): p for p in self.sources if p.suffix == ".py"}
        return {name: {n for m in imported(p) if (n := known(m, files)) not in ("", name)} for name, p in files.items()}

    def circles(self) -> list[list[str]]:
        return sorted(sorted(c) for c in rooms().circles(self.graph))

    @cached_property
    def calls(self) -> dict[str, set[str]]:
        """C file -> C files whose functions it names; a function that two files define is nobody's."""
        return rooms().calls({self.name(p): text(p) for p in self.sources if p.suffix == ".c"})

    def circles_of_calls(self) -> list[list[str]]:
        return sorted(sorted(c) for c in rooms().circles(self.calls))

    def splinters(self) -> list[Span]:
        """Modules below the length of a concept; those that only mark a folder do not count."""
        spans = [Span(self.name(p), len(text(p).splitlines())) for p in self.sources if p.suffix == ".py"]
        return longest([s for s in spans if s.lines < SHORT_FILE and not s.name.endswith("__.py")])

    def lonely(self) -> list[str]:
        """Splinters that one module alone imports: each is a part of that one, unless a reader looks for it by name."""
        importers: dict[str, list[str]] = {}
        for name, others in self.graph.items():
            for other in others:
                importers.setdefault(other, []).append(name)
        return [s.name for s in self.splinters() if len(importers.get(module(s.name), ())) == 1]

    @cached_property
    def trees(self) -> dict[str, ast.Module]:
        """Name of each module -> its syntax."""
        return {self.name(p): ast.parse(text(p)) for p in self.sources if p.suffix == ".py"}

    def homonyms(self) -> list[str]:
        """Names of public classes that are declared in several files."""
        places: dict[str, set[str]] = {}
        for name, tree in self.trees.items():
            for node in ast.walk(tree):
                if isinstance(node, ast.ClassDef) and not node.name.startswith("_"):
                    places.setdefault(node.name, set()).add(name)
        return sorted(name for name, files in places.items() if len(files) > 1)

    def headless(self) -> list[str]:
        """Docstrings that begin with a relative clause, so that a reader has to guess what they are about."""
        found = []
        for name, tree in self.trees.items():
            for node in ast.walk(tree):
                if isinstance(node, ast.Module | ast.ClassDef | ast.FunctionDef | ast.AsyncFunctionDef):
                    words = (ast.get_docstring(node) or "").split(maxsplit=1)
                    if words and words[0].rstrip(",.:;") in HEADLESS:
                        found.append(f"{name}:{getattr(node, 'lineno', 1)}")
        return found

    def full_folders(self) -> list[str]:
        """Folders with more modules than a reader takes in at once."""
        count: dict[str, int] = {}
        for p in self.sources:
            if p.suffix == ".py" and p.name != "__init__.py":
                count[self.name(p.parent)] = count.get(self.name(p.parent), 0) + 1
        return sorted(f"{folder} ({n})" for folder, n in count.items() if n > FULL)

    def upward(self) -> list[str]:
        """Imports of a room that stands above, in today's order of rooms."""
        order = list(dict.fromkeys(r.partition(".")[0] for r in rooms().ROOMS))
        level = {room: i for i, room in enumerate(order)}
        pairs = [(a, b) for a, others in self.graph.items() for b in others]
        above = [(a, b) for a, b in pairs if level.get(room(a), len(order)) < level.get(room(b), -1)]
        return sorted(f"{a} -> {b}" for a, b in above)

    def naming(self, kind: str) -> list[str]:
        """Files that name the example of a kind: as an identifier, a file of that name, or a string that is it."""
        words, folders = KINDS[kind]
        named = [p for p in self.files(*folders) if p.suffix in (".py", ".pyi")]
        return [self.name(p) for p in named if p.stem in words or words_of(p) & set(words)]

    def numbers(self) -> dict[str, int]:
        tests = self.files("tests")
        circles = self.circles()
        return {
            "files of the package": len(self.sources),
            "lines of the package": sum(len(text(p).splitlines()) for p in self.sources),
            f"files over {LONG_FILE} lines, package": len(self.long_files(self.sources)),
            f"files over {LONG_FILE} lines, tests": len(self.long_files(tests)),
            f"functions over {LONG_FUNCTION} lines, Python": len(self.long_functions((".py",))),
            f"functions over {LONG_FUNCTION} lines, C": len(self.long_functions((".c", ".h", ".inc"))),
            f"files below {SHORT_FILE} lines, Python": len(self.splinters()),
            "of these with one importer": len(self.lonely()),
            f"folders of more than {FULL} files, Python": len(self.full_folders()),
            "class names that stand for several classes": len(self.homonyms()),
            "docstrings that begin with a relative clause": len(self.headless()),
            "circles of imports": len(circles),
            "files in a circle": sum(map(len, circles)),
            "imports upward": len(self.upward()),
            "circles of C calls": len(self.circles_of_calls()),
            "C files in a circle": sum(map(len, self.circles_of_calls())),
            f"runs of {WINDOW} or more lines that stand elsewhere too, package": len(repeated(self.sources)),
            f"runs of {WINDOW} or more lines that stand elsewhere too, tests": len(repeated(tests)),
            **{f"files that name {KINDS[kind][0][0]} ({kind})": len(self.naming(kind)) for kind in KINDS},
        }

    def notes(self) -> Iterator[str]:
        """Which they are, in a line each."""
        yield said("files over the limit", [f"{s.name} ({s.lines})" for s in self.long_files(self.sources)])
        functions = self.long_functions((".py", ".c", ".h", ".inc"))
        yield said("functions over the limit", [f"{s.name} ({s.lines})" for s in functions])
        yield said("classes of one name", self.homonyms())
        yield said("circles", [" - ".join(c) for c in self.circles()])
        yield said("imports upward", self.upward())
        yield said("circles of C calls", [" - ".join(Path(f).name for f in c) for c in self.circles_of_calls()])
        yield said("full folders", self.full_folders())
        yield said("repeated lines", [f"{self.name(p)}:{line}" for p, line in repeated(self.sources)])


def said(what: str, names: Sequence[str]) -> str:
    return f"{what}: {', '.join(names) or 'none'}"


def longest(spans: list[Span]) -> list[Span]:
    return sorted(spans, key=lambda s: (-s.lines, s.name))


def text(path: Path) -> str:
    return path.read_text(encoding="utf-8")


def module(name: str) -> str:
    """phfmu/fmu/importer/reader.py -> fmu.reader."""
    parts = name.removeprefix("phfmu/").removesuffix(".py").split("/")
    return ".".join(parts[:-1] if parts[-1] == "__init__" else parts)


def room(name: str) -> str:
    return name.partition(".")[0]


def functions(path: Path, name: str) -> list[Span]:
    """Functions of a file with their lines, docstrings too."""
    if path.suffix != ".py":
        return [Span(f"{name}:{m[1]}", m[0].count("\n") + 1) for m in rooms().C_FUNCTION.finditer(text(path))]
    nodes = [n for n in ast.walk(ast.parse(text(path))) if isinstance(n, ast.FunctionDef | ast.AsyncFunctionDef)]
    return [Span(f"{name}:{n.name}", (n.end_lineno or n.lineno) - n.lineno + 1) for n in nodes]


def words_of(path: Path) -> set[str]:
    """Identifiers, last parts of imported modules, and whole strings of a Python file."""
    found: set[str] = set()
    for node in ast.walk(ast.parse(text(path))):
        if isinstance(node, ast.Name):
            found.add(node.id)
        elif isinstance(node, ast.ClassDef | ast.FunctionDef):
            found.add(node.name)
        elif isinstance(node, ast.alias):
            found.add(node.name.rpartition(".")[2])
        elif isinstance(node, ast.Constant) and isinstance(node.value, str):
            found.add(node.value)
    return found


def repeated(files: Sequence[Path]) -> list[tuple[Path, int]]:
    """(file, line) where lines begin that stand elsewhere before; blank lines, comments, imports and brackets do not count."""
    lines = {
        p: [(i, s) for i, line in enumerate(text(p).splitlines(), 1) if i not in imports and counts(s := line.strip())]
        for p, imports in ((p, import_lines(p)) for p in files)
    }
    first: dict[tuple[str, ...], tuple[Path, int]] = {}
    runs: list[tuple[Path, int]] = []
    for path, kept in lines.items():
        inside = False
        for k in range(len(kept) - WINDOW + 1):
            here = (path, kept[k][0])
            again = first.setdefault(tuple(s for _, s in kept[k : k + WINDOW]), here) != here
            if again and not inside:
                runs.append(here)
            inside = again
    return runs


def import_lines(path: Path) -> set[int]:
    """Numbers of the lines that import something, also in lists of names."""
    nodes = ast.walk(ast.parse(text(path))) if path.suffix in (".py", ".pyi") else ()
    imports = [n for n in nodes if isinstance(n, ast.Import | ast.ImportFrom)]
    return {i for n in imports for i in range(n.lineno, (n.end_lineno or n.lineno) + 1)}


def counts(line: str) -> bool:
    return len(line) > 2 and not line.startswith(("#", "//", "/*", "*"))
