"""A discretised model: the step plan, the instant plan and the start values, everything an engine needs.

The discretised model of every mode of a declaration with switches, built when it is first stepped.
"""

from __future__ import annotations

from collections.abc import Callable, Hashable
from dataclasses import dataclass, field, replace
from functools import lru_cache, wraps
from typing import Any, Concatenate, Generic, ParamSpec, TypeVar
from weakref import WeakValueDictionary

import casadi as ca
import numpy as np
from numpy.typing import NDArray

from phfmu.collector import resting
from phfmu.declare.entries.alike import first_alike
from phfmu.declare.entries.starts import starts
from phfmu.declare.error import DeclarationError
from phfmu.declare.phdae import PHDAE, require_declaration
from phfmu.declare.variable import Variable, _sx, time
from phfmu.discretise.instant import instant_plan
from phfmu.discretise.onestep import step_plan
from phfmu.events.event_plan import EventPlan, event_plan
from phfmu.events.modes import Mode, Modes
from phfmu.events.polynomial import Polynomial
from phfmu.html import grid
from phfmu.plan.layout import Layout
from phfmu.plan.plan import Kernel, Plan
from phfmu.schemes.collocated import Collocated
from phfmu.schemes.scheme import Scheme
from phfmu.schemes.two_level import TwoLevel
from phfmu.terms.extraction.extract import extract
from phfmu.terms.hidden import Check
from phfmu.terms.rank import at_start, hold_names
from phfmu.terms.rows import check_rows
from phfmu.terms.term import Terms

M = TypeVar("M")


class ModeModels(Generic[M]):
    """Models by mode; `make` discretises a declaration without switches."""

    def __init__(self, modes: Modes, make: Callable[[PHDAE], M]):
        self.modes, self._make = modes, make
        self._known: dict[Mode, M] = {}

    def __getitem__(self, mode: Mode) -> M:
        if mode not in self._known:
            self._known[mode] = self._make(self.modes.declared(mode))
        return self._known[mode]

    @property
    def known(self) -> list[Mode]:
        """Modes that were built, in that order."""
        return list(self._known)


Array = NDArray[np.float64]
P = ParamSpec("P")
R = TypeVar("R")

#: A start is consistent if every hidden constraint is below this fraction of its natural size.
CONSISTENCY = 1e-8


@dataclass(frozen=True, eq=False, repr=False)
class Model:
    """Plans and start values of one declaration under one scheme.

    x0 (nx), a0 (na), u0 (nu), p0 (np): starts;  `checks`, `check_scale`: hidden constraints, reported as the last
    observables, and their natural size at the start;  `row_names`, `instant_names`: a name per residual row.
    """

    name: str
    declaration: PHDAE
    scheme: Scheme
    step: Plan
    instant: Plan
    x0: Array
    a0: Array
    u0: Array
    p0: Array
    t0: float = 0.0
    checks: tuple[Check, ...] = ()
    check_scale: Array = field(default_factory=lambda: np.zeros(0))
    row_names: tuple[str, ...] = ()
    instant_names: tuple[str, ...] = ()
    members: tuple[str, ...] = ("",)
    observable_names: tuple[str, ...] = ()
    #: multiplier and name in the declaration of each constraint that may rest
    hold_names: tuple[str, ...] = ()
    #: its state events, None without
    events: EventPlan | None = None
    #: the models of the modes of a declaration with switches; this one has their common part, in the mode at the start
    modes: ModeModels[Model] | None = None
    #: the model of a declaration like this one whose plans these are; None: its own
    first: Model | None = None

    def __repr__(self) -> str:
        return f"<Model {self.name}: {self.scheme.name}, order {self.scheme.order}; {repr(self.declaration)[1:-1]}>"

    def _repr_html_(self) -> str:
        """Table for notebooks: the scheme and the declaration."""
        return grid(f"Model {self.name}", ("scheme", "order"), [(self.scheme.name, str(self.scheme.order))]) + (
            self.declaration._repr_html_()
        )

    @property
    def kernels(self) -> list[Kernel]:
        """Kernels of both plans, in order of appearance; the same object may appear twice."""
        return [g.kernel for plan in (self.step, self.instant) for g in plan.groups]

    @property
    def loses_energy(self) -> bool:
        """The scheme has a numerical loss, which its ledger books; a model without energies has none."""
        return any(g.kernel.loses_energy for g in self.step.groups)

    @property
    def nodes(self) -> Array:
        """The k quadrature nodes on [0, 1]."""
        return self.step.nodes


def _stack(variables: tuple[Variable, ...]) -> Array:
    return np.array([s for v in variables for s in v.start], float)


def build_model(declaration: PHDAE, scheme: Scheme | None = None) -> Model:
    """Discretise `declaration`; DeclarationError names what does not fit.  Default: `default_scheme`.

    Components that are alike, but for their start values, share plans and what is compiled of them as long as one is in use.
    """
    if bad := starts(require_declaration(declaration, "build_model")):
        raise DeclarationError.of(bad)
    chosen = default_scheme(declaration) if scheme is None else scheme
    if not declaration.switches:
        return _shared(declaration, chosen)
    models = ModeModels(Modes(declaration), lambda declared: _discretised(declared, chosen, True))
    return replace(models[models.modes.start], checks=(), check_scale=np.zeros(0), modes=models)


