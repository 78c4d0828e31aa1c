"""Findings as lines of a terminal, and as an HTML page that stands by itself."""

from __future__ import annotations

from collections import Counter
from collections.abc import Sequence
from html import escape

from phfmu.vet.finding import FALSE, HOLDS, UNTESTED
from phfmu.vet.process import VettingResult

#: verdict -> colour of its cell and mark
_LOOKS = {HOLDS: ("#e3f4ec", "&#10003;"), FALSE: ("#fbe0dc", "&#10007;"), UNTESTED: ("#f2f2f2", "&ndash;")}
_STYLE = """
body { font: 15px/1.45 system-ui, sans-serif; margin: 2rem auto; max-width: 1150px; padding: 0 1rem; color: #1b1b1b }
h1 { font-size: 1.35rem } h2 { font-size: 1.1rem; margin-top: 2.2rem; overflow-wrap: anywhere }
table { border-collapse: collapse; width: 100% } td, th { text-align: left; vertical-align: top; padding: .35rem .7rem }
tr { border-bottom: 1px solid #ddd } td:nth-child(1) { white-space: nowrap; font-weight: 600 }
td:nth-child(2) { white-space: nowrap } td:nth-child(3) { color: #555; width: 28% }
td:nth-child(4) { overflow-wrap: break-word; width: 46% }
.false { color: #a61b0c; font-weight: 600 }
"""


def summary(vetted: VettingResult) -> str:
    """`2 of 26 claims are false, 15 hold, 9 untested (12 s)`."""
    counts = Counter(f.verdict for _, f in vetted.findings)
    return (
        f"{counts[FALSE]} of {len(vetted.findings)} claims false, {counts[HOLDS]} hold, {counts[UNTESTED]} untested "
        f"({vetted.seconds:.0f} s)"
    )


def lines(vetted: VettingResult) -> list[str]:
    """A line for each claim: verdict, name, what was seen."""
    wide = max(len(c.name) for c, _ in vetted.findings)
    told = [f"  {f.verdict:<8}  {c.name:<{wide}}  {f.seen}" for c, f in vetted.findings]
    return [vetted.unit, *told, f"{vetted.unit}: {summary(vetted)}"]


def page(units: Sequence[VettingResult]) -> str:
    """An HTML page with a table of claims for each unit."""
    parts = [_unit(u) for u in units]
    title = "Claims of units, tried"
    return (
        f'<!doctype html>\n<html lang="en"><head><meta charset="utf-8"><title>{title}</title>'
        f'<meta name="viewport" content="width=device-width"><style>{_STYLE}</style></head>'
        f"<body><h1>{title}</h1>{''.join(parts)}</body></html>\n"
    )


def _unit(vetted: VettingResult) -> str:
    rows = "".join(
        f'<tr style="background:{_LOOKS[f.verdict][0]}"><td>{escape(c.name)}</td>'
        f"<td>{_LOOKS[f.verdict][1]} {f.verdict}</td><td>{escape(c.done)}</td><td>{escape(f.seen)}</td></tr>"
        for c, f in vetted.findings
    )
    wrong = f'<p class="false">false: {escape(", ".join(vetted.false))}</p>' if vetted.false else ""
    return (
        f"<h2>{escape(vetted.unit)}</h2><p>{escape(summary(vetted))}</p>{wrong}<table><thead><tr><th>claim</th>"
        f"<th>verdict</th><th>what was done</th><th>what was seen</th></tr></thead><tbody>{rows}</tbody></table>"
    )
