"""The page of a motion: three.js, the poses as binary and a player in one file that loads nothing from elsewhere."""

from __future__ import annotations

import base64
import html
import json
import os
from collections.abc import Sequence
from math import ceil, log10
from pathlib import Path

import numpy as np

from phfmu.declare.shape import Shape
from phfmu.report.view.poses import Floats, Motion

#: player.js is player.mjs bundled with three.js 0.187 (MIT, LICENSE.three.txt): npm install three esbuild;
#: npx esbuild player.mjs --bundle --minify --format=iife --legal-comments=none --outfile=player.js
PLAYER = Path(__file__).parent / "player"

_STYLE = """
html, body { margin: 0; height: 100%; overflow: hidden; background: #f4f5f7; color: #222;
  font: 14px system-ui, 'Segoe UI', Roboto, sans-serif; }
#stage { position: fixed; inset: 0 0 46px 0; }
#title { position: fixed; left: 14px; top: 10px; font-weight: 600; }
#hint { position: fixed; right: 14px; top: 10px; color: #667; font-size: 12px; }
#bar { position: fixed; left: 0; right: 0; bottom: 0; height: 46px; padding: 0 14px; display: flex; gap: 12px;
  align-items: center; background: #fff; border-top: 1px solid #d5dae0; box-sizing: border-box; }
#time { flex: 1; } #clock { min-width: 6em; text-align: right; font-variant-numeric: tabular-nums; }
#scale { color: #667; font-size: 12px; } button { min-width: 5em; } label { white-space: nowrap; }
"""
_BODY = """<div id="stage"></div><div id="title">{title}</div>
<div id="hint">drag: turn &middot; right drag: move &middot; wheel: zoom &middot; space: play</div>
<div id="bar"><button id="play">Play</button><button id="reset">View</button><select id="speed"></select>
<input id="time" type="range"><span id="clock"></span>
<label><input id="trails" type="checkbox"> trails</label>
<label title="of rods: red is pulled, blue is pushed"><input id="forces" type="checkbox"> forces
<span id="scale"></span></label></div>
"""


def write_view(motion: Motion, path: str | os.PathLike[str]) -> None:
    """Write the page of a motion; `page.html#t=1.5` stands still at that time in s. Errors: OSError."""
    # nothing in the data may end the script that holds it
    data = json.dumps(_data(motion), ensure_ascii=False, separators=(",", ":")).replace("<", "\\u003c")
    title = html.escape(motion.title)
    licence = (PLAYER / "LICENSE.three.txt").read_text(encoding="utf-8")
    with open(path, "w", encoding="utf-8") as file:
        file.write(
            f'<!DOCTYPE html>\n<html lang="en">\n<head>\n<meta charset="utf-8">\n<title>{title}</title>\n'
            f"<style>{_STYLE}</style>\n</head>\n<body>\n{_BODY.format(title=title)}"
            f"<script>window.MOTION={data};</script>\n<script>/* with three.js:\n{licence}*/\n"
        )
        file.write((PLAYER / "player.js").read_text(encoding="utf-8"))
        file.write("</script>\n</body>\n</html>\n")


def _data(motion: Motion) -> dict[str, object]:
    """The data that the player reads as window.MOTION."""

    def described(shapes: Sequence[Shape]) -> list[dict[str, object]]:
        return [{"kind": s.kind.value, "label": s.label, "size": motion.size(s)} for s in shapes]

    span = float(motion.time[-1] - motion.time[0])
    return {
        "solids": described(motion.solids),
        "lines": described(motion.lines),
        "low": motion.low.tolist(),
        "high": motion.high.tolist(),
        "extent": motion.extent,
        "digits": max(2, 2 - ceil(log10(span))) if span > 0.0 else 2,
        "time": _packed(motion.time),
        "poses": _packed(motion.poses),
        "ends": _packed(motion.ends),
        "tension": _packed(motion.tension),
    }


def _packed(values: Floats) -> str:
    """Numbers in single precision, little-endian, as base64."""
    return base64.b64encode(np.ascontiguousarray(values, "<f4").tobytes()).decode()
