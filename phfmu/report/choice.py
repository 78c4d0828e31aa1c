"""Which signals a picture shows that nobody chose.

At most `MOST` on an axis.  Of a result table: states, observables and inputs before values at ports, these before algebraic
variables; first entries before second ones, so that every variable has its turn; no signal that is another one or its
negative again.  Of an audit: the largest.
"""

from collections.abc import Mapping, Sequence

import numpy as np

from phfmu.report.recording import Signal
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
    """Those of one axis that are drawn, in their order."""
    if signals[0].topic:
        return _largest(signals)
    turns: dict[str, int] = {}
    keys = dict[int, tuple[int, int]]()
    for i, s in enumerate(signals):
        base = _base(s.name)
        turns[base] = turns.get(base, -1) + 1
        keys[i] = _RANKS.get(s.kind, 0), turns[base]
    kept: list[int] = []
    for i in sorted(keys, key=keys.__getitem__):
        if len(kept) < MOST and not (keys[i][0] and any(_again(signals[i], signals[k]) for k in kept)):
            kept.append(i)
    return [signals[i] for i in sorted(kept)]


def told(left: Sequence[str], total: int, audit: bool) -> str:
    """The line that says what is left out and how to see it."""
    rule = "the largest" if audit else "states, observables and inputs first; no means and ends of steps, no energies"
    return (
        f"{counted(len(left), 'signal')} of {total} left out (at most {MOST} an axis: {rule}); "
        f"to see them: phfmu plot FILE {left[0].partition('[')[0]} ..."
    )


def _base(name: str) -> str:
    return name.partition("[")[0]


def _again(a: Signal, b: Signal) -> bool:
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