_PLANNED: WeakValueDictionary[tuple[Hashable, ...], Model] = WeakValueDictionary()


def _shared(declaration: PHDAE, scheme: Scheme) -> Model:
    """The model, on the plans of one that is alike if there is such; composed networks are not looked for."""
    lands = bool(declaration.state_events)
    if declaration.members != ("",):
        return _discretised(declaration, scheme, lands)
    own = _starts(declaration)
    key = (first_alike(declaration), scheme)
    at_start = (*key, *(v.tobytes() for v in own.values()))
    first = _PLANNED.get(key) or _PLANNED.get(at_start)
    if first is not None:
        return replace(first, name=declaration.name, declaration=declaration, first=first, **own)
    made = _PLANNED[at_start] = _discretised(declaration, scheme, lands)
    if not _planned_at_start(made):
        _PLANNED[key] = made
    return made


def _planned_at_start(model: Model) -> bool:
    """True if start values decide something of the plans: what rests, which impulses fit, what is regular."""
    d = model.declaration
    diagonal = all(isinstance(v, Variable) and ca.SX(_sx(m)).sparsity().is_diag() for v, m in d.E.items())
    return bool(d.constraints or d.closed or model.checks or not diagonal)


def _starts(declaration: PHDAE) -> dict[str, Any]:
    u0 = [s for p in declaration.ports if p.external for s in p.input_starts()]
    return {"x0": _stack(declaration.states), "a0": _stack(declaration.algebraics), "u0": np.array(u0, float),
            "p0": _stack(declaration.parameters)}  # fmt: skip


@lru_cache(maxsize=1)
def _terms(declaration: PHDAE, joint: bool) -> Terms:
    """Terms that all schemes of a declaration begin with; the model of another scheme is mostly made right after the first."""
    return at_start(extract(declaration, joint=joint))


@lru_cache(maxsize=1)
def _instant(declaration: PHDAE, joint: bool, rests: bool) -> tuple[Plan, list[Check], Layout]:
    """The plan of an instant, which schemes have in common."""
    return instant_plan(_terms(declaration, joint), rests=rests)


@lru_cache(maxsize=1)
def _events(declaration: PHDAE, joint: bool) -> Callable[[Polynomial], EventPlan]:
    """The state events of a declaration, which schemes have in common but for the polynomial of their steps."""
    return event_plan(_terms(declaration, joint))


def _check_scales(terms: Terms, checks: list[Check], x0: Array, p0: Array) -> Array:
    """Natural size of each check: the sum over states of |d check / d x| times the larger of nominal and start."""
    if not checks:
        return np.zeros(0)
    model = terms.model
    nominal = np.array([v.nominal[j] for v in model.states for j in range(v.n)])
    size = np.maximum(nominal, np.abs(x0))
    parameters = ca.vertcat(*(p.sx for p in model.parameters))
    rows = check_rows(terms, checks)
    jac = ca.Function("j", [model.x, parameters, time], [ca.jacobian(ca.vertcat(*rows), model.x)])
    sizes = ca.fabs(jac(x0, p0, 0.0)) @ size  # sparse: rows x states would not fit for large models
    return np.array(sizes).ravel() + 1e-300


@resting()
def _discretised(declaration: PHDAE, scheme: Scheme, lands: bool) -> Model:
    terms = _terms(declaration, scheme.joint)
    step, layout = step_plan(terms, scheme)
    instant, checks, instant_layout = _instant(declaration, scheme.joint, len(step.hold) > 0)
    own = _starts(declaration)
    return Model(
        declaration.name, declaration, scheme, step, instant, **own,
        checks=tuple(checks), check_scale=_check_scales(terms, checks, own["x0"], own["p0"]), row_names=tuple(layout.names()),
        instant_names=tuple(instant_layout.names()), members=tuple(terms.members),
        observable_names=tuple(terms.observable_names), hold_names=hold_names(terms) if len(step.hold) else (),
        events=_events(declaration, scheme.joint)(Polynomial(layout, scheme.nodes, scheme.maps(layout))) if lands else None,
    )  # fmt: skip


def require_model(item: Any, what: str) -> Model:
    """`item`, if it is a model; TypeError with the remedy else."""
    if isinstance(item, Model):
        return item
    remedy = "build it: build_model(declaration)"
    if isinstance(item, PHDAE):
        remedy = "leave the declaration out, the model carries it: build_model(declaration)"
    shown = f"{type(item).__name__} {str(getattr(item, 'name', item))[:60]!r}"
    raise TypeError(f"{what} takes a model first, got the {shown}; {remedy}")


def takes_model(function: Callable[Concatenate[Model, P], R]) -> Callable[Concatenate[Model, P], R]:
    """The function with a check of its first argument: TypeError with the remedy if that is no model."""

    @wraps(function)
    def checked(model: Model, *args: P.args, **kwargs: P.kwargs) -> R:
        return function(require_model(model, function.__name__), *args, **kwargs)

    return checked


def default_scheme(declaration: PHDAE, order: int = 2) -> Scheme:
    """Two-level with holonomic constraints, plain collocation else."""
    return TwoLevel(order // 2) if declaration.constraints else Collocated(order // 2)
