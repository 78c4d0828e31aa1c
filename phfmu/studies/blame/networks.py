"""Seeded networks of 2 to 8 members: trees of stores that are joined by springs, shafts, inductances and motors.

Stores (mass, rotor, capacitor) give each junction its value and lose energy; links (spring, shaft, inductance) take two of them.
A motor takes a voltage and has a rotor, so that it joins an electrical part to a rotating one.  In most networks a source, whose
work is booked, drives one store with a sine.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace
from typing import Any

import casadi as ca
import numpy as np

from phfmu.declare.phdae import PHDAE
from phfmu.declare.port import Port
from phfmu.declare.variable import parameter, time
from phfmu.network.couplings import coupling_table
from phfmu.network.network import Network

#: kinds of networks, by the kinds of their stores
KINDS = {"electrical": ("C",), "translational": ("m",), "rotational": ("J",), "mixed": ("C", "J")}
COUPLINGS = ("jacobi", "gauss-seidel", "newton", "anderson")
#: step sizes (s) by whether the coupling repeats steps, where members swing at about 1 rad/s
STEP_SIZES = {False: (0.05, 0.06, 0.08), True: (0.06, 0.1, 0.2)}
STEPS = 400


@dataclass(frozen=True)
class RandomNetwork:
    """A network with its coupling and step [s].

    unconverged:  what is done with steps that do not converge;  booked:  members that keep books;  driven:  the one with a
    source, or "";  dampers:  by member a parameter that is a damper
    """

    network: Network
    kind: str
    coupling: str
    unconverged: str
    step: float
    booked: frozenset[str]
    driven: str
    dampers: dict[str, str]

    def ports(self, member: str) -> list[str]:
        """Its free ports, `member.port`, in the order of its inputs."""
        declared = self.network.declared[member]
        return [f"{member}.{p.name}" for p in declared.ports if p.external]


def draw(rng: np.random.Generator, n: int, kind: str, coupling: str) -> RandomNetwork:
    """A network of n members of a kind; each keeps books or not at even odds, the driven one does."""
    return _GrowingTree(rng, KINDS[kind]).grown(n, kind, coupling)


class _GrowingTree:
    """A tree under construction: `values`: junction -> ends;  parameters around 1, so that links swing at about 1 rad/s."""

    def __init__(self, rng: np.random.Generator, kinds: tuple[str, ...]):
        self._rng, self._kinds = rng, kinds
        self._net, self._ends, self._of = Network("drawn"), dict[str, list[str]](), dict[str, str]()
        self._dampers: dict[str, str] = {}
        self._members: dict[str, PHDAE] = {}

    def _about(self, middle: float = 1.0, spread: float = 2.0) -> float:
        return float(middle * spread ** self._rng.uniform(-1.0, 1.0))

    def grown(self, n: int, kind: str, coupling: str) -> RandomNetwork:
        rng = self._rng
        self._store(str(rng.choice(self._kinds)))
        while len(self._members) < n:
            self._grow(n - len(self._members))
        stores = [e[0].split(".")[0] for e in self._ends.values()]
        driven = str(rng.choice(stores)) if rng.random() < 0.8 else ""
        if driven:
            self._members[driven] = _driven(self._members[driven], float(rng.uniform(0.4, 1.6)))
        for name, member in self._members.items():
            self._net.add(name, replace(member, name=name))
        for name, ends in self._ends.items():
            self._net.junction(name, ends)
        booked = frozenset(m for m in self._members if m == driven or rng.random() < 0.5)
        repeats = coupling_table.COUPLINGS[coupling].kind.repeats
        step = float(rng.choice(STEP_SIZES[repeats]))
        unconverged = "accept" if repeats and rng.random() < 0.25 else "raise"
        return RandomNetwork(self._net, kind, coupling, unconverged, step, booked, driven, self._dampers)

    def _add(self, letter: str, member: PHDAE, damper: str = "") -> str:
        name = f"{letter}{sum(m[0] == letter for m in self._members) + 1}"
        self._members[name] = member
        if damper:
            self._dampers[name] = damper
        return name

    def _store(self, kind: str) -> str:
        """A store with a junction of its own; the junction's name."""
        from phfmu.components.electrical.branches import rc_node
        from phfmu.components.mechanical.rotational import rotational_inertia
        from phfmu.components.mechanical.translational import mass

        size, loss, start = self._about(), self._about(0.2), float(self._rng.uniform(-1.0, 1.0))
        if kind == "C":
            name, port = self._add("C", rc_node(1.0 / loss, size, v0=start), "R"), "terminal"
        elif kind == "m":
            name, port = self._add("m", mass(size, d=loss, v=start), "d"), "flange"
        else:
            name, port = self._add("J", rotational_inertia(size, d=loss, speed=start), "d"), "a"
        return self._junction(name, port, kind)

    def _junction(self, name: str, port: str, kind: str) -> str:
        junction = f"at_{name}"
        self._ends[junction], self._of[junction] = [f"{name}.{port}"], kind
        return junction

    def _grow(self, left: int) -> None:
        """One more link, with a new store at its other end where there is room for it; a motor brings its own."""
        from phfmu.components.electrical.branches import rl_link
        from phfmu.components.electrical.machines.dc_motor import dc_motor
        from phfmu.components.mechanical.rotational import flexible_shaft
        from phfmu.components.mechanical.translational import spring

        rng = self._rng
        here = str(rng.choice(list(self._ends)))
        kind = self._of[here]
        if kind == "C" and "J" in self._kinds and rng.random() < 0.7:
            motor = dc_motor(L=self._about(), R=self._about(0.2), J=self._about(), k=self._about(), d=self._about(0.2))
            name = self._add("M", motor, str(rng.choice(["R", "d"])))
            self._ends[here].append(f"{name}.terminal")
            if left > 1:  # a rotor alone has a free end
                self._junction(name, "shaft", "J")
                self._link(flexible_shaft(self._about(), d=0.0), "S", f"at_{name}", left - 1)
            return
        made: dict[str, tuple[str, Callable[[], PHDAE]]] = {
            "C": ("L", lambda: rl_link(self._about(0.2), self._about())),
            "m": ("k", lambda: spring(self._about(), elongation=float(rng.uniform(-0.5, 0.5)))),
            "J": ("S", lambda: flexible_shaft(self._about(), d=0.0)),
        }
        letter, make = made[kind]
        self._link(make(), letter, here, left, "R" if kind == "C" else "")

    def _link(self, member: PHDAE, letter: str, here: str, left: int, damper: str = "") -> None:
        name = self._add(letter, member, damper)
        self._ends[here].append(f"{name}.a")
        if left > 1:
            self._ends[self._store(self._of[here])].append(f"{name}.b")


def _driven(member: PHDAE, frequency: float) -> PHDAE:
    """The member with a sine at the port of its own, whose work is booked; frequency [rad/s]."""
    port = member.ports[0]
    w = parameter("drive.w", frequency, unit="rad/s")
    source = Port("drive", port.domain, port.given, port.on, source=ca.SX(ca.sin(w.sx * time)))
    return replace(member, parameters=(*member.parameters, w), ports=(*member.ports, source))


def members(drawn: RandomNetwork) -> dict[str, Any]:
    """Members of the network that engines step; a member without books takes four steps of its own in each."""
    from phfmu.discretise.model import build_model
    from phfmu.engine.native.native import NativeInstance
    from phfmu.network.members.engine_member import EngineMember
    from phfmu.schemes.collocated import Collocated

    made = {}
    for name, d in drawn.network.declared.items():
        model = build_model(d, Collocated(1))
        made[name] = EngineMember(name, model, NativeInstance(model), 1 if name in drawn.booked else 4)
    return made
