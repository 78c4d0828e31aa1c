"""Where R is not positive semidefinite in a given state: what a negative dissipation comes from."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass

import casadi as ca

from phfmu.checks.matrices import lowest, summed
from phfmu.checks.sample import Sample
from phfmu.declare.entries import Entries, normal_form
from phfmu.declare.phdae import PHDAE


@dataclass(frozen=True)
class SignLost:
    """A group of blocks of R that share rows: its owner, entries and rows, its lowest eigenvalue, the row closest to the
    direction of that, and the values the blocks depend on."""

    owner: str
    entry: str
    rows: tuple[str, ...]
    eigenvalue: float
    along: str
    values: Mapping[str, float]

    def __str__(self) -> str:
        text = f"{self.entry} has the eigenvalue {self.eigenvalue:.6g}, mostly along '{self.along}'"
        shown = [f"{name} = {value:.6g}" for name, value in list(self.values.items())[:6]]
        return f"{text}, at {', '.join(shown)}" if shown else text


def sign_lost(model: PHDAE, values: Mapping[str, float], t: float = 0.0, owner: str | None = None) -> list[SignLost]:
    """The groups of R (of one `owner`) with a negative eigenvalue at time t; the lowest first.

    `values`: by scalar name those of states, algebraic variables, inputs and parameters that are not as declared; names the
    model does not have are skipped.
    """
    known = {*(n for v in (*model.states, *model.algebraics, *model.parameters) for n in (v.name, *v.names()))}
    known |= {n for p in model.ports for n in p.input_names()}
    entries = Entries(model.with_starts({n: float(v) for n, v in values.items() if n in known}))
    normal_form(entries)
    sample = Sample(entries, t=t)
    found = []
    for blocks, names, total in summed(entries, sample):
        owners = {b.origin.owner for b in blocks}
        _, value, direction = lowest(total[0])
        if not value or (owner is not None and owner not in owners):
            continue
        label = "; ".join(dict.fromkeys(b.label for b in blocks))
        at = sample.at_start(ca.vertcat(*(ca.vec(b.expr) for b in blocks)))
        found.append(SignLost(min(owners), label, tuple(names), float(value), names[direction], at))
    return sorted(found, key=lambda s: s.eigenvalue)
