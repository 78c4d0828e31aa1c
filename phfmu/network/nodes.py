"""Kinds of nodes that the junctions of a composed network are."""

from __future__ import annotations

from phfmu.declare.phdae import PHDAE
from phfmu.terms.bare import Remedy

WORDS = {
    Remedy.PAIR: "bare (index 2): neutral impulse pair, exact at step ends",
    Remedy.PROJECTION: "bare (index 2): projection at step ends, loss booked",
    Remedy.NONE: "bare (index 2): met by step means only",
}


def node_kinds(declaration: PHDAE) -> dict[str, str]:
    """Junction -> index 1, or index 2 and what the steps do about it."""
    from phfmu.terms.bare import bare_nodes
    from phfmu.terms.extraction.extract import extract
    from phfmu.terms.hidden import HiddenConstraints

    terms = extract(declaration)
    names = [n for v in declaration.algebraics for n in v.names()]
    bare = {n.row: n for n in bare_nodes(terms)}
    over = terms.found(HiddenConstraints).rows
    out = {}
    for junction, _ in declaration.junctions:
        rows = [i for i, n in enumerate(names) if n.startswith(f"{junction}.")]
        known = [bare[r] for r in rows if r in bare]
        if known:
            reason = f" ({known[0].reason})" if known[0].reason else ""
            out[junction] = WORDS[known[0].remedy] + reason
        else:
            out[junction] = "linear condition on the states (index 2)" if over & set(rows) else "index 1"
    return out
