"""A ball that bounces on the floor."""

from __future__ import annotations

from phfmu import PHDAE, Guard, Jump, Scene, StateEvent, energy, observable, parameter, skew, state


def bouncing_ball(m: float = 1.0, *, e: float = 0.8, height: float = 1.0, g: float = 9.81) -> Scene:
    """A ball that falls from `height` and is thrown back with e times its speed, until it rests.

        H = p^2/(2 m) + m g q,   q' = flight p/m,   p' = -flight m g;   at q = 0:  p+ = -e p-,  lost (1 - e^2) p-^2/(2 m)

    The bounces end at t = sqrt(2 height/g) (1 + e)/(1 - e).  Where they follow each other within 1e-6 of the step, the ball
    comes to rest: e = 0 and flight = 0.

    `height` [m]: at the start
    States:      q [m] (height of its lowest point), p [kg.m/s]
    Parameters:  m [kg], g [m/s2], e [1] (restitution, 0 to 1), flight (mode: 1 in flight, 0 at rest)
    """
    q = state("q", unit="m", start=height, description="height")
    p = state("p", unit="kg.m/s", description="momentum")
    ms, gs = parameter("m", m, unit="kg"), parameter("g", g, unit="m/s2", positive=True)
    es = parameter("e", e, min=0.0, max=1.0, description="restitution")
    flight = parameter("flight", 1.0, min=0.0, max=1.0, description="1 in flight, 0 at rest on the floor")
    ball = PHDAE(
        "bouncing_ball",
        states=(q, p),
        parameters=(ms, gs, es, flight),
        energies=(energy(p**2 / (2 * ms)), energy(ms * gs * q)),
        structure=(skew(q, p, flight),),
        observables=(observable("v", p.z, unit="m/s", description="velocity"),),
        state_events=(
            StateEvent(
                Guard("floor", q, -1, unit="m"),
                when={"flight": 1.0},
                jump=Jump({p: 1.0}, es, law="unilateral"),
                rest={"flight": 0.0},
            ),
        ),
        description="ball on a hard floor",
    )
    return Scene("bouncing_ball", ball, stop=5.0, step=0.02, shown=("q", "v"))
