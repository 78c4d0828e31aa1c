"""Parameters, inputs and start values that a run is derived by, and how its start moves with them.

Where hidden constraints hold at the start (currents that sum to zero, lengths), a parameter that is in them moves the start as
`phfmu run --project` would.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from phfmu.declare.entries.parameter_limits import ParameterLimit, limits
from phfmu.declare.phdae import PHDAE
from phfmu.discretise.model import Model
from phfmu.signals import of_member

Array = NDArray[np.float64]

#: steps of differences, of the size of what is moved: the error of the extrapolation and rounding are about 1e-11 there
DIFFERENCES = (2e-4, 1e-4)


@dataclass(frozen=True)
class TangentDirections:
    """Scalars to derive by: places among the parameters, and among the inputs, which are held over a step."""

    parameters: tuple[int, ...]
    inputs: tuple[int, ...]

    @property
    def n(self) -> int:
        return len(self.parameters) + len(self.inputs)

    def of(self, p: Array, u: Array) -> Array:
        """Entries of these scalars (.. x n) among those of all parameters (.. x np) and inputs (.. x nu)."""
        return np.concatenate([p[..., list(self.parameters)], u[..., list(self.inputs)]], axis=-1)


@dataclass(frozen=True)
class ScalarData:
    """Scalars that a run may be derived by: start values, nominal values of states, limits of parameters, and units, by name."""

    start: dict[str, float]
    nominal: dict[str, float]
    limits: dict[str, ParameterLimit]
    units: dict[str, str]

    @staticmethod
    def of(model: Model) -> ScalarData:
        """Those of a model."""
        d, values = model.declaration, (*model.declaration.parameters, *model.declaration.states)
        start = {n: x for v in values for n, x in zip(v.names(), v.start, strict=True)}
        ports = [p for p in d.ports if p.external]
        start |= dict(zip((n for p in ports for n in p.input_names()), model.u0.tolist(), strict=True))
        nominal = {n: abs(x) for v in d.states for n, x in zip(v.names(), v.nominal, strict=True)}
        units = {n: v.unit for v in values for n in v.names()} | {
            n: p.input_unit for p in ports for n in p.input_names()
        }
        return ScalarData(start, nominal, limits(d), units)

    @staticmethod
    def joined(members: Mapping[str, ScalarData]) -> ScalarData:
        """Those of members, by the name of the whole."""
        found = ScalarData({}, {}, {}, {})
        for m, own in members.items():
            for to, values in zip(vars(found).values(), vars(own).values(), strict=True):
                to.update({of_member(m, n): v for n, v in values.items()})
        return found


@dataclass(frozen=True)
class IndependentVariables:
    """Scalar names that a run is derived by, in their order: each is a parameter, an input or the start of a state."""

    names: tuple[str, ...]
    directions: TangentDirections
    #: column of each direction, and of the start of each state: (state, column)
    columns: tuple[int, ...]
    starts: tuple[tuple[int, int], ...]

    @staticmethod
    def of(declaration: PHDAE, names: Sequence[str]) -> IndependentVariables:
        """Vectors stand for all their entries.  Raises KeyError for a name that is no parameter, input or state."""
        d = declaration
        found = IndependentVariables.chosen(*declared_scalars(d), names, d.unknown_name)
        if modes := [n for n in found.names if n in d.modes]:
            raise KeyError(f"{d.name}: '{modes[0]}' is a mode that state events set; there is no derivative by it")
        return found

    @staticmethod
    def chosen(
        p: Sequence[str],
        u: Sequence[str],
        x: Sequence[str],
        names: Sequence[str],
        unknown: Callable[[str], str] = "there is no '{}'".format,
    ) -> IndependentVariables:
        """The same of scalar parameters, inputs and states by their names; unknown: words for a name that is none of them."""
        whole: dict[str, list[str]] = {}
        for n in (*p, *u, *x):
            whole.setdefault(n.partition("[")[0], []).append(n)
        scalars = list(dict.fromkeys(n for name in names for n in whole.get(name, [name])))
        if lost := [n for n in scalars if n not in (*p, *u, *x)]:
            raise KeyError(unknown(lost[0]))
        of_p, of_u = ([n for n in scalars if n in set(some)] for some in (p, u))
        directions = TangentDirections(tuple(p.index(n) for n in of_p), tuple(u.index(n) for n in of_u))
        starts = tuple((x.index(n), scalars.index(n)) for n in scalars if n in set(x))
        return IndependentVariables(tuple(scalars), directions, tuple(scalars.index(n) for n in (*of_p, *of_u)), starts)

    def among(self, name: str) -> list[str]:
        """The names that `name` means, a vector all its entries."""
        return [n for n in self.names if n == name or n.partition("[")[0] == name]

    def require_constant(self, model: str, names: Sequence[str]) -> None:
        """ValueError where one of the names, which change within a run of `model`, is derived by."""
        for name in dict.fromkeys(names):
            if clash := self.among(name):
                raise ValueError(
                    f"{model}: {clash[0]} is set within the run, by an event or by data, so that there is no one value of it to "
                    "be derived by"
                )

    def sizes(self, x: Array, u: Array, p: Array) -> Array:
        """Magnitudes of the values (names) that a run is derived by, 1 of those that are 0."""
        found = np.zeros(len(self.names))
        for state, column in self.starts:
            found[column] = x[state]
        found[list(self.columns)] = self.directions.of(p, u)
        return np.where(found == 0.0, 1.0, np.abs(found))

    def spread(self, along: Array) -> Array:
        """Derivatives by the directions (.. x directions) as such by all names (.. x names)."""
        found = np.zeros((*along.shape[:-1], len(self.names)))
        found[..., list(self.columns)] = along
        return found


def declared_scalars(d: PHDAE) -> tuple[list[str], list[str], list[str]]:
    """Scalar parameters, inputs of external ports with power, and states of a declaration."""
    p, x = ([n for v in own for n in v.names()] for own in (d.parameters, d.states))
    return p, [n for q in d.ports if q.external and not q.signal for n in q.input_names()], x


def require_known(slopes: Array, signal: str) -> None:
    """ValueError where derivatives of a signal count of which some are not known (NaN), those in the row of the start."""
    if np.isnan(slopes).any():
        raise ValueError(
            f"{signal} has no derivative in the row of the start, which counts here; leave out what is before the end of the "
            "first step"
        )


def start_tangents_by(model: Model, by: IndependentVariables, given: Array, x: Array, p: Array, t: float) -> Array:
    """Tangents (nx x names) of the states at a start x, which `given` was projected to where constraints hold."""
    S, along = np.zeros((model.step.nx, len(by.names))), np.zeros((len(p), len(by.names)))
    for state, column in by.starts:
        S[state, column] = 1.0
    for parameter, column in zip(by.directions.parameters, by.columns, strict=False):
        along[parameter, column] = 1.0
    return _held(model, given, x, p, t, S, along) if model.checks else S


def _held(model: Model, given: Array, x: Array, p: Array, t: float, dx: Array, dp: Array) -> Array:
    """Tangents (nx x n) of a start that is projected onto its constraints, from `given` to x, along dx and dp (np x n).

    Where the projection has moved it, they are differences of projections, extrapolated from two steps.
    """
    from phfmu.discretise.start import project_start, start_tangents

    if np.array_equal(given, x):
        return start_tangents(model, x, p, t, dx, dp)
    columns = []
    for along, by in zip(dx.T, dp.T, strict=True):
        size = max(_size(x, along), _size(p, by)) or 1.0
        found = []
        for part in DIFFERENCES:
            ends = [project_start(model, given + e * along, p=p + e * by, t=t).x for e in (part * size, -part * size)]
            found.append((ends[0] - ends[1]) / (2 * part * size))
        columns.append(found[1] + (found[1] - found[0]) / 3.0)
    return np.column_stack(columns)


def _size(values: Array, along: Array) -> float:
    """The way along a direction that moves the values by their size."""
    moved = along != 0
    return float(np.max(np.abs(values[moved]) / np.abs(along[moved]), initial=0.0))
