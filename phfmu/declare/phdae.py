"""The declaration of a port-Hamiltonian DAE.

    E(x) x' = (J(x) - R(x)) z(x) + B(x) u,      y = B(x)^T z(x),      E^T z = grad H,

semi-explicit: x = (x1, x2) with states x1 (E11 regular) and algebraic variables x2 = z2 (zero rows of E).

How a declaration shows itself: one line, and a table for notebooks.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable, Iterator, Mapping
from dataclasses import dataclass, field
from functools import cached_property
from os import PathLike
from typing import Any, Protocol

import casadi as ca

from phfmu.declare.block import Block
from phfmu.declare.energy import ClosedPair, Energy, EnergyKind, resolve_kind
from phfmu.declare.entries.copies import copied
from phfmu.declare.error import DeclarationError, Problem
from phfmu.declare.event import StateEvent, renamed
from phfmu.declare.holonomic import Holonomic
from phfmu.declare.observable import Observable
from phfmu.declare.port import Port
from phfmu.declare.shape import Shape
from phfmu.declare.switch import Switch, renamed_switches
from phfmu.declare.variable import Variable, VariableKind, _sx
from phfmu.html import grid
from phfmu.words import counted

#: between a member and a term of it that is booked by itself (`discretise/accounts.py`), in the names of owners
ACCOUNT = ":"


@dataclass(frozen=True, eq=False, repr=False)
class PHDAE:
    """A frozen declaration; lists of small terms, so that a network of models is a concatenation.

    energies:    H = sum of the terms
    E:           variable, or a tuple of variables (stacked) -> block of E, a function of states and parameters, diagonal
                 or not; absent = identity.  A singular block needs z and `reduce_descriptor` before it can be stepped
    structure:   blocks of J;  dissipation: blocks of R
    closed:      closed-form discrete gradient pairs for states with E(x)
    z:           variable -> given costate.  States: only checked, z is derived from H and a regular E.  Algebraic
                 variables: their effort z2(x, x2) where it is not the variable itself
    state_events: guards that steps end on, and what happens there
    switches:    ideal switches: a structure for each of their modes
    members:     owners of the terms of a composed network;  junctions: (name, member ports) it was joined at
    shapes:      what a picture of the motion shows; no equations
    """

    name: str
    states: tuple[Variable, ...] = ()
    algebraics: tuple[Variable, ...] = ()
    parameters: tuple[Variable, ...] = ()
    energies: tuple[Energy, ...] = ()
    E: Mapping[Variable | tuple[Variable, ...], Any] = field(default_factory=dict)
    structure: tuple[Block, ...] = ()
    dissipation: tuple[Block, ...] = ()
    ports: tuple[Port, ...] = ()
    constraints: tuple[Holonomic, ...] = ()
    closed: tuple[ClosedPair, ...] = ()
    observables: tuple[Observable, ...] = ()
    z: Mapping[Variable, Any] = field(default_factory=dict)
    state_events: tuple[StateEvent, ...] = ()
    switches: tuple[Switch, ...] = ()
    members: tuple[str, ...] = ("",)
    junctions: tuple[tuple[str, tuple[str, ...]], ...] = ()
    description: str = ""
    shapes: tuple[Shape, ...] = ()

    def __post_init__(self) -> None:
        found: list[Problem] = []
        for field_, kind, maker in _PARTS:
            object.__setattr__(self, field_, _listed(self.name, field_, getattr(self, field_), kind, maker, found))
        if found:
            raise DeclarationError.of(found)
        if any(e.kind is EnergyKind.GENERAL for e in self.energies):
            known = {s.element_hash() for v in self.states for s in ca.vertsplit(v.sx)}
            object.__setattr__(self, "energies", tuple(resolve_kind(e, known) for e in self.energies))
        constraints = tuple(c.with_drive() for c in self.constraints)
        there = {p.u[0].element_hash() for p in self.ports}
        drives = {c.drive.u[0].element_hash(): c.drive for c in constraints if c.drive is not None}
        object.__setattr__(self, "constraints", constraints)
        object.__setattr__(self, "ports", (*self.ports, *(p for s, p in drives.items() if s not in there)))

    @cached_property
    def x(self) -> ca.SX:
        """All states stacked (n1 x 1)."""
        return ca.vertcat(*(v.sx for v in self.states))

    @cached_property
    def hamiltonian(self) -> ca.SX:
        """H(x), the sum of all terms."""
        total = ca.SX(0)
        for term in self.energies:
            total += term.expr
        for pair in self.closed:
            total += pair.hamiltonian
        return total

    def effort(self, v: Variable | Port) -> ca.SX:
        """The costate of `v`: the symbol of a state's z; of an algebraic variable its given z, else itself."""
        given = self.z.get(v) if isinstance(v, Variable) and v.kind is VariableKind.ALGEBRAIC else None
        return v.z if given is None else ca.SX(_sx(given))

    def port(self, name: str) -> Port:
        """The port called `name`; KeyError names the ports there are."""
        for port in self.ports:
            if port.name == name:
                return port
        raise KeyError(f"{self.name} has no port '{name}'; it has: {', '.join(p.name for p in self.ports) or 'none'}")

    def with_starts(self, values: Mapping[str, float]) -> PHDAE:
        """A copy with start values (states, algebraics, parameters, inputs) replaced by scalar name, e.g. `q[2]`.

        KeyError lists close names when one is unknown.
        """
        left = dict(values)

        def renew(v: Variable) -> Variable:
            starts = [float(left.pop(n, s)) for n, s in zip(v.names(), v.start, strict=True)]
            if v.size is not None and v.name in left:
                starts = [float(left.pop(v.name))] * v.n
            return copied(v, start=tuple(starts))

        def renew_port(port: Port) -> Port:
            names = port.input_names()
            starts = [float(left.pop(n, s)) for n, s in zip(names, port.input_starts(), strict=True)]
            bare = names[0].partition("[")[0]
            if port.size is not None and bare in left:
                starts = [float(left.pop(bare))] * port.n
            return copied(port, start=tuple(starts))

        new = self.mapped(renew, renew_port)
        if left:
            raise KeyError(self.unknown_name(next(iter(left))))
        return new

    def mapped(self, variable: Callable[[Variable], Variable], port: Callable[[Port], Port]) -> PHDAE:
        """A copy with every variable and port replaced by its image (same symbols), e.g. renamed or with new starts."""
        swap: dict[int, Any] = {}
        fields = {}
        for f in ("states", "algebraics", "parameters"):
            fields[f] = tuple(swap.setdefault(id(v), variable(v)) for v in getattr(self, f))

        def image(v: Any) -> Any:  # parts of variables stand in blocks and ports only
            if isinstance(v, Port):
                return swap.get(id(v), v)
            return swap[id(v)] if id(v) in swap else swap.setdefault(id(v), variable(v))

        ports = tuple(copied(port(p), on={image(v): m for v, m in p.on.items()}) for p in self.ports)
        swap |= {id(old): new for old, new in zip(self.ports, ports, strict=True)}
        pairs = list(zip(self.parameters, fields["parameters"], strict=True))
        new = {old: name for v, w in pairs for old, name in zip(v.names(), w.names(), strict=True)}
        return copied(
            self,
            **fields,
            ports=ports,
            E={image(v) if isinstance(v, Variable) else tuple(map(image, v)): m for v, m in self.E.items()},
            z={image(v): m for v, m in self.z.items()},
            structure=tuple(b.mapped(image) for b in self.structure),
            dissipation=tuple(b.mapped(image) for b in self.dissipation),
            constraints=tuple(copied(c, multiplier=image(c.multiplier)) for c in self.constraints),
            closed=tuple(copied(c, variables=tuple(map(image, c.variables))) for c in self.closed),
            energies=tuple(copied(e, correct=tuple(map(image, e.correct))) if e.correct else e for e in self.energies),
            state_events=renamed(self.state_events, new, image),
            switches=renamed_switches(self.switches, new, image),
        )

    @property
    def modes(self) -> list[str]:
        """Scalar parameters that state events set, and modes of switches, in the order of the parameters."""
        found = {s.mode_name for s in self.switches}.union(*(e.changed for e in self.state_events))
        return [n for v in self.parameters for n in v.names() if n in found] if found else []

    def settable_names(self) -> list[str]:
        """Names that `--set` and events accept."""
        names = [n for f in (self.states, self.algebraics, self.parameters) for v in f for n in v.names()]
        return names + [n for p in self.ports if p.external for n in p.input_names()]

    def unknown_name(self, name: str) -> str:
        """The message for a name that does not exist, with close ones."""
        from difflib import get_close_matches

        close = get_close_matches(name, self.settable_names(), 5)
        hint = f"; did you mean {', '.join(close)}?" if close else ""
        return f"{self.name} has no parameter, state or input '{name}'{hint}"

    def __repr__(self) -> str:
        return f"<{_line(self)}>"

    def _repr_html_(self) -> str:
        return _table(self)


