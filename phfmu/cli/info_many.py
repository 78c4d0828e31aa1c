"""phfmu info of a network with many members: how many of which kind, and how they are joined."""

from __future__ import annotations

from collections import Counter
from collections.abc import Sequence
from typing import TYPE_CHECKING

from phfmu.words import counted

if TYPE_CHECKING:
    from phfmu.declare.phdae import PHDAE
    from phfmu.network.junctions.network import Network

#: members of a network that are told one by one
FEW = 24
#: names that stand for all of a kind
SOME = 3


def print_many(network: Network) -> None:
    """Members by kind, junctions by what they join, the number of variables."""
    from phfmu.network.couplings.apart import Apart
    from phfmu.network.couplings.gathered import composed_words, gathered, junction_words

    kinds = _kinds(network)
    print(f"members: {len(network.members)} of {counted(len(kinds), 'kind')}")
    kind_of = {}
    for label, names in kinds.items():
        kind_of |= dict.fromkeys(names, label)
        member = network.members[names[0]]
        print(f"  {len(names)} x {label}: {getattr(member, 'description', '')} ({_some(names)})".replace(":  (", ": ("))
        for line in _parameters([network.declared[n] for n in names if n in network.declared]):
            print(f"    {line}")
    print(f"order: {Apart(network).order()}")
    if line := composed_words(gathered(network)):
        print(line)
    words = junction_words(network)
    groups: dict[tuple[str, str, str], list[str]] = {}
    for j in network.junctions:
        ends = Counter(f"{kind_of[e.member]}.{e.port}" for e in j.ends)
        joined = ", ".join(f"{n} x {end}" if n > 1 else end for end, n in ends.items())
        common = f"common {j.shared}"
        groups.setdefault((joined, common, words[j.name]), []).append(j.name)
    print(f"junctions: {len(network.junctions)} of {counted(len(groups), 'kind')}")
    for (joined, common, exchange), names in groups.items():
        print(f"  {len(names)} x {joined}; {common}; {exchange} ({_some(names)})")
    if network.wires:
        print(f"signals: {len(network.wires)}")
    for what in ("states", "algebraics", "parameters"):
        n = sum(v.n for d in network.declared.values() for v in getattr(d, what))
        print(f"{what.replace('algebraics', 'algebraic variables')}: {n}")


def _kinds(network: Network) -> dict[str, list[str]]:
    """Kind -> members: declarations with the same equations, FMUs of the same file."""
    from phfmu.declare.alike import first_alike

    found: dict[object, list[str]] = {}
    for name, d in network.declared.items():
        found.setdefault(first_alike(d), []).append(name)
    for name, unit in network.units.items():
        found.setdefault(unit.found, []).append(name)
    labels: dict[str, list[str]] = {}
    for kind, names in found.items():
        label = kind if isinstance(kind, str) else network.members[names[0]].name
        number = sum(known.partition(" (")[0] == label for known in labels)
        labels[f"{label} ({number + 1})" if number else label] = names
    return labels


def _some(names: Sequence[str]) -> str:
    return ", ".join(names) if len(names) <= SOME else f"{', '.join(names[: SOME - 1])}, .. {names[-1]}"


def _parameters(members: Sequence[PHDAE]) -> list[str]:
    """Parameters of a kind with their range."""
    lines = []
    for i, v in enumerate(members[0].parameters if members else ()):
        starts = [s for d in members for s in d.parameters[i].start]
        low, high = min(starts), max(starts)
        size = f"[1..{v.size}]" if v.size else ""
        lines.append(f"{v.name + size} = {low:g}{'' if low == high else f' .. {high:g}'} {v.unit}")
    return lines
