"""Ideal switches: rows that are there in one mode and not in the other.

    on:   0 = c,            c = on^T z,     and on * mu acts on the rows of the variables it stands on
    off:  0 = mu

Neither mode takes power, mu c = 0.  A unilateral switch obeys 0 <= c, 0 <= mu, mu c = 0 (ideal diode, contact): it opens where mu
falls to zero and closes where c does.  A free one stays as it is until its mode is set.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable, Mapping
from dataclasses import dataclass, field, replace
from typing import TYPE_CHECKING, Any

import casadi as ca

from phfmu.declare.error import DeclarationError
from phfmu.declare.event import Guard, Jump, Law, StateEvent
from phfmu.declare.variable import Variable, VariableKind, _sx

if TYPE_CHECKING:
    from phfmu.declare.port import Port


@dataclass(frozen=True, eq=False)
class Switch:
    """One ideal switch.

    multiplier: its algebraic variable mu (1): the current of a diode, the force of a contact
    on:         variable or port -> column (len x 1):  c = on^T z, of ports their inputs; -1 at the anode and 1 at the cathode
                of a diode, so that c is the voltage it blocks and mu enters at the anode
    mode:       parameter (1) that is 1 while it is on and 0 while it is off; its value is the start
    law:        "unilateral" or "free"
    when:       scalar parameter -> value: a unilateral switch closes only while all have these values (gate of a thyristor)
    gap:        function whose rate is c, of a contact: off, it closes where this falls to zero, and c jumps to 0; None: where
                c does
    restitution: e in [0, 1], a number or an expression of parameters, of a contact with a gap that stands on states: where the
                gap closes c+ = -e c- and it stays off; it is on where it comes to rest (`StateEvent.rest`).  0: on at once
    most:       the largest |mu| that being opened may cut where states must jump for it (chopping current); more is refused
    nominal:    typical magnitude of c;  unit: of c, or of the gap
    owner:      member that what jumps lose is booked at
    """

    name: str
    multiplier: Variable
    on: Mapping[Variable | Port, Any]
    mode: Variable
    law: Law = "unilateral"
    when: Mapping[str, float] = field(default_factory=dict)
    gap: Any = None
    restitution: Any = 0.0
    most: float = 0.0
    nominal: float = 1.0
    unit: str = "1"
    owner: str = ""

    @property
    def mode_name(self) -> str:
        """The scalar parameter that is its mode."""
        return self.mode.names()[0]

    @property
    def unilateral(self) -> bool:
        """It opens and closes by itself."""
        return self.law == "unilateral"

    @property
    def scale(self) -> float:
        """c over mu, from what is typical of both."""
        return self.nominal / self.multiplier.nominal[0]

    def rate(self, effort: Callable[[Variable | Port], ca.SX]) -> ca.SX:
        """c; `effort`: costate of what it stands on."""
        return sum((ca.dot(ca.SX(_sx(column)), effort(v)) for v, column in self.on.items()), ca.SX(0))

    def events(self, effort: Callable[[Variable | Port], ca.SX]) -> tuple[StateEvent, ...]:
        """The events at which a unilateral switch opens and closes."""
        if not self.unilateral:
            return ()
        mu, mode = self.multiplier, self.mode_name
        c = self.rate(effort) if self.gap is None else ca.SX(_sx(self.gap))
        opens = Guard(f"{self.name}.opens", mu.sx, -1, mu.nominal[0], mu.unit)
        closes = Guard(f"{self.name}.closes", c, -1, self.nominal, self.unit)
        met, on = {mode: 0.0, **self.when}, {mode: 1.0}
        comes = (
            StateEvent(closes, when=met, jump=self._throws(), rest=on) if self.bounces else StateEvent(closes, met, on)
        )
        return StateEvent(opens, when={mode: 1.0}, sets={mode: 0.0}), comes

    @property
    def bounces(self) -> bool:
        """Whether it has a restitution."""
        return not ca.SX(_sx(self.restitution)).is_zero()

    def _throws(self) -> Jump:
        """The jump where its gap closes; DeclarationError where no impulse acts along its column."""
        ports = [v.name for v in self.on if not isinstance(v, Variable) or v.kind is not VariableKind.STATE]
        if not ports and self.gap is not None:
            on = {v: column for v, column in self.on.items() if isinstance(v, Variable)}
            return Jump(on, self.restitution, owner=self.owner, law="unilateral")
        what = f"it stands on {', '.join(ports)}, on which no impulse acts" if ports else "it has no gap that closes"
        remedy = (
            "let it stand on the states of the bodies, in one declaration with them, or" if ports else "give `gap`, or"
        )
        raise DeclarationError(
            f"switch '{self.name}'", f"has a restitution, but {what}", f"{remedy} leave it out", "switch"
        )


def renamed_switches(
    switches: Iterable[Switch], new: Mapping[str, str], image: Callable[[Any], Any]
) -> tuple[Switch, ...]:
    """The switches on the images of their variables and ports; `new`: old -> new names of scalar parameters."""
    return tuple(
        replace(
            s,
            multiplier=image(s.multiplier),
            mode=image(s.mode),
            on={image(v): m for v, m in s.on.items()},
            when={new.get(n, n): value for n, value in s.when.items()},
        )
        for s in switches
    )
