"""Networks with more members than a page can show: those that most energy passes through, the others as one."""

import math
from collections import Counter
from collections.abc import Sequence

from phfmu.report.page.flows import JUNCTION, MEMBER, PORT, Link, Node, PortEnergy

#: members up to which all are drawn, and those that are drawn of more
ALL, MOST = 24, 12


def others(members: Sequence[str], passed: Sequence[PortEnergy]) -> frozenset[str]:
    """Members that are drawn as one: all but those with the largest energies through their ports."""
    if len(members) <= ALL:
        return frozenset()
    through = dict.fromkeys(members, 0.0)
    for p in passed:
        through[p.component] = through.get(p.component, 0.0) + abs(p.energy)
    return frozenset(sorted(through, key=lambda m: -through[m])[MOST:])


def gathered_ports(passed: Sequence[PortEnergy], gone: frozenset[str]) -> list[PortEnergy]:
    """Ports with those of `gone` as ports of one member, behind one junction where no two of the drawn ones meet."""
    if not gone:
        return list(passed)
    kept, one = _kept(passed, gone), "others"
    edge = {p.junction for p in passed if p.component not in gone and p.junction} - kept
    found, sums = list[PortEnergy](), dict[tuple[str, str, str], list[float]]()
    for p in passed:
        junction = one if p.junction in edge else p.junction
        if p.component not in gone and junction != one:
            found.append(p)
        elif p.component not in gone:
            sums.setdefault((p.component, "", one), []).append(p.energy)
        elif not junction or junction == one or junction in kept:
            sums.setdefault((_name(gone), "" if junction else "ports", junction), []).append(p.energy)
    return found + [PortEnergy(*names, math.fsum(parts)) for names, parts in sums.items()]


def _kept(passed: Sequence[PortEnergy], gone: frozenset[str]) -> set[str]:
    """Junctions at which two members meet that are drawn."""
    ends = Counter(p.junction for p in passed if p.component not in gone and p.junction)
    return {junction for junction, n in ends.items() if n > 1}


def gathered_links(found: Sequence[Link], passed: Sequence[PortEnergy], gone: frozenset[str]) -> list[Link]:
    """Flows with the members of `gone` and the junctions where no two of the others meet as one member."""
    if not gone:
        return list(found)
    kept = _kept(passed, gone)

    def of(node: Node) -> Node:
        inside = (
            (node.kind == MEMBER and node.name in gone)
            or (node.kind == JUNCTION and node.name not in kept)
            or (node.kind == PORT and node.name.rpartition(".")[0] in gone)
        )
        if node.kind == PORT and inside:
            return Node(PORT, f"ports of {_name(gone)}")
        return Node(MEMBER, _name(gone)) if inside else node

    net: dict[tuple[Node, Node], list[float]] = {}
    for link in found:
        ends = of(link.source), of(link.target)
        if ends[0] == ends[1]:
            continue
        back = ends[1], ends[0]
        if back in net:
            net[back].append(-link.energy)
        else:
            net.setdefault(ends, []).append(link.energy)
    sums = {ends: math.fsum(parts) for ends, parts in net.items()}
    return [Link(a, b, e) if e > 0.0 else Link(b, a, -e) for (a, b), e in sums.items() if e]


def _name(gone: frozenset[str]) -> str:
    return f"{len(gone)} other members"
