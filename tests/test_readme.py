"""README and docs keep their word: their Python blocks and commands run, page by page, in order.

Rules:  ```python blocks of a page share one namespace; one that starts with `# name.py` is also saved so.
        ```console blocks hold lines `$ phfmu ...`; each must end with exit code 0.
        ```bash blocks are set-up commands that change the machine (`python3 -m venv ...`); they are not run.
"""

from __future__ import annotations

import re
import shlex
from pathlib import Path

import pytest

from phfmu.cli import main
from tests.wide import marked, wide

ROOT = Path(__file__).parent.parent
BLOCK = re.compile(r"^```(\w*)\n(.*?)^```$", re.MULTILINE | re.DOTALL)
PAGES = [ROOT / "README.md", *sorted((ROOT / "docs").rglob("*.md"))]


def blocks(page: Path) -> list[tuple[str, str]]:
    """(language, text) of the fenced blocks."""
    return BLOCK.findall(page.read_text(encoding="utf-8"))


RUN = [p for p in PAGES if p.stem != "gallery" and {"python", "console"} & {language for language, _ in blocks(p)}]


def name(page: Path) -> str:
    return str(page.relative_to(ROOT))


def commands(body: str) -> list[str]:
    """What stands behind the prompts."""
    return [line.removeprefix("$ ") for line in body.splitlines() if line.startswith("$ ")]


#: endings of pictures and what draws them
DRAWN = {".png": "matplotlib", ".html": "plotly"}


#: whose blocks run for more than a second; what they do has tests of its own
LONG = (
    "build-a-breaker-and-a-stop", "build-a-mechanism", "build-a-multibody-model", "choose-steps", "couple-members",
    "import-a-model", "look-at-a-run", "units-of-other-tools", "use-an-fmu", "use-ssp", "vet-a-unit",
)  # fmt: skip


#: runs every scene, as many other tests do
GALLERY = marked(ROOT / "docs" / "gallery.md", pytest.mark.long)


