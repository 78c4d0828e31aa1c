"""A sheet of masses and springs."""

from __future__ import annotations

from phfmu import PHDAE
from phfmu.components.mechanical.multibody import Multibody, Particle


def net(n: int = 8, *, k: float = 1000.0, mass: float = 0.1, spacing: float = 0.1, tension: float = 1.05) -> PHDAE:
    """A square sheet of n x n particles, hung at two corners, that swings down from the horizontal.

        H = sum 1/2 m |v_i|^2 + m g z_i + sum over neighbours 1/2 k (|q_j - q_i| - l)^2,   l = spacing / tension

    n:        particles along an edge (from 2);  k [N/m], mass [kg] of a particle, spacing [m] at the start
    tension [1]:  ratio of the start spacing to the natural length: slightly stretched, so that no spring is slack
    Errors:   ValueError for n below 2.
    """
    if n < 2:
        raise ValueError(f"net: n = {n}, a sheet needs at least 2 particles along an edge")
    body = Multibody(f"net_{n}", description=f"sheet of {n} x {n} masses with springs, hung at two corners")
    body.gravity((0.0, 0.0, -9.81))
    length = spacing / tension
    sheet = [[body.particle(mass, (spacing * i, spacing * j, 0.0)) for j in range(n)] for i in range(n)]
    hooks = (body.support((0.0, -spacing, 0.0)), body.support((spacing * (n - 1), -spacing, 0.0)))
    for hook, corner in zip(hooks, (sheet[0][0], sheet[-1][0]), strict=True):
        body.linear_spring(hook, corner, k, length)

    def join(a: Particle, b: Particle) -> None:
        body.linear_spring(a, b, k, length)

    for i in range(n):
        for j in range(n):
            if i + 1 < n:
                join(sheet[i][j], sheet[i + 1][j])
            if j + 1 < n:
                join(sheet[i][j], sheet[i][j + 1])
    return body.build()
