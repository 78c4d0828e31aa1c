"""Powers and stored energies of a result table, from its columns of energy: what every picture that nobody chose ends with."""

from collections.abc import Mapping, Sequence
from dataclasses import replace

import numpy as np

from phfmu.report.picture.choice import again
from phfmu.report.picture.prefix import engineering
from phfmu.report.recording import Recording, Signal
from phfmu.signals import ENERGY, total

POWER, STORED = "power into the component, mean between rows", "stored energy since the start"
_WHOLE = total("stored")


def energy_columns(names: Sequence[str], kinds: Mapping[str, str]) -> list[str]:
    """The energies through ports, and the stored ones of the members, or of the whole where there is one alone."""
    energies = [n for n in names if kinds.get(n) == "energy"]
    members = [n for n in energies if n.endswith(f".{_WHOLE}")]
    return [n for n in energies if n.endswith(ENERGY)] + (members or [n for n in energies if n == _WHOLE])


def energies(recording: Recording) -> list[Signal]:
    """Powers [W] and stored energies [J] less their first values; none of what is zero, of two ends of a bond one."""
    columns = recording.read(energy_columns(recording.names, recording.kinds))
    powers = [_power(s) for s in columns if s.name.endswith(ENERGY)]
    stored = [_stored(s) for s in columns if not s.name.endswith(ENERGY)]
    kept = list[Signal]()
    for s in powers:
        if _any(s) and not any(again(s, k) for k in kept):
            kept.append(s)
    return [*kept, *(s for s in stored if _any(s))]


def _power(s: Signal) -> Signal:
    """Means over the times between rows; rows at one time, as before and after an event, have none."""
    h = np.diff(s.time)
    there = h > 0.0
    middle, change = s.time[:-1] + 0.5 * h, np.diff(s.values)
    name = f"{s.name.removesuffix(ENERGY)}.power"
    return replace(s, name=name, unit="W", time=middle[there], values=change[there] / h[there], topic=POWER, label="")


def _stored(s: Signal) -> Signal:
    first = float(s.values[0]) if len(s.values) else 0.0
    label = f"{s.name} − {engineering(first, 'J')}" if first else s.name
    return replace(s, unit="J", values=s.values - first, topic=STORED, label=label)


def _any(s: Signal) -> bool:
    return bool((np.nan_to_num(s.values) != 0.0).any())