#: field, type of its items, how they are made
_PARTS: tuple[tuple[str, type, str], ...] = (
    ("states", Variable, "state(..)"),
    ("algebraics", Variable, "algebraic(..)"),
    ("parameters", Variable, "parameter(..)"),
    ("energies", Energy, "energy(..)"),
    ("structure", Block, "skew(..) or block(..)"),
    ("dissipation", Block, "damping(..) or block(..)"),
    ("ports", Port, "Port(..)"),
    ("constraints", Holonomic, "Holonomic(..)"),
    ("closed", ClosedPair, "ClosedPair(..)"),
    ("observables", Observable, "observable(..)"),
    ("state_events", StateEvent, "StateEvent(..)"),
    ("switches", Switch, "Switch(..)"),
    ("shapes", Shape, "Shape(..)"),
)


def _listed(model: str, what: str, items: Any, kind: type, maker: str, found: list[Problem]) -> tuple[Any, ...]:
    """The items of a field as a tuple; into `found` what is not a list of `kind`."""
    if isinstance(items, kind):
        text, remedy = f"{what} is one {kind.__name__}, not a list of them", f"write {what}=(.. ,)"
        found.append(Problem("type", model, text, remedy))
        return (items,)
    listed = tuple(items) if isinstance(items, Iterable) and not isinstance(items, str | Mapping) else (items,)
    for i, item in enumerate(listed):
        if not isinstance(item, kind):
            shown = f"{type(item).__name__} {str(item)[:40]!r}"
            found.append(Problem("type", model, f"entry {i + 1} of {what} is the {shown}", f"make it with {maker}"))
    return listed


