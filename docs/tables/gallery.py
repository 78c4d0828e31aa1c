"""The pictures of docs/gallery.md: its commands, run as they stand there."""

from __future__ import annotations

import contextlib
import io
import re
import shlex
import tempfile
from collections.abc import Collection, Sequence
from pathlib import Path

from pages import DOCS, Made

from phfmu.cli import main

PAGE, IMAGES = DOCS / "gallery.md", DOCS / "img" / "gallery"
COMMAND = re.compile(r"^\$ phfmu (run .* --plot (\w+\.png))$", re.MULTILINE)
#: of a picture: lines and letters need no more, and the page loads quickly
COLOURS = 160


def gallery(scenes: Sequence[str] = ()) -> Made:
    """docs/img/gallery: a picture of every scene of the library, or of these."""
    return Made(draw=lambda: _draw({f"{name}.png" for name in scenes}))


def _draw(chosen: Collection[str]) -> Sequence[Path]:
    from PIL import Image

    IMAGES.mkdir(exist_ok=True)
    written = []
    with tempfile.TemporaryDirectory() as folder, contextlib.chdir(folder):
        for command, picture in COMMAND.findall(PAGE.read_text(encoding="utf-8")):
            if chosen and picture not in chosen:
                continue
            with contextlib.redirect_stdout(io.StringIO()):
                if main([*shlex.split(command), "--audit", "none"]):
                    raise RuntimeError(f"phfmu {command} did not end well")
            path = IMAGES / picture
            with Image.open(picture) as drawn:
                small = drawn.convert("RGB").quantize(COLOURS, Image.Quantize.FASTOCTREE, dither=Image.Dither.NONE)
                small.save(path, optimize=True)
            written.append(path)
    return written
