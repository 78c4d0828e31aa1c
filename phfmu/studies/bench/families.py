"""Models that grow with a number n."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace

from phfmu.declare.phdae import PHDAE
from phfmu.network.scene import Scene


@dataclass(frozen=True)
class Family:
    """`build(n)` with the step and stop time [s] of its run; `parts`: what n counts, `count(n)`: how many of them."""

    name: str
    parts: str
    build: Callable[[int], PHDAE]
    step: float
    sizes: tuple[int, ...]
    stop: float
    count: Callable[[int], int] = lambda n: n


def chain(n: int) -> PHDAE:
    """The library's chain as a plane pendulum: unit masses on unit bars, let go from the horizontal."""
    from phfmu.components.mechanical.chain import chain

    return replace(chain(n, dim=2, last=1.0, speed=0.0), name=f"chain_{n}", description=f"pendulum chain of {n} links")


def net(n: int) -> PHDAE:
    from phfmu.components.mechanical.net import net

    return net(n)


def ladder(n: int) -> PHDAE:
    from phfmu.components.scenes.electrical.ladder import ladder

    return ladder(n).declaration()


FAMILIES: dict[str, Family] = {
    "chain": Family("chain", "links", chain, 2e-3, (10, 30, 100, 300, 1000), 10.0),
    "net": Family("net", "particles", net, 1e-3, (4, 8, 16, 32), 1.0, lambda n: n * n),
    "ladder": Family("ladder", "machines", ladder, 1e-4, (3, 10, 30, 100), 0.1),
}


def member(target: str) -> Scene | None:
    """The member `NAME:N` of a family as a scene; None if `target` is something else, ValueError for a bad N."""
    name, colon, number = target.partition(":")
    if name not in FAMILIES or not colon:
        return None
    if not number.isdigit() or not int(number):
        raise ValueError(f"{target}: expected a number of {FAMILIES[name].parts}, e.g. {name}:10")
    family = FAMILIES[name]
    declaration = family.build(int(number))
    return Scene(declaration.name, declaration, family.stop, family.step)
