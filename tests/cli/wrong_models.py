"""A file of models, most of them wrong."""

from __future__ import annotations

MODELS = """
from phfmu import ELECTRICAL, PHDAE, Event, Network, Port, Scene, block, energy, state
from phfmu.components.electrical.rl_line import rl_line
from phfmu.components.electrical.sources import voltage_source
from phfmu.components.mechanical.translational import mass, spring

def two(a, b, *bond, **options):
    net = Network("net")
    net.add("a", a)
    net.add("b", b)
    if bond:
        net.connect(*bond, **options)
    return net
def at_junction(net, *ports, **options):
    net.junction("joint", ports, **options)
    return net
def units(): return two(mass(), voltage_source(1.0), "a.flange", "b.terminal")
def sign(): return two(mass(), spring(), "a.flange", "b.a", signs=(1, 1))
def efforts(): return two(mass(), mass(), "a.flange", "b.flange")
def sizes(): return two(rl_line(1.0, 1.0), voltage_source(1.0), "a.a", "b.terminal")
def no_port(): return two(mass(), spring(), "a.flang", "b.a")
def again(): return two(mass(), spring(), "a.flange", "b.a").connect("a.flange", "b.b")
def umlaut(): return Network("net").add("größe", mass())
def nothing(): return Network("net")
def line(c): return rl_line(1.0, 0.1, i=(1.0, -0.5, c))
def currents(): return at_junction(two(line(-0.5), line(-0.4)), "a.b", "b.a")
def rigid(): return at_junction(two(mass(v=0.3), mass()), "a.flange", "b.flange", kind="1")
def unsolvable():  # x' = x^2 u leaves every bound at t = 1
    x = state("x", unit="C", start=1.0)
    port = Port("feed", ELECTRICAL, "flow", {x: x.sx**2}, start=1.0)
    return PHDAE("unsolvable", states=(x,), energies=(energy(0.5 * x.sx**2),), ports=(port,))
def broken():
    x, y = state("x"), state("y", unit="banana")
    return PHDAE("broken", states=(x, y), energies=(energy(0.5 * x.sx**2),), dissipation=(block([x], -1.0),))
def late(name, value=1.0): return Scene("late", mass(), 1e9, 0.1, events=(Event(9e8, name, value),))
def bad_event(): return late("flange.forc")
def state_event(): return late("q")
def nan_event(): return late("m", float("nan"))
def divides(): return 1 / 0
def misses(): return {}["key"]
def leaves(): raise SystemExit(0)
def number(): return 3
def needs(a): return a
def charged():
    from phfmu.components.electrical.rlc_load import rlc_load
    both = two(rlc_load(C=1e-3, v=(10.0, -5.0, -5.0)), rlc_load(C=1e-3, v=(5.0, -2.5, -2.5)))
    return at_junction(both, "a.terminal", "b.terminal")
def itself():
    net = Network("net")
    net.add("s", spring())
    return net.connect("s.a", "s.a")
"""
