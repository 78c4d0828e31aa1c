"""Choice of the signals of a picture that nobody chose.

At most `MOST` on an axis.  Of a result table: states, observables and inputs before values at ports, these before algebraic
variables; first entries before second ones, so that every variable has its turn; no signal that is the negative of another
one; those that are equal count as one, since they are drawn as one.  Of an audit: the largest.
"""

from collections.abc import Mapping, Sequence

import numpy as np

from phfmu.report.recording import Floats, Signal
from phfmu.words import counted

#: signals on an axis
MOST = 6
#: what is not drawn unasked
_BESIDE = ("mean", "end", "energy", "constraint", "mark")
#: what comes later than the others
_RANKS = {"port": 1, "algebraic": 2}
#: rows at which two signals are compared
_SAMPLES = 500


def usual(names: Sequence[str], kinds: Mapping[str, str]) -> list[str]:
    """Signals of a table that may be drawn: all but means and ends of steps, energies and the marks of rows."""
    chosen = [n for n in names if kinds.get(n) not in _BESIDE]
    return chosen or list(names)


def first(groups: Sequence[list[Signal]]) -> list[list[Signal]]:
    """Groups that are drawn: where units are not known, those of ports and algebraic variables only where there are no others."""

    def known(s: Signal) -> bool:
        return bool(s.topic) or s.unit not in (None, "") or s.kind not in _RANKS

    kept = [group for group in groups if known(group[0])]
    return kept or list(groups)


def few(signals: Sequence[Signal]) -> list[Signal]:
    """Signals of one axis that are drawn, in their order."""
    if signals[0].topic:
        return _largest(signals)
    turns: dict[str, int] = {}
    keys = dict[int, tuple[int, int]]()
    for i, s in enumerate(signals):
        base = _base(s.name)
        turns[base] = turns.get(base, -1) + 1
        keys[i] = rank(s), turns[base]
    kept, twins = list[int](), list[int]()
    for i in sorted(keys, key=keys.__getitem__):
        if any(same(signals[i], signals[k]) for k in kept):
            twins.append(i)
        elif len(kept) < MOST and not (keys[i][0] and any(again(signals[i], signals[k]) for k in kept)):
            kept.append(i)
    return [signals[i] for i in sorted((*kept, *twins))]


def rank(s: Signal) -> int:
    """Rank of a signal by its kind: 0 is drawn first."""
    return _RANKS.get(s.kind, 0)


def same(a: Signal, b: Signal) -> bool:
    """Whether two signals are one curve, however far one zooms in: at all rows, to rounding and 1e-6 of its height."""
    if len(a.values) != len(b.values):
        return False
    some = slice(None, None, max(len(a.values) // _SAMPLES, 1))
    near = _near(a.values[some], b.values[some]) and _near(a.values, b.values)
    return near and np.array_equal(a.time, b.time)


def _near(a: Floats, b: Floats) -> bool:
    finite = a[np.isfinite(a)]
    close = max(1e-6 * float(np.ptp(finite)), 1e-12 * float(np.abs(finite).max())) if len(finite) else 0.0
    with np.errstate(invalid="ignore"):
        return bool(((np.abs(a - b) <= close) | (a == b) | (np.isnan(a) & np.isnan(b))).all())


def told(left: Sequence[str], total: int, audit: bool) -> str:
    """The line that says what is left out and how to see it."""
    rule = (
        "the largest"
        if audit
        else "states, observables and inputs first; no means and ends of steps; energies as powers"
    )
    return (
        f"{counted(len(left), 'signal')} of {total} left out (at most {MOST} an axis: {rule}); "
        f"to see them: phfmu plot FILE {left[0].partition('[')[0]} ..."
    )


def _base(name: str) -> str:
    return name.partition("[")[0]


def again(a: Signal, b: Signal) -> bool:
    """Whether two signals of different variables draw the same curve, or its mirror image."""
    if _base(a.name) == _base(b.name) or len(a.values) != len(b.values):
        return False
    every = max(len(a.values) // _SAMPLES, 1)
    x, y = a.values[::every], b.values[::every]
    close = 1e-6 * float(np.nanmax(np.abs(x), initial=0.0))
    return any(bool((np.abs(x - sign * y) <= close).all()) for sign in (1.0, -1.0))


def _largest(signals: Sequence[Signal]) -> list[Signal]:
    """The largest of a topic, and their limits."""
    sizes = {i: float(np.nanmax(np.abs(s.values), initial=0.0)) for i, s in enumerate(signals) if not s.limit}
    kept = set(sorted(sizes, key=lambda i: -sizes[i])[:MOST])
    owners = {signals[i].owner for i in kept}
    return [s for i, s in enumerate(signals) if i in kept or (s.limit and s.owner in owners)]
