"""docs/gallery.md: every scene of the library by its own words and the picture of its own choice of signals."""

from __future__ import annotations

import contextlib
import inspect
import io
import shlex
import tempfile
from collections.abc import Iterator, Sequence
from pathlib import Path

from pages import DOCS, PageBlock

from phfmu.cli import main
from phfmu.components import library

PAGE, IMAGES = DOCS / "gallery.md", DOCS / "img" / "gallery"
#: of a picture: lines and letters need no more, and the page loads quickly
COLOURS = 160
#: s, of scenes whose waves would be a band over the whole run
BRIEF = {"lossless": 0.1, "smib_exciter": 1.0, "wscc9_steady": 0.1}

HEAD = """# Gallery

Every scene of the library in one picture, with the command that draws it: of the signals that the scene names for its picture
(`Scene(shown=...)`); `--signals` draws others. This page and its pictures are made, in about a minute on a quiet machine, by

    python docs/tables gallery --write
    python docs/tables gallery --write --picture smib

which take the scenes, and the docstrings that say what they are, from the library, and draw all pictures or one. The sources are
in `components/scenes`, or beside their component; `phfmu report` makes a whole
[page of a run](use/look-at-a-run.md#the-page-of-a-run) of any of them.
"""


def gallery(scenes: Sequence[str] = ()) -> PageBlock:
    """docs/gallery.md with a picture of every scene of the library; pictures of these only where some are named."""
    unknown = set(scenes) - set(names())
    if unknown:
        raise ValueError(f"no scene {', '.join(sorted(unknown))}; there are: {', '.join(names())}")
    return PageBlock(draw=lambda: list(_written(scenes or names())))


def names() -> list[str]:
    """The scenes of the library in its order."""
    return [name for name, (kind, *_) in library.LIBRARY.items() if kind == "scene"]


def command(name: str) -> str:
    """The command of a scene's picture, after `phfmu`."""
    brief = f" --stop {BRIEF[name]:g}" if name in BRIEF else ""
    return f"run {name}{brief} --plot {name}.png"


def page() -> str:
    """The text of the page."""
    return "\n".join([HEAD, *map(_section, names())])


def _section(name: str) -> str:
    said = (inspect.getdoc(library.builder(name)) or "").split("\n\n")[0]
    return f"## {name}\n\n{said}\n\n```console\n$ phfmu {command(name)}\n```\n\n![{name}](img/gallery/{name}.png)\n"


def _written(scenes: Sequence[str]) -> Iterator[Path]:
    from PIL import Image

    PAGE.write_text(page(), encoding="utf-8")
    yield PAGE
    IMAGES.mkdir(exist_ok=True)
    for name in scenes:
        with tempfile.TemporaryDirectory() as folder, contextlib.chdir(folder):
            with contextlib.redirect_stdout(io.StringIO()):
                if main([*shlex.split(command(name)), "--audit", "none"]):
                    raise RuntimeError(f"phfmu {command(name)} did not end well")
            with Image.open(f"{name}.png") as drawn:
                small = drawn.convert("RGB").quantize(COLOURS, Image.Quantize.FASTOCTREE, dither=Image.Dither.NONE)
                small.save(IMAGES / f"{name}.png", optimize=True)
        yield IMAGES / f"{name}.png"
