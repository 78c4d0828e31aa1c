"""Bodies on springs that meet a wall, or another body."""

from __future__ import annotations

from phfmu import Event, Network, Scene
from phfmu.components.mechanical.contacts import bumper, end_stop
from phfmu.components.mechanical.translational import mass, spring

#: mass (kg), stiffness (N/m), gap at the start (m), preload (m), when and how fast the spring is pulled back (s, m/s)
M, K, START, PRELOAD, PULLED, SPEED = 2.0, 200.0, 0.1, 0.05, 1.0, 0.1


def buffer(e: float = 0.5) -> Scene:
    """A body of 2 kg on a spring of 200 N/m bounces on its bumper, rests, and leaves when the spring is pulled back.

    Between impacts q + 0.05 m = A cos(w t + phi), w = sqrt(k/m) = 10/s.  At rest the spring presses with 10 N; its other end
    moves by 0.1 m/s from 1 s on, so that the body leaves the wall at 1.5 s, q = 0.1 m/s (t - sin(w t)/w).
    `e` [1]: restitution of its impacts
    """
    net = Network("buffer", description="body on a spring with a bumper: impacts, rest, release")
    net.add("body", bumper(M, e=e, gap=START, nominal=START, f=K * START))
    net.add("spring", spring(K, elongation=START + PRELOAD))
    net.connect("body.flange", "spring.b", name="joint")
    pulled = Event(PULLED, "spring.a.velocity", SPEED)
    return Scene("buffer", net, stop=2.0, step=0.01, events=(pulled,), shown=("body.q", "body.v", "spring.a.force"))


def hard_stop() -> Scene:
    """A wagon of 2 kg on a spring of 200 N/m runs onto one of 1 kg, pushes it, and lets it go where the spring is at rest.

    The impact loses m1 m2/(2 (m1 + m2)) v^2.  Together they swing with sqrt(k/(m1 + m2)) until the force between them, that of
    the spring times m2/(m1 + m2), falls to zero.
    """
    net = Network("hard_stop", description="a wagon on a spring runs onto another, pushes it, lets it go")
    net.add("wagon", mass(M))
    net.add("spring", spring(K, elongation=-START - PRELOAD))
    net.add("stop", end_stop(START, nominal=START, f=K * START))
    net.add("other", mass(M / 2))
    net.junction("left", ["wagon.flange", "spring.b", "stop.a"])
    net.connect("other.flange", "stop.b", name="right")
    return Scene("hard_stop", net, stop=0.5, step=0.01, shown=("wagon.q", "other.q", "wagon.v", "other.v"))
