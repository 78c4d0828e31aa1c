"""Pages for contributors name what the tree has: files, and the classes and functions in them."""

from __future__ import annotations

import re
from fnmatch import fnmatch
from functools import cache
from pathlib import Path

import pytest

ROOT = Path(__file__).parent.parent
#: but the house, whose table and lines a command makes of a tree
PAGES = [ROOT / "CONTRIBUTING.md", *sorted(p for p in (ROOT / "docs" / "internals").glob("*.md") if p.stem != "house")]
FENCE = re.compile(r"^```\w*\n.*?^```$", re.MULTILINE | re.DOTALL)
#: folders and files in backticks, and files anywhere, such as those of a tree of calls
FILE = re.compile(r"(?<![\w/.*-])((?:[\w.*-]+/)*[\w*-]+\.(?:pyi?|c|h|inc|toml|md))(?![\w/])")
FOLDER = re.compile(r"`(\w[\w.-]+/[\w./-]*)`")
#: a name with its file: in a tree of calls, and in a sentence
CALL = re.compile(r"^ {4,}((?:[\w.]+(?:, | = )?)+) +\(([\w/.]+\.(?:py|c|inc))\)", re.MULTILINE)
OWNED = re.compile(r"`([A-Za-z_][\w.]*)(?:\([^`]*\))?`\s+(?:\(|of |in )`([\w/.]+\.(?:pyi?|c|h|inc))`")
#: one name in backticks that cannot be a word or a symbol
NAME = re.compile(r"`((?:[A-Za-z_]\w*\.)*[A-Za-z_]\w{3,})(?:\([^`]*\))?`")
#: made by a build, or a link;  files that an example would add
BUILT = {"engine/build/shipped", "phfmu/components"}
ADDED = {"components/thermal/two_bodies.py"}


@cache
def tree() -> dict[str, str]:
    """Texts of the files by their paths."""
    found = [ROOT / name for name in ("README.md", "CHANGELOG.md", "CONTRIBUTING.md", "pyproject.toml", "setup.py")]
    for folder in ("phfmu", "components", "tests", "docs"):
        found += [
            p for p in (ROOT / folder).rglob("*") if p.suffix in (".py", ".pyi", ".c", ".h", ".inc", ".md", ".mjs")
        ]
    return {p.relative_to(ROOT).as_posix(): p.read_text(encoding="utf-8") for p in found}


@cache
def folders() -> set[str]:
    return {parent.as_posix() for path in tree() for parent in Path(path).parents}


@cache
def words() -> set[str]:
    """All names in the code."""
    code = [text for path, text in tree().items() if not path.endswith(".md") and path != "tests/test_docs_names.py"]
    return {word for text in code for word in re.findall(r"[A-Za-z_]\w*", text)} | {Path(path).stem for path in tree()}


@cache
def classes() -> set[str]:
    """Names that begin with a capital and are defined or imported, of classes and of types."""
    rule = re.compile(r"\b(?:class|import|as|def) ([A-Z]\w*)|^ *([A-Z]\w*) *[:=]", re.MULTILINE)
    code = [text for path, text in tree().items() if path.endswith((".py", ".pyi"))]
    return {name for text in code for pair in rule.findall(text) for name in pair}


def files(path: str) -> list[str]:
    """The files that a page may mean by a path, or by the end of one."""
    if "*" in path:
        return [known for known in tree() if fnmatch(f"/{known}", f"*/{path}")]
    return [known for known in tree() if f"/{known}".endswith(f"/{path}")]


def prose(page: Path) -> str:
    """The page without its blocks of code and the targets of its links, with whole paths for letters that stand for folders."""
    text = re.sub(r"\]\([^)\s]+\)", "]", FENCE.sub("", page.read_text(encoding="utf-8")))
    for letter, folder in re.findall(r"`([A-Z])/`(?: stands)? for `([\w/]+)`", text):
        text = re.sub(rf"(?<![\w/]){letter}/(?=\w)", f"{folder}/", text)
    return text


def examples(page: Path) -> str:
    return "\n".join(FENCE.findall(page.read_text(encoding="utf-8")))


def defined(name: str, path: str) -> bool:
    """Whether one of the files that the path may mean has the name: defines it, in Python."""
    last = re.escape(name.rpartition(".")[2])
    rule = rf"\b(?:def|class) {last}\b|^ *(?:self\.)?{last}\b.*(?:=|:)" if path.endswith("py") else rf"\b{last}\b"
    return any(re.search(rule, tree()[known], re.MULTILINE) for known in files(path))


def title(page: Path) -> str:
    return page.relative_to(ROOT).as_posix()


@pytest.mark.parametrize("page", PAGES, ids=title)
def test_files_exist(page: Path) -> None:
    text, own = prose(page), examples(page)
    wrong = [
        p for p in FILE.findall(text) if not files(p) and p not in ADDED and not re.search(rf"\b{re.escape(p)}\b", own)
    ]
    known = folders() | BUILT
    for folder in {p.rstrip("/") for p in FOLDER.findall(text)}:
        if "." not in folder and not any(f"/{k}".endswith(f"/{folder}") for k in known):
            wrong.append(folder)
    assert not wrong


@pytest.mark.parametrize("page", PAGES, ids=title)
def test_names_are_in_their_files(page: Path) -> None:
    text = prose(page)
    pairs = [(name, path) for names, path in CALL.findall(text) for name in names.rpartition(" = ")[2].split(", ")]
    pairs += OWNED.findall(text)
    assert [pair for pair in pairs if files(pair[1]) and not defined(*pair)] == []


@pytest.mark.parametrize("page", PAGES, ids=title)
def test_names_exist(page: Path) -> None:
    own = set(re.findall(r"\w+", examples(page)))
    parts = {part for name in NAME.findall(prose(page)) for part in name.split(".")}
    odd = {part for part in parts if "_" in part.strip("_") or re.search(r"[a-z][A-Z]|^[A-Z][a-z]{3}|^[A-Z]{4}", part)}
    assert odd - words() - own == set()
    assert {part for part in odd if re.search(r"^[A-Z]\w*[a-z]", part)} - classes() - own == set()
