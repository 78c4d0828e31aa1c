"""Domains and power ports.

A port is a block B of the input matrix with its conjugate pair:  y = B^T z,  power into the component = u^T y.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import Any, Literal

import casadi as ca

from phfmu.declare.elements import element_names
from phfmu.declare.error import DeclarationError
from phfmu.declare.variable import Number, Variable, _values

Given = Literal["effort", "flow"]


def conjugate(member: Given) -> Given:
    """The other one of a pair."""
    return "flow" if member == "effort" else "effort"


@dataclass(frozen=True)
class Domain:
    """A physical domain: names and units of effort and flow; their product is a power in watt."""

    name: str
    effort: str
    effort_unit: str
    flow: str
    flow_unit: str
    #: What ports share where they meet: "effort" (0-junction: a bus) or "flow" (1-junction: a rigid joint).
    common: Given

    @property
    def summed(self) -> Given:
        """The member of the pair that sums to zero where ports meet."""
        return conjugate(self.common)

    def word(self, member: Given) -> str:
        """The name of a member of the pair in this domain, e.g. `velocity`."""
        return self.effort if member == "effort" else self.flow

    def unit(self, member: Given) -> str:
        """The unit of that member."""
        return self.effort_unit if member == "effort" else self.flow_unit


ELECTRICAL = Domain("electrical", "v", "V", "i", "A", "effort")
TRANSLATIONAL = Domain("translational", "force", "N", "velocity", "m/s", "flow")
ROTATIONAL = Domain("rotational", "torque", "N.m", "speed", "rad/s", "flow")
HYDRAULIC = Domain("hydraulic", "pressure", "Pa", "flow", "m3/s", "effort")
#: those that units of other tools are told to be of, by their names
DOMAINS = {d.name: d for d in (ELECTRICAL, TRANSLATIONAL, ROTATIONAL, HYDRAULIC)}
#: A moving constraint: time passes at the rate 1 and takes the power of the constraint forces.
DRIVE = Domain("drive", "power", "W", "clock", "1", "flow")
#: Signals that members stepped apart exchange: values, whose power is zero; each is of a unit of its own.
SIGNAL = Domain("signal", "", "1", "", "1", "effort")


@dataclass(frozen=True, eq=False)
class Port:
    """A power port: B acts on the rows of `on`, y = B^T z; positive power flows INTO the component.

    A port may also stand among the variables of a block of J or R, where it has the row -y and the costate u; see
    `Block` for what this makes of feedthrough.

    given:   which member of the pair is the input u ("effort" or "flow")
    on:      its columns of B: variable -> coefficients (len(variable) x size), may depend on x and parameters; a number is
             that multiple of the identity; {} = feedthrough only.  Port("terminal", ELECTRICAL, "effort", {flux: 1.0})
             puts 1.0 v on the row of flux and reads i = flux.z
    size:    number of scalar pairs that the port bundles, as the 3 phases of a terminal: u and y have `size` entries, called
             terminal.v[1] .. terminal.v[3], and their powers add up.  None: one pair without an index, terminal.v;
             1: a vector with one entry, terminal.v[1]
    source:  expression (size x 1) of `time` and parameters: the port is fed from inside the model and its
             work is booked here; None = the input is free
    bound:   algebraic variable that feeds the port from inside a composed network; None = free
    start:   input value before anyone sets it
    nominal: size of the input, one number or one for each entry: what tests drive it by and couplings scale by
    elements: what the pairs are called in pictures, e.g. ("a", "b", "c") for the phases of a terminal
    """

    name: str
    domain: Domain
    given: Given
    on: Mapping[Variable, Any] = None  # type: ignore[assignment]  # asked for below, with an example
    size: int | None = None
    source: Any = None
    bound: tuple[ca.SX, ...] | None = None
    start: Number = 0.0
    nominal: Number = 1.0
    description: str = ""
    owner: str = ""
    u: ca.SX = field(default=None, repr=False)  # type: ignore[assignment]
    elements: tuple[str, ...] = ()

    def __post_init__(self) -> None:
        self._require_sound()
        object.__setattr__(self, "elements", element_names(f"port '{self.name}'", self.elements, self.size))
        if self.u is None:
            object.__setattr__(self, "u", ca.SX.sym("u." + self.name, self.n))

    def _require_sound(self) -> None:
        """Raise DeclarationError if the domain, the given member or the columns are none; `check` looks at their contents."""
        entry, example = f"port '{self.name}'", f'Port("{self.name}", ELECTRICAL, "effort", {{flux: 1.0}})'
        domain, remedy = self.domain, f"e.g. {example}"
        if not isinstance(domain, Domain):
            raise DeclarationError(
                entry, f"domain = {domain!r} is no Domain", f"give one such as ELECTRICAL, {remedy}", "port"
            )
        if self.given not in ("effort", "flow"):
            own = f"of {domain.name} ports 'effort' is {domain.effort}, 'flow' is {domain.flow}"
            raise DeclarationError(entry, f"given = {self.given!r} is neither 'effort' nor 'flow'", own, "port")
        if self.on is None:
            remedy = f"say on which variables its input acts, and how much, {remedy}; {{}} is for feedthrough only"
            raise DeclarationError(entry, "its columns of B are missing", remedy, "port")
        if not isinstance(self.on, Mapping):
            reason = f"its columns of B are a {type(self.on).__name__}, not a mapping from variables to coefficients"
            raise DeclarationError(entry, reason, remedy, "port")

    @property
    def n(self) -> int:
        """Number of scalar pairs."""
        return self.size or 1

    @property
    def kind(self) -> str:
        """Tells it from variables."""
        return "port"

    @property
    def sx(self) -> ca.SX:
        """Its input, which stands for the port in blocks of J and R."""
        return self.u

    @property
    def z(self) -> ca.SX:
        """Its costate in blocks of J and R: the input."""
        return self.u

    def names(self) -> list[str]:
        """Names of its entries in blocks of J and R: the inputs."""
        return self.input_names()

    @property
    def signal(self) -> bool:
        """True for the port of a signal, which has no power."""
        return self.domain.name == SIGNAL.name

    @property
    def sends(self) -> bool:
        """True for that of a signal output, whose input is no one's."""
        return self.signal and self.given == "flow"

    @property
    def external(self) -> bool:
        """True if the input comes from outside the model."""
        return self.source is None and self.bound is None

    def _member(self, member: str) -> str:
        """`port.member`; signals are called by their own names."""
        return self.name + ("" if self.signal else ".") + member

    def _names(self, member: str) -> list[str]:
        base = self._member(member)
        return [base] if self.size is None else [f"{base}[{i + 1}]" for i in range(self.size)]

    def input_names(self) -> list[str]:
        """Names of the scalar inputs u, e.g. `terminal.v[1]`."""
        return self._names(self.domain.word(self.given))

    def input_starts(self) -> tuple[float, ...]:
        """Values of the scalar inputs before anyone sets them; DeclarationError if they do not fit the size of the port."""
        return _values(self.name, "start", self.start, self.n)

    def output_names(self, suffix: str = "") -> list[str]:
        """Names of the scalar outputs y, e.g. `terminal.i[1]` or with suffix `_step`."""
        return self._names(self.domain.word(conjugate(self.given)) + suffix)

    def _indexed(self, member: str, n: int) -> list[list[str]]:
        """Per pair n names: the second index, of a scalar port the only one, counts them."""
        base, places = self._member(member), range(1, n + 1)
        if self.size is None:
            return [[f"{base}[{i}]" for i in places]]
        return [[f"{base}[{j + 1},{i}]" for i in places] for j in range(self.size)]

    def node_input_names(self, k: int) -> list[list[str]]:
        """Per pair the names of its input at the k nodes of a step, e.g. `terminal.v_node[1,2]`, `shaft.torque_node[2]`."""
        return self._indexed(self.domain.word(self.given) + "_node", k)

    def node_output_names(self, k: int) -> list[list[str]]:
        """Per pair the names of its output at the k nodes of a step, e.g. `terminal.i_node[1,2]`."""
        return self._indexed(self.domain.word(conjugate(self.given)) + "_node", k)

    def impulse_names(self) -> list[list[str]]:
        """Per pair the names of its impulses at both ends of a step: `terminal.v_impulse[1,2]`, `shaft.torque_impulse[1]`."""
        return self._indexed(self.domain.word(self.given) + "_impulse", 2)

    @property
    def input_unit(self) -> str:
        return self.domain.unit(self.given)

    @property
    def output_unit(self) -> str:
        return self.domain.unit(conjugate(self.given))


def drive(name: str, *, description: str = "work of a moving constraint", owner: str = "") -> Port:
    """The port at which the work of constraints g(q, t) = 0 is booked: the rate of time is 1, the effort is the power."""
    return Port(name, DRIVE, "flow", {}, source=1.0, description=description, owner=owner)
