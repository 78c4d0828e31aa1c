"""Hard contacts on a line: an end stop between two flanges, a body with a bumper, two bodies that hit each other."""

from __future__ import annotations

from phfmu import (
    PHDAE,
    TRANSLATIONAL,
    Guard,
    Jump,
    Port,
    StateEvent,
    Switch,
    algebraic,
    energy,
    parameter,
    skew,
    state,
)


def end_stop(gap: float = 1.0, *, nominal: float = 1.0, v: float = 1.0, f: float = 1.0) -> PHDAE:
    """Hard stop between two flanges, without mass: b stays on its side of a.

        gap' = v_b - v_a,   0 <= gap,  0 <= F,  F gap = 0,   F_b = -F,  F_a = F   (forces on the stop)

    Where the gap closes, v_b - v_a jumps to 0 and what that loses is booked, dv^2/(2 (1/m_a + 1/m_b)); it opens where the
    contact force F falls to zero.  A flange that is not joined is fixed.

    H:  0;  states: gap [m];  algebraic: F [N]
    ports:  a, b: velocities given, forces out
    modes:  touches: 1 or 0
    `gap`: at the start;  typical values: `nominal` [m] of the gap, `v` [m/s], `f` [N].
    Source: Brogliato, Nonsmooth Mechanics (2016): Signorini's condition, plastic impact.
    """
    distance = state("gap", unit="m", start=gap, nominal=nominal, description="from a to b")
    force = algebraic("F", unit="N", nominal=f, description="contact force")
    mode = parameter("touches", 0.0, min=0.0, max=1.0, description="1 touches, 0 apart")
    a = Port("a", TRANSLATIONAL, "flow", {distance: -1.0}, nominal=v, description="left flange")
    b = Port("b", TRANSLATIONAL, "flow", {distance: 1.0}, nominal=v, description="right flange")
    contact = Switch("contact", force, {a: -1.0, b: 1.0}, mode, gap=distance.sx, nominal=nominal, unit="m")
    return PHDAE(
        "end_stop",
        states=(distance,),
        algebraics=(force,),
        parameters=(mode,),
        ports=(a, b),
        switches=(contact,),
        description="hard stop between two flanges",
    )


def bumper(
    m: float = 1.0, *, e: float = 0.5, gap: float = 1.0, v: float = 0.0, nominal: float = 1.0, f: float = 1.0
) -> PHDAE:
    """Body with a bumper before a wall that throws it back with e times its speed, or holds it.

        H = 1/2 m v^2,   q' = v,   m v' = s F;   at q = 0:  v+ = -e v-,  lost (1 - e^2) m v-^2/2

    Impacts that follow each other within 1e-6 of the step end at rest (s = 0), until the force F pulls away from the wall.

    States:      q [m], from the wall; v [m/s]
    Ports:       flange (force given, velocity out)
    Parameters:  m [kg], e (restitution, 0 to 1)
    Modes:       free: s, 1 before the wall, 0 at rest on it
    `gap` [m], `v` [m/s]: at the start;  `nominal` [m], `f` [N]: typical distance and force.
    Source: Newton's law of restitution.
    """
    q = state("q", unit="m", start=gap, nominal=nominal, description="distance from the wall")
    speed = state("v", unit="m/s", start=v, description="velocity, away from the wall")
    mass = parameter("m", m, unit="kg", positive=True, description="mass")
    es = parameter("e", e, min=0.0, max=1.0, description="restitution")
    free = parameter("free", 1.0, min=0.0, max=1.0, description="1 before the wall, 0 at rest on it")
    flange = Port("flange", TRANSLATIONAL, "effort", {speed: free.sx}, nominal=f, description="force on the body")
    hits = Guard("hits", q, -1, nominal, "m")
    leaves = Guard("leaves", flange.u, 1, f, "N")
    return PHDAE(
        "bumper",
        states=(q, speed),
        parameters=(mass, es, free),
        energies=(energy(0.5 * mass * speed.sx**2),),
        E={speed: mass},
        structure=(skew(q, speed, 1.0),),
        ports=(flange,),
        state_events=(
            StateEvent(hits, when={"free": 1.0}, jump=Jump({speed: 1.0}, es, law="unilateral"), rest={"free": 0.0}),
            StateEvent(leaves, when={"free": 0.0}, sets={"free": 1.0}),
        ),
        description="body with a bumper before a wall",
    )


