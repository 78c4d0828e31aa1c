"""Starts of the new variables of a system transformation: phi(x~) = x solved."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

import casadi as ca
import numpy as np
from numpy.typing import NDArray

from phfmu.declare.error import DeclarationError
from phfmu.declare.regular import undetermined
from phfmu.declare.transform.maps import Maps

Array = NDArray[Any]

ITERATIONS = 50


def solved_starts(T: Maps, old: Array, p: Array, parameters: ca.SX, model: str) -> Array:
    """x~ with phi(x~) = x, by Newton from the starts of the new variables.

    DeclarationError if there is none nearby, or if Dphi or U is singular there.
    """
    f = ca.Function("phi", [T.x, parameters], [T.image, ca.densify(T.jacobian), ca.densify(T.U)])
    x = np.array([s for v in T.new for s in v.start])
    names = [n for v in T.new for n in v.names()]
    size = np.array([s for v in T.old for s in v.nominal]) + np.abs(old)

    def residual(x: Array) -> tuple[Array, Array, Array]:
        value, D, U = (np.array(a) for a in f(x, p))
        return value.ravel() - old, D, U

    r, D, U = residual(x)
    for _ in range(ITERATIONS):
        if not np.isfinite(r).all() or np.max(np.abs(r) / size) <= 1e-15:
            break
        step, scale = np.linalg.lstsq(D, -r, rcond=None)[0], 1.0
        while scale > 1e-4:  # damped: the first guess may be far
            new = residual(x + scale * step)
            if np.isfinite(new[0]).all() and np.linalg.norm(new[0] / size) < np.linalg.norm(r / size):
                break
            scale /= 2
        else:
            break
        x, (r, D, U) = x + scale * step, new
    if np.isfinite(r).all():
        _require_regular({"Dphi": D, "U": U}, x, names, model)
    if not np.isfinite(r).all() or np.max(np.abs(r) / size) > 1e-9:
        worst = int(np.argmax(np.nan_to_num(np.abs(r) / size, nan=np.inf)))
        old_names = [n for v in T.old for n in v.names()]
        raise DeclarationError(
            model,
            f"no start of {', '.join(names)} found with phi(x~) = x: '{old_names[worst]}' is missed by {r[worst]:.6g}",
            "give the new variables starts near the solution",
            "start",
        )
    return x


def _require_regular(matrices: Mapping[str, Array], x: Array, names: list[str], model: str) -> None:
    for what, matrix in matrices.items():
        column = undetermined(matrix)
        if column >= 0:
            raise DeclarationError(
                model,
                f"{what} is singular at {names[column]} = {x[column]:.6g} (singular values {_values(matrix)}); a "
                "transformation is invertible near regular points only",
                "start elsewhere or use other coordinates",
                "singular",
            )


def _values(matrix: Array) -> str:
    if not np.isfinite(matrix).all():
        return "not finite"
    values = np.linalg.svd(matrix, compute_uv=False)
    return f"{values[0]:.3g} .. {values[-1]:.3g}"
