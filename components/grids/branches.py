"""Branches of a grid: which have a part, what they are called, and the vector groups of transformers."""

from __future__ import annotations

import re
from collections.abc import Collection
from math import pi

from phfmu import meant
from phfmu.importers.grid import GridError, Line, Transformer


def unsound(branch: Line | Transformer) -> str:
    """Why a branch has no part; empty for one that has."""
    what = "line" if isinstance(branch, Line) else "transformer"
    device, r, x = f"{what} {branch.i}-{branch.j} '{branch.circuit}'", branch.r, branch.x
    if x == 0:
        return f"{device}: x = 0; give it an inductance, or make its two buses one"
    if isinstance(branch, Transformer) and x < 0:
        return f"{device}: x = {x:g} pu; a transformer has a positive leakage, give its windings otherwise"
    if r < 0:
        return f"{device}: r = {r:g} pu is negative"
    if isinstance(branch, Transformer) and hour_of(branch) is None:
        degrees = branch.shift * 180 / pi
        return (
            f"{device}: it shifts the phase by {degrees:g} degrees, which no vector group does; give 0, 180 or an odd "
            "multiple of 30"
        )
    return ""


def hour_of(t: Transformer) -> int | None:
    """The hour by which side b lags side a; None for an angle that no vector group has."""
    hour = t.shift / (pi / 6)
    near = round(hour)
    return near % 12 if abs(hour - near) < 1e-6 and near % 12 in (0, 1, 5, 6, 7, 11) else None


def vector_group(t: Transformer, down: bool) -> str:
    """The group of the file where its hour is the angle; else stars with ground, for odd hours with a delta on the lower side."""
    hour = hour_of(t)
    own = re.fullmatch(r"(YN|Y|D)(yn|y|d)(\d+)", t.group)
    if own is not None and int(own[3]) == hour:
        return t.group
    return f"YNyn{hour}" if hour in (0, 6) else f"YNd{hour}" if down else f"Dyn{hour}"


def named(grid: str, text: str, there: Collection[str]) -> str:
    """The name of a branch in service: line5_7 also of line5-7 and line7-5; GridError for one that is not there."""
    name = text.replace("-", "_")
    m = re.fullmatch(r"([a-z]+)(\d+)_(\d+)(.*)", name)
    for found in (name, "" if m is None else f"{m[1]}{m[3]}_{m[2]}{m[4]}"):
        if found in there:
            return found
    raise GridError(grid, [f"no line or transformer '{text}' in service; {meant(name, there)}"])


def identifier(text: str) -> str:
    return re.sub(r"[^A-Za-z0-9]+", "_", text).strip("_")