def impact_pair(
    m_a: float = 1.0, m_b: float = 1.0, *, e: float = 0.5, gap: float = 1.0, v_a: float = 0.0, v_b: float = 0.0,
    nominal: float = 1.0, f: float = 1.0,
) -> PHDAE:  # fmt: skip
    """Two bodies, b on the far side of a, that throw each other back, or go on as one.

        H = 1/2 m_a v_a^2 + 1/2 m_b v_b^2,   gap' = v_b - v_a,   apart (s = 1):  m_a v_a' = F_a,  m_b v_b' = F_b,
        together (s = 0):  v_a' = v_b' = (F_a + F_b)/(m_a + m_b)
        at gap = 0:  (v_b - v_a)+ = -e (v_b - v_a)-,  lost (1 - e^2)/2 m_a m_b/(m_a + m_b) (v_b - v_a)-^2

    Impacts that follow each other within 1e-6 of the step end together, until the force between them,
    N = (m_b F_a - m_a F_b)/(m_a + m_b), falls to zero.  The sum of the momenta jumps by nothing.

    States:      gap [m]; v_a, v_b [m/s]
    Ports:       a, b (force given, velocity out)
    Parameters:  m_a, m_b [kg], e (restitution, 0 to 1)
    Modes:       apart: s, 1 or 0
    `gap`, `v_a`, `v_b`: at the start;  `nominal` [m], `f` [N]: typical distance and force.
    Source: Newton's law of restitution; Brogliato, Nonsmooth Mechanics (2016), section 1.3.
    """
    distance = state("gap", unit="m", start=gap, nominal=nominal, description="from a to b")
    a, b = (state(n, unit="m/s", start=v, description="velocity") for n, v in (("v_a", v_a), ("v_b", v_b)))
    mass_a, mass_b = (
        parameter(n, m, unit="kg", positive=True, description="mass") for n, m in (("m_a", m_a), ("m_b", m_b))
    )
    es = parameter("e", e, min=0.0, max=1.0, description="restitution")
    apart = parameter("apart", 1.0, min=0.0, max=1.0, description="1 apart, 0 together")
    part_a, part_b = mass_a / (mass_a + mass_b), mass_b / (mass_a + mass_b)
    own, joint = apart.sx, 1 - apart.sx
    flange_a = Port("a", TRANSLATIONAL, "effort", {a: own + joint * part_a, b: joint * part_b}, nominal=f)
    flange_b = Port("b", TRANSLATIONAL, "effort", {a: joint * part_a, b: own + joint * part_b}, nominal=f)
    hits = Guard("hits", distance, -1, nominal, "m")
    parts = Guard("parts", part_b * flange_a.u - part_a * flange_b.u, -1, f, "N")
    thrown = Jump({a: -1.0, b: 1.0}, es, law="unilateral")
    return PHDAE(
        "impact_pair",
        states=(distance, a, b),
        parameters=(mass_a, mass_b, es, apart),
        energies=(energy(0.5 * mass_a * a.sx**2), energy(0.5 * mass_b * b.sx**2)),
        E={a: mass_a, b: mass_b},
        structure=(skew(distance, a, -1.0), skew(distance, b, 1.0)),
        ports=(flange_a, flange_b),
        state_events=(
            StateEvent(hits, when={"apart": 1.0}, jump=thrown, rest={"apart": 0.0}),
            StateEvent(parts, when={"apart": 0.0}, sets={"apart": 1.0}),
        ),
        description="two bodies that hit each other",
    )