def require_declaration(item: Any, what: str) -> PHDAE:
    """`item`, if it is a declaration; DeclarationError with the remedy if it only leads to one."""
    if isinstance(item, PHDAE):
        return item
    shown = f"needs a declaration (PHDAE), got the {type(item).__name__} {str(item)[:60]!r}"
    if hasattr(item, "compose"):
        remedy = "compose the network first: network.compose()"
    elif hasattr(item, "declaration"):
        remedy = "take its declaration"
    elif callable(item):
        remedy = "call the function"
    elif isinstance(item, str | PathLike):
        remedy = f"load it: phfmu.target.load({str(item)!r}) takes a name of the library or file.py:function"
    else:
        remedy = "build it in Python, e.g. phfmu.components.library.build('dc_motor'); the command line takes names and files"
    raise DeclarationError(what, shown, remedy, "type")


MOST = 4  # numbers of a vector that are shown


class DeclarationSummary(Protocol):
    """The parts of a declaration that are shown."""

    @property
    def name(self) -> str: ...
    @property
    def description(self) -> str: ...
    @property
    def states(self) -> tuple[Variable, ...]: ...
    @property
    def algebraics(self) -> tuple[Variable, ...]: ...
    @property
    def parameters(self) -> tuple[Variable, ...]: ...
    @property
    def ports(self) -> tuple[Port, ...]: ...
    @property
    def observables(self) -> tuple[Any, ...]: ...
    @property
    def state_events(self) -> tuple[Any, ...]: ...


def _line(d: DeclarationSummary) -> str:
    """Name and sizes."""
    sizes = (
        (sum(v.n for v in d.states), "state"),
        (sum(v.n for v in d.algebraics), "algebraic variable"),
        (len([v for v in d.parameters if not v.signal]), "parameter"),
        (len([p for p in d.ports if p.external]), "port"),
        (len(d.state_events), "state event"),
    )
    return f"PHDAE {d.name}: {', '.join(counted(n, noun) for n, noun in sizes if n) or 'empty'}"


def _table(d: DeclarationSummary) -> str:
    """Its variables, ports and observables with units and starts."""
    return grid(_line(d), ("", "name", "unit", "start", ""), rows(d), d.description)


def rows(d: DeclarationSummary) -> Iterator[tuple[str, str, str, str, str]]:
    """(kind, name, unit, start, description)."""
    for kind, variables in (("state", d.states), ("algebraic", d.algebraics), ("parameter", d.parameters)):
        for v in variables:
            yield "signal input" if v.signal else kind, v.name, _unit(v.unit), _start(v), v.description
    for p in (p for p in d.ports if p.external):
        given, found = p.input_names()[0].partition("[")[0], p.output_names()[0].partition("[")[0]
        units = f"{p.input_unit}, {p.output_unit}"
        yield (
            "port",
            p.name,
            units,
            "",
            f"{given} given, {found} found" + (f"; {p.description}" if p.description else ""),
        )
    for o in d.observables:
        yield "observable", o.name, _unit(o.unit), "", o.description


def _unit(unit: str) -> str:
    return "" if unit == "1" else unit


def _start(v: Variable) -> str:
    numbers = ", ".join(f"{x:.6g}" for x in v.start[:MOST])
    return numbers + (", .." if v.n > MOST else "")
