"""Contacts that push only: impulses of one sign, unequal restitutions; against all sets of contacts, and closed forms."""

from __future__ import annotations

from itertools import product

import numpy as np
import pytest

from phfmu import (
    PHDAE,
    Collocated,
    Guard,
    Jump,
    Monolithic,
    NativeInstance,
    Options,
    StateEvent,
    build_model,
    check,
    energy,
    run,
    skew,
    state,
)
from phfmu.events.impulse import impulses, pushing
from phfmu.outcome.limits import LIMITS
from phfmu.outcome.status import EventRefused

M, A, G, HEIGHT = 2.0, 0.5, 9.81, 0.7


def beam(inertia: float, e: tuple[float, float], law: str = "unilateral") -> PHDAE:
    """A beam of mass M that falls flat on two feet, A to the left and right of its centre, restitution e each.

    Turned by little: a foot is at y -+ A phi.
    """
    y, phi = state("y", unit="m", start=HEIGHT), state("phi", unit="rad")
    p, spin = state("p", unit="kg.m/s"), state("L", unit="kg.m2/s")
    feet = tuple(
        StateEvent(Guard(name, y + arm * phi, -1, unit="m"), jump=Jump({p: 1.0, spin: arm}, each, law=law))
        for name, arm, each in (("left", -A, e[0]), ("right", A, e[1]))
    )
    return PHDAE(
        "beam",
        states=(y, phi, p, spin),
        energies=(energy(p**2 / (2 * M)), energy(spin**2 / (2 * inertia)), energy(M * G * y)),
        structure=(skew(y, p, 1.0), skew(phi, spin, 1.0)),
        state_events=feet,
    )


def first(declaration: PHDAE):
    """The first event, p and L after it."""
    instance = NativeInstance(build_model(declaration, Collocated(2)))
    for part in instance.land(0.0, 0.05, 10, record=("x",)):
        if part.happened is not None:
            return part.happened, part.happened.signals[2:4]
    raise AssertionError("no event")


@pytest.mark.parametrize(
    ("inertia", "e"),
    [
        (M * A**2 / 3, (0.9, 0.2)),  # a rod: each foot throws the other down, both push
        (
            4 * M * A**2,
            (0.9, 0.0),
        ),  # weights beyond the feet: the left one lifts the right one, which would have to pull
        (4 * M * A**2, (0.0, 1.0)),
    ],
)
def test_feet_of_unequal_restitution(inertia, e):
    """lost = 1/2 sum m_j (1 - e_j) |c_j-|, m of the feet that push by hand; the loss is what the energy misses."""
    happened, (p, spin) = first(beam(inertia, e))
    v = np.sqrt(2 * G * HEIGHT)
    own, other = 1 / M + A**2 / inertia, 1 / M - A**2 / inertia
    both = (v / (own**2 - other**2)) * np.array(
        [own * (1 + e[0]) - other * (1 + e[1]), own * (1 + e[1]) - other * (1 + e[0])]
    )
    if (both < 0).any():  # one foot alone
        alone = np.where(both < 0, 0.0, (1 + np.array(e)) * v / own)
        assert alone.max() * other >= (1 + np.array(e))[both < 0][0] * v, "which throws the other one up by itself"
        both = alone
    assert happened.events == (0, 1)
    assert [p, spin] == pytest.approx([both.sum() - M * v, A * (both[1] - both[0])], rel=1e-12)
    lost = 0.5 * both @ (1 - np.array(e)) * v
    assert happened.lost.sum() == pytest.approx(lost, rel=1e-12) and (happened.lost >= 0).all()
    assert happened.energy.sum() == -happened.lost.sum()
    assert p**2 / (2 * M) + spin**2 / (2 * inertia) == pytest.approx(M * v**2 / 2 - lost, rel=1e-13)


def test_a_grip_of_both_would_make_energy_and_is_refused():
    with pytest.raises(EventRefused, match="gain .* J: their restitutions differ.*unilateral"):
        first(beam(4 * M * A**2, (0.9, 0.0), "free"))


def test_the_ledger_closes_over_many_of_them():
    model = build_model(beam(4 * M * A**2, (0.9, 0.3)), Collocated(2))
    found = run(Monolithic(model, NativeInstance(model)), Options(stop=0.65, step=0.01)).ledger.summary()
    assert found.closed and found.events["state"] >= 2


def test_a_law_that_is_none_is_told():
    problems = check(beam(1.0, (0.5, 0.5), "unilaterall"))
    (found,) = [p for p in problems if p.rule == "state-event" and "left" in p.entry]
    assert "no law" in found.reason and "unilateral" in found.remedy


def random_problem(rng: np.random.Generator):
    """S of some contacts, grips that hold already and constraints, c-, e, which push."""
    n, held = int(rng.integers(1, 6)), int(rng.integers(0, 3))
    L = rng.normal(size=(n + held + 2, n + held)) * rng.choice([1.0, 1e-3, 30.0], n + held)
    S = L.T @ L
    pushes = rng.random(n) < 0.8
    c = np.concatenate([np.where(pushes, -rng.random(n), 0.0), np.zeros(held)])
    c *= np.sqrt(S.diagonal())
    e = np.concatenate([np.where(pushes, rng.random(n), 0.0), np.zeros(held)])
    return S, c, e, pushes


def test_contacts_that_push_are_the_one_set_that_obeys():
    """400 random problems: m >= 0, c+ + e c- >= 0, one of them zero, as the one of all sets that does; no gain of energy."""
    rng, alone = np.random.default_rng(3), 0
    for _ in range(400):
        S, c, e, pushes = random_problem(rng)
        n, goal = len(pushes), -(1 + e) * c
        acts = pushing(S, goal, pushes, LIMITS["JUMP_DEPENDENT"], LIMITS["PUSH_ROUNDING"], int(LIMITS["MOST_PUSHING"]))
        assert acts is not None and acts[n:].all() and acts[:n][~pushes].all()
        m = impulses(S, goal, acts, n, LIMITS["JUMP_DEPENDENT"])
        size = np.abs(S) @ np.abs(m) + np.abs(goal)
        left = S @ m - goal
        assert (m[:n] * S.diagonal()[:n] >= -1e-11 * size[:n])[pushes].all() and (left >= -1e-11 * size)[:n][
            pushes
        ].all()
        assert np.abs(left[acts]).max() <= 1e-9 * size.max() and not m[~acts].any()
        lost = -0.5 * m @ (2 * c + S @ m)
        assert lost >= -1e-12 * np.abs(m) @ np.abs(c) and lost == pytest.approx(0.5 * m @ ((1 - e) * -c), rel=1e-8)
        alone += not acts.all()
    assert alone > 40, "sets with less than all contacts occurred"


def test_the_set_is_that_of_enumeration():
    rng = np.random.default_rng(5)
    for _ in range(150):
        S, c, e, pushes = random_problem(rng)
        goal, n = -(1 + e) * c, len(pushes)
        found = pushing(S, goal, pushes, 1e-12, 1e-12, 4096)
        good = []
        for some in product([False, True], repeat=int(pushes.sum())):
            acts = np.ones(len(goal), bool)
            acts[np.flatnonzero(pushes)] = some
            m = np.zeros(len(goal))
            m[acts] = np.linalg.solve(S[np.ix_(acts, acts)], goal[acts])
            if (m[:n][pushes] >= 0).all() and ((S @ m - goal)[~acts] >= 0).all():
                good.append(acts.tolist())
        assert good == [found.tolist()]
