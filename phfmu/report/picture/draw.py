"""A picture into a file, by its ending."""

import os
from pathlib import Path

from phfmu.files import require_writable
from phfmu.report.picture.extra import require
from phfmu.report.picture.picture import Picture

ENDINGS = {".png": "matplotlib", ".html": "plotly"}


def check_picture(path: str | os.PathLike[str], option: str) -> None:
    """Check before long work of what would fail after it. Errors: ValueError for ending, folder, a package that is missing."""
    ending = Path(path).suffix
    if ending not in ENDINGS:
        raise ValueError(f"{option} {path}: the ending must be .png or .html")
    require(ENDINGS[ending])
    require_writable(Path(path), f"{option} {path}")


def draw(picture: Picture, path: str | os.PathLike[str], size: tuple[int, int] | None = None) -> None:
    """Write the picture as PNG (`size`: width, height in pixels) or HTML."""
    if Path(path).suffix == ".png":
        from phfmu.report.picture.png import write_png

        write_png(picture, path, size)
    else:
        from phfmu.report.picture.html import write_html

        write_html(picture, path)
