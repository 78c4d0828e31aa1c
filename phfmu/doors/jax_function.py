"""A run or a step as a function of JAX, with its derivatives backwards (extra `jax`)."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from typing import Any

import numpy as np

from phfmu.doors.function import Differentiable, restricted


def jax_function(of: Differentiable, free: Sequence[str] | None = None) -> Callable[..., Any]:
    """A function of JAX arrays, one for each block of arguments, to an array, or a tuple of them for several results.

    free:  the arguments that it has, in their order; others are what the model declares (default: it has all)
    `grad`, `vjp`, `jacrev` go through it, `jit` too; `vmap` calls it once for each entry.  Forward and second derivatives do not.
    Errors: ImportError without JAX; ValueError while it computes in 32 bits; KeyError for an argument that there is not.
    """
    try:
        import jax  # pyright: ignore[reportMissingImports]
    except ImportError as error:
        raise ImportError('jax_function needs JAX: pip install "phfmu[jax]"') from error
    own = restricted(of, free)
    one = len(own.outputs) == 1

    def shapes(blocks: Sequence[Any]) -> tuple[Any, ...]:
        if not jax.config.jax_enable_x64:  # pyright: ignore[reportAttributeAccessIssue]
            raise ValueError(
                f"{own.name}: JAX computes in 32 bits, which runs do not; jax.config.update('jax_enable_x64', True) before the "
                "first array"
            )
        return tuple(jax.ShapeDtypeStruct((b.n,), np.float64) for b in blocks)

    def back(arguments: Sequence[Any], bars: Sequence[Any]) -> tuple[Any, ...]:
        return own.reverse([*map(np.asarray, arguments)], [*map(np.asarray, bars)])

    @jax.custom_vjp
    def function(*arguments: Any) -> Any:
        found = jax.pure_callback(
            lambda *a: own.values(*map(np.asarray, a)), shapes(own.outputs), *arguments, vmap_method="sequential"
        )
        return found[0] if one else tuple(found)

    def forward(*arguments: Any) -> tuple[Any, Any]:
        return function(*arguments), arguments

    def reverse(arguments: Any, bars: Any) -> Any:
        bars = (bars,) if one else tuple(bars)
        return tuple(jax.pure_callback(back, shapes(own.inputs), arguments, bars, vmap_method="sequential"))

    function.defvjp(forward, reverse)
    return function