@pytest.mark.parametrize("page", [*wide(RUN, *(p for p in RUN if p.stem not in LONG)), GALLERY], ids=name)
def test_blocks_run(
    compiler: None, page: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.chdir(tmp_path)
    monkeypatch.syspath_prepend(str(tmp_path))  # as for a script beside the saved blocks
    namespace: dict[str, object] = {}
    for number, (language, body) in enumerate(blocks(page), 1):
        if language == "python":
            first = body.splitlines()[0]
            if re.fullmatch(r"# \w+\.py", first):
                Path(first.removeprefix("# ")).write_text(body, encoding="utf-8")
            try:
                exec(compile(body, f"{name(page)}, block {number}", "exec"), namespace)
            except ImportError as error:
                if "phfmu[" not in str(error):
                    raise
                pytest.skip(f"block {number}: {error}")  # an extra, with the command that brings it
        elif language == "console":
            for command in commands(body):
                program, *arguments = shlex.split(command)
                assert program == "phfmu", command
                assert main(arguments) == 0, f"{command}\n{capsys.readouterr().err}"
                assert "which the scene names for its picture" not in capsys.readouterr().out


@pytest.mark.parametrize("page", PAGES, ids=name)
def test_blocks_are_of_known_kinds(page: Path) -> None:
    for language, body in blocks(page):
        assert language in ("python", "console", "bash")
        assert language != "bash" or body.startswith("python3 -m venv ")
        assert language != "console" or commands(body)


def prose(page: Path) -> str:
    """The page without its fenced blocks."""
    return BLOCK.sub("", page.read_text(encoding="utf-8"))


def anchors(page: Path) -> set[str]:
    """Anchors of the headings, as GitHub makes them."""
    titles = re.findall(r"^#+ (.*)$", prose(page), re.MULTILINE)
    return {re.sub(r"[^\w\- ]", "", t.lower()).replace(" ", "-") for t in titles}


def links(page: Path) -> list[tuple[Path, str]]:
    """(file, anchor) of the links and pictures of a page that stay in the tree."""
    targets = [t.partition("#") for t in re.findall(r"\]\(([^)\s]+)\)", prose(page)) if "://" not in t]
    return [((page.parent / path).resolve() if path else page, anchor) for path, _, anchor in targets]


@pytest.mark.parametrize("page", PAGES, ids=name)
def test_links_lead_somewhere(page: Path) -> None:
    for found, anchor in links(page):
        assert found.exists(), f"{name(page)} links to {found}"
        assert not anchor or anchor in anchors(found), f"{name(page)} links to {found}#{anchor}"


def test_the_index_lists_every_page() -> None:
    index = ROOT / "docs" / "index.md"
    pages = [*PAGES, *(ROOT / "docs").rglob("*.ipynb")]
    assert {p.resolve() for p in pages if p != index} == {found for found, _ in links(index)}
    titles = re.findall(r"^## (\w+)$", prose(index), re.MULTILINE)
    assert {p.parent.name for p in pages if p.parent.parent == index.parent} == {t.lower() for t in titles}


#: coined words and their places in the glossary; pages that explain one themselves need no link
COINED = {
    r"bare nodes?": ("bare-node", "bare-nodes.md"),
    r"impulse pairs?": ("impulse-pair", "bare-nodes.md"),
    r"two-level (?:form|scheme|steps)": ("two-level", "constraints.md native-engine.md plan.md work-precision.md"),
    r"Schur stepper": ("schur-stepper", "native-engine.md stress.md"),
    r"step-conjugate": ("step-conjugate", "sign-convention-and-ports.md fmu.md"),
    r"interface Newton": ("interface-newton", "couplings.md plan.md"),
    r"strain form": ("strain-form", "schemes.md constraints.md"),
    r"closed-form pair": ("closed-form-pair", "schemes.md ledger.md plan.md"),
    r"hidden constraint": ("hidden-constraint", "plan.md ledger.md fmu.md"),
    r"restart steps": ("restart-steps", "steps.md"),
    r"\bguards?\b": ("guard-jump-landing", "events.md stress.md"),
    r"stepped last": ("stepped-last", "couplings.md stress.md"),
    r"held inputs?": ("held", "fmu.md plan.md"),
}


@pytest.mark.parametrize("page", [p for p in PAGES if p.name not in ("glossary.md", "index.md")], ids=name)
def test_coined_words_are_explained(page: Path) -> None:
    text = re.sub(r"^(?:#|    ).*$", "", prose(page), flags=re.MULTILINE)
    linked = {anchor for found, anchor in links(page) if found.name == "glossary.md"}
    for word, (anchor, pages) in COINED.items():
        if page.name not in pages and re.search(rf"(?<![\[/-]){word}", text):
            assert anchor in linked, f"{name(page)} uses '{word}' without a link to glossary.md#{anchor}"


@pytest.mark.parametrize("page", PAGES, ids=name)
def test_pages_name_files_that_exist(page: Path) -> None:
    example = "components/thermal/two_bodies.py"  # what a contributor would add
    for path in re.findall(r"`((?:phfmu|tests|components|docs)/[\w/.-]+\.\w+)`", prose(page)):
        assert path == example or (ROOT / path).exists(), f"{name(page)} names {path}"


def test_each_kind_of_part_has_an_example_that_runs() -> None:
    pages = [p.read_text(encoding="utf-8") for p in (ROOT / "docs" / "internals").glob("add-*.md")]
    sections = {s.partition("\n")[0]: s for text in pages for s in re.split(r"(?:^|\n)##? ", text)[1:]}
    for kind in ("domain", "component", "scheme", "coupling", "FMI version"):
        assert any(kind in title and "```python" in body for title, body in sections.items()), kind


def test_code_names_pages_that_exist() -> None:
    sources = [
        p for folder in ("phfmu", "components", "tests") for p in (ROOT / folder).rglob("*") if p.suffix != ".pyc"
    ]
    for source in (p for p in sources if p.is_file()):
        for page in re.findall(rb"\bdocs/[\w/-]+\.(?:md|py)\b", source.read_bytes()):
            assert (ROOT / page.decode()).exists(), f"{name(source)} names {page.decode()}"


@pytest.mark.parametrize("page", [p for p in PAGES if p.name != "gallery.md"], ids=name)
def test_pages_are_short(page: Path) -> None:
    """Tables and the gallery apart, which commands make."""
    lines = page.read_text(encoding="utf-8").splitlines()
    assert len([line for line in lines if not line.startswith("|")]) < 300
