"""Landing, jumps and their refusals in C under sanitizers: nothing is read or written outside its memory, nothing overflows."""

from __future__ import annotations

from pathlib import Path

import pytest

from tests.sanitized import output

#: each part prints a word when it is done
CODE = """
from dataclasses import replace
import numpy as np
from phfmu import PHDAE, Collocated, Guard, Jump, Monolithic, NativeInstance, Options, StateEvent
from phfmu import build_model, energy, run, skew, state
from phfmu.components.library import build
from phfmu.components.mechanical.chain import chain
from phfmu.components.mechanical.multibody import Multibody
from phfmu.outcome.status import EventRefused
from phfmu.engine.switched import stepped

def done(model, stop, h, events=(), word=""):
    result = run(Monolithic(model, stepped(model, NativeInstance)), Options(stop=stop, step=h, events=events))
    found = result.ledger.summary()
    assert found.closed and found.events["state"] >= 1, found
    print(word)

# deflated guards, bounces without end, rest; adaptive; saved states and steps told as one
ball = build_model(build("bouncing_ball").declaration(), Collocated(3))
done(ball, 5.0, 0.02, word="ball")
run(Monolithic(ball, NativeInstance(ball)), Options(stop=2.0, step=0.02, rtol=1e-6))
one = NativeInstance(ball)
kept = one.get_state()
for _ in range(2):
    one.set_state(kept)
    for i in range(4):
        one.do_step(0.5 * i, 0.5)
    print("told", len(one.happened) > 0)

# jumps with constraints, one of them redundant
links = chain(3, dim=2, speed=0.0, last=3.0)
v = links.states[1]
hit = StateEvent(Guard("wall", links.states[0].sx[4] - 2.2, -1, unit="m"), jump=Jump({v: [0, 0, 0, 0, 1.0, 0]}, 0.6))
done(build_model(replace(links, state_events=(hit,))), 0.7, 0.01, word="chain")
body = Multibody("square", 2)
body.gravity([0.0, -9.81])
points = ([0.0, 1.0], [1.0, 1.2], [1.0, 2.2], [0.0, 2.0])
corners = [body.particle(m, q, [0.0, 0.0]) for m, q in zip((1.0, 2.0, 1.5, 0.5), points)]
for i, j in ((0, 1), (1, 2), (2, 3), (3, 0), (0, 2), (1, 3)):
    body.bar(corners[i], corners[j])
square = body.build()
hit = StateEvent(Guard("floor", square.states[0].sx[1], -1, unit="m"), jump=Jump({square.states[1]: [0, 1.0] + 6 * [0]}, 0.5))
done(build_model(replace(square, state_events=(hit,))), 0.5, 0.02, word="square")

# contacts that push, of which one lets go; grips that would gain; a limit; a pile without rest; guards that chase each other
y, phi, p, spin = (state(n) for n in ("y", "phi", "p", "L"))
y = replace(y, start=(0.7,))
def beam(law, e=(0.9, 0.0), **more):
    feet = tuple(StateEvent(Guard(f"foot{a}", y + a * phi, -1), jump=Jump({p: 1.0, spin: a}, x, law=law, **more))
                 for a, x in zip((-0.5, 0.5), e))
    return PHDAE("beam", states=(y, phi, p, spin), energies=(energy(p**2 / 4), energy(spin**2 / 4), energy(19.62 * y)),
                 structure=(skew(y, p, 1.0), skew(phi, spin, 1.0)), state_events=feet)
done(build_model(beam("unilateral", (0.9, 0.3))), 0.65, 0.01, word="beam")
for refused in (beam("free"), beam("unilateral", most=1.0), beam("unilateral", (0.3, 0.3))):
    instance = NativeInstance(build_model(refused))
    try:
        list(instance.land(0.0, 0.05, 60))
    except EventRefused as failure:
        print("refused", failure.reason)

# poles at their zeros, chopped; a relay; modes of switches
for name in ("breaker_opening", "two_point_control", "buffer", "rectifier", "hard_stop"):
    scene = build(name)
    done(build_model(scene.declaration(), Collocated(2)), scene.stop, scene.step, scene.events, name)
"""


@pytest.mark.slow
def test_nothing_is_out_of_bounds(tmp_path: Path) -> None:
    done = " ".join(output(CODE, tmp_path))
    assert done == (
        "ball told True told True chain square beam refused 2 refused 1 refused 5 "
        "breaker_opening two_point_control buffer rectifier hard_stop"
    )
