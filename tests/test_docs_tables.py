"""The commands behind the tables of the documentation: every command of a page exists, and prints what the page holds."""

from __future__ import annotations

import importlib
import re
import subprocess
import sys
from pathlib import Path

import pytest

from phfmu.components.library import LIBRARY, build
from tests.wide import slow

ROOT = Path(__file__).parent.parent
PAGES = [ROOT / "README.md", *sorted((ROOT / "docs").rglob("*.md"))]
COMMAND = re.compile(r"python docs/tables (?:--write )?(\w+)")


def tables(*arguments: str) -> subprocess.CompletedProcess[str]:
    command = [sys.executable, str(ROOT / "docs" / "tables"), *arguments]
    return subprocess.run(command, capture_output=True, text=True, timeout=300, encoding="utf-8")


def rows(text: str) -> list[list[str]]:
    """Cells of the rows of Markdown tables."""
    return [[c.strip() for c in line.strip("|").split("|")] for line in text.splitlines() if line.startswith("|")]


def below(name: str) -> list[list[str]]:
    """The table below the line with the command of `name`."""
    found = [
        m[1]
        for page in PAGES
        if (m := re.search(rf"^    python docs/tables {name}\n\n((?:\|.*\n)+)", page.read_text("utf-8"), re.MULTILINE))
    ]
    assert len(found) == 1, name
    return rows(found[0])


def test_every_command_of_a_page_exists_and_every_table_is_on_a_page() -> None:
    listed = {line.split()[0] for line in tables().stdout.splitlines()}
    named = {name for page in PAGES for name in COMMAND.findall(page.read_text("utf-8"))}
    assert named == listed


def test_every_scene_has_its_picture_in_the_gallery(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.syspath_prepend(ROOT / "docs" / "tables")
    gallery = importlib.import_module("gallery")
    scenes = {name for name, (kind, *_) in LIBRARY.items() if kind == "scene"}
    assert gallery.PAGE.read_text("utf-8") == gallery.page(), "python docs/tables gallery --write --picture NAME"
    assert set(re.findall(r"\(img/gallery/(\w+)\.png\)", gallery.page())) == scenes
    images = {path.stem: path.stat().st_size for path in gallery.IMAGES.iterdir()}
    assert set(images) == scenes
    assert sum(images.values()) < 1_500_000
    assert all(build(name).shown for name in scenes)


def test_a_name_that_is_none_is_refused_with_the_names() -> None:
    refused = tables("nothing")
    assert refused.returncode == 2
    assert "no 'nothing'" in refused.stderr and "scaling_net" in refused.stderr


@pytest.mark.parametrize("name", ["one_step", slow("couplings"), slow("mass_spring_orders"), slow("event_losses")])
def test_a_command_prints_what_the_page_holds(name: str) -> None:
    printed, page = rows(tables(name).stdout), below(name)
    assert [len(r) for r in printed] == [len(r) for r in page] and printed[:2] == page[:2]
    for new, old in zip(printed[2:], page[2:], strict=True):
        for a, b in zip(new, old, strict=True):
            if re.fullmatch(r"\d\.\d\de[+-]\d\d", b) and float(b) > 1e-12:  # below: rounding, another on each machine
                assert float(a) == pytest.approx(float(b), rel=0.02)
            elif not re.fullmatch(r"\d\.\d\de[+-]\d\d", b):
                assert a == b or abs(float(a) - float(b)) <= 0.01  # slopes


@pytest.mark.slow
def test_others_find_the_same_events_and_do_not_close_the_energy() -> None:
    """All of them within the level; ours to rounding at every one."""
    printed = rows(tables("event_peers_equal").stdout)
    assert len(printed) == 2 + 6 and [r[1] for r in printed[2:]] == ["1e-06", "1e-09", "1e-12"] * 2
    for scene, level, own, *others in printed[2:]:
        assert re.fullmatch(r"[\d.]+ \(\de-1[4-9]\)", own) or own.endswith("(0e+00)"), own
        reached = [float(c.split("(")[1].rstrip(")")) for c in others if "(" in c]
        assert reached, (scene, level)
        assert scene != "rectifier" or min(reached) > 1e-12, (level, others)


LONG = "def long():\n" + "".join(f"    x{i} = {i}\n" for i in range(60)) + "\n"
AGAIN = "".join(f"    again{i}()\n" for i in range(9))


def test_the_house_is_measured_on_any_tree(tmp_path: Path) -> None:
    """A tree with one of each: its numbers are known, its rows are those of the page."""
    files = {
        "phfmu/plan/a.py": "from phfmu.schemes.b import B\n" + LONG,
        "phfmu/schemes/b.py": "from phfmu.plan.a import long\n\n\nclass GradientPair:\n    pass\n\n\ndef f():\n"
        + AGAIN,
        "phfmu/schemes/c.py": "name = 'gradient-pair'\n\n\ndef g():\n" + AGAIN.replace("again3", "other"),
        "phfmu/engine/d.py": "import casadi\n\n\ndef h():\n    # a comment\n" + AGAIN + "\n# lines\n" * 440,
        "phfmu/engine/e.c": "int f(int a) {\n" + "    a++;\n" * 60 + "}\n\nstatic int g(void) {\n    return 1;\n}\n",
        "phfmu/engine/runtime/k.c": "int k(int a) {\n    return l(a);\n}\n",
        "phfmu/engine/runtime/l.c": "/* f is named here only */\nint l(int a) {\n    return k(a);\n}\n",
        "phfmu/engine/f.py": "class Twin:\n    '''What it is.'''\n\n\nx = 'a scheme is called gradient-pair'\n",
        "phfmu/engine/g.py": "class Twin:\n    '''Something else.'''\n\n\nclass _Single:\n    pass\n",
        "tests/test_a.py": "x = 1\n" * 451,
    }
    for name, content in files.items():
        (tmp_path / name).parent.mkdir(parents=True, exist_ok=True)
        (tmp_path / name).write_text(content, encoding="utf-8")
    made = tables("house", "--tree", str(tmp_path))
    assert made.returncode == 0, made.stderr
    found = {row[0]: row[1] for row in rows(made.stdout)[2:]}
    assert list(found) == [row[0] for row in below("house")[2:]]
    expected = {
        "files of the package": 9,
        "files over 450 lines, package": 1,
        "files over 450 lines, tests": 1,
        "functions over 60 lines, Python": 1,
        "functions over 60 lines, C": 1,
        "files below 60 lines, Python": 4,
        "of these with one importer": 1,  # schemes/b.py; a.py is too long
        "folders of more than 15 files, Python": 0,
        "class names that stand for several classes": 1,
        "docstrings that begin with a relative clause": 1,
        "circles of C calls": 1,
        "C files in a circle": 2,
        "circles of imports": 1,
        "files in a circle": 2,
        "imports upward": 1,
        "runs of 8 or more lines that stand elsewhere too, package": 2,  # the body in d.py, and a++ in its own
        "files that name GradientPair (scheme)": 2,
    }
    assert {name: int(found[name]) for name in expected} == expected
    assert (
        "plan.a -> schemes.b" in made.stdout
        and "plan.a - schemes.b" in made.stdout
        and "phfmu/plan/a.py:long (61)" in made.stdout
    )


def test_trees_are_for_the_house_only() -> None:
    refused = tables("one_step", "--tree", ".")
    assert refused.returncode == 2 and "--tree is of house" in refused.stderr
