"""The page of a run: diagram, flows, energies of components, signals, events, verdict and what the model is."""

import os
from collections.abc import Iterator, Sequence
from dataclasses import dataclass, field
from html import escape
from pathlib import Path
from typing import Any

import numpy as np

from phfmu.audit import summarise
from phfmu.audit.summary import LedgerSummary
from phfmu.pick import pick
from phfmu.report.audit_signals import AuditSignals, marks
from phfmu.report.page.diagram import one_line
from phfmu.report.page.flows import ComponentEnergies, component_energies, links, ports
from phfmu.report.page.gathered import gathered_links, gathered_ports, others
from phfmu.report.page.grid_diagram import grid_diagram
from phfmu.report.page.history import History, read_history
from phfmu.report.page.sankey import sankey, seen
from phfmu.report.picture.html import chart, part, write_page
from phfmu.report.picture.picture import ALWAYS, picture, with_marks
from phfmu.report.picture.prefix import engineering
from phfmu.report.recording import Mark
from phfmu.report.result_table import ResultTable
from phfmu.words import counted

#: events that a table tells one by one, and rows of the folded list of more
FEW, EVENTS = 20, 60
#: junctions whose residuals are told, the largest first
JUNCTIONS = 12


@dataclass(frozen=True)
class Run:
    """The files of one run, and what is wanted of its table; at least one of `audit` and `table`."""

    name: str
    audit: str | None = None
    table: str | None = None
    signals: Sequence[str] = field(default=())


@dataclass(frozen=True)
class PageResult:
    """The result of writing a page: notes of what it does not show; whether the ledger is closed (also without an audit)."""

    notes: tuple[str, ...]
    closed: bool


def write_report(run: Run, path: str | os.PathLike[str], window: tuple[float, float] = ALWAYS) -> PageResult:
    """Write the page of a run over a window.

    Errors: ValueError for files that cannot be read, a window without a step, signals that are not there.
    """
    body: list[str] = []
    closed = True
    notes: list[str] = []
    events: list[Mark] = []
    title = run.name
    if run.audit is not None:
        history, summary = read_history(run.audit), summarise(run.audit)
        recording, closed = AuditSignals(history), summary.closed
        target = str(history.about.get("target") or run.name)
        title = target if target == run.name else f"{target} ({run.name})"
        events = marks(history)
        body += [*_verdict(summary), *_facts(history, run)]
        if summary.steps:
            inside = _window(history, window)
            body += _energy(inside, summary)
            drawn = picture(recording, (), window)
            body += [_heading("Over time"), chart(drawn)]
            notes += drawn.notes
    if run.table is not None:
        table = ResultTable(run.table)
        asked = [table.labelled.get(s, s) for s in run.signals]
        drawn = picture(table, pick(asked, table.names, run.table), window)
        drawn = with_marks(drawn, events, window)
        body += [_heading("Signals"), chart(drawn)]
        notes += drawn.notes
    body += _events([m for m in events if window[0] <= m.time <= window[1]])
    notes = list(dict.fromkeys(notes))
    body += [f'<p class="note">{escape(note)}</p>' for note in notes]
    write_page(path, title, body)
    return PageResult(tuple(notes), closed)


def _window(history: History, window: tuple[float, float]) -> History:
    inside = history.within(*window)
    if not len(inside.steps["t0"]):
        t0, h = history.steps["t0"], history.steps["h"]
        raise ValueError(
            f"{history.path} has no step from {window[0]:g} s to {window[1]:g} s; "
            f"the run is from {t0[0]:g} s to {t0[-1] + h[-1]:g} s"
        )
    return inside


def _verdict(summary: LedgerSummary) -> Iterator[str]:
    if summary.closed:
        yield f"<p><b>Ledger closed</b>: all energy is accounted for (tolerance {summary.rtol:g} of the energies in play).</p>"
        return
    yield '<p class="bad">Ledger violated:</p><ul>'
    yield from (f"<li>{escape(str(v))}</li>" for v in summary.violations)
    yield "</ul>"


def _facts(history: History, run: Run) -> Iterator[str]:
    about, steps = history.about, history.steps
    versions = about.get("phfmu.audit.versions", {})
    facts: dict[str, Any] = {
        "target": about.get("target"),
        "run": (about.get("run") or "") + (about.get("kernels") or ""),
    }
    if len(steps["t0"]):
        t, h = steps["t0"], steps["h"]
        size = f"{h.min():.3g} s" if h.max() - h.min() <= 1e-9 * h.max() else f"{h.min():.3g} s to {h.max():.3g} s"
        facts["steps"] = f"{len(t)} of {size}, from {t[0]:.6g} s to {t[-1] + h[-1]:.6g} s"
    external = sum(not junction for _, _, junction in history.ports)
    parts = [(len(history.components), "member"), (len(history.junctions), "junction"), (external, "external port")]
    facts["model"] = ", ".join(counted(n, what) for n, what in parts if n)
    facts["files"] = ", ".join(Path(f).name for f in (run.audit, run.table) if f)
    facts["versions"] = ", ".join(f"{name} {text}" for name, text in versions.items())
    rows = [f"<tr><th>{name}</th><td>{escape(str(value))}</td></tr>" for name, value in facts.items() if value]
    yield f'<table class="facts">{"".join(rows)}</table>'


def _energy(inside: History, summary: LedgerSummary) -> Iterator[str]:
    """Diagram, Sankey and energies of components of the steps of a window."""
    t, h = inside.steps["t0"], inside.steps["h"]
    span = f"{t[0]:.6g} s to {t[-1] + h[-1]:.6g} s"
    accounts, passed = component_energies(inside), ports(inside)
    gone = others([b.component for b in accounts], passed)
    flows = gathered_links(links(inside), passed, gone)
    below = {b.component: f"dissipated {engineering(b.dissipated, 'J')}" for b in accounts if b.dissipated}
    diagram, faint = grid_diagram(passed, below) if gone else ("", 0)
    if not diagram:
        diagram = one_line(
            [b.component for b in accounts if b.component not in gone], gathered_ports(passed, gone), below
        )
    if diagram:
        yield _heading(f"Energy through the ports, {span}")
        yield f'<div class="wide">{diagram}</div>'
        left = f" {counted(faint, 'member')} that next to no energy passed through are left out." if faint else ""
        yield f'<p class="note">Widths are proportional to energy (1 px at least); arrows show which way it went.{left}</p>'
    if flows:
        yield _heading(f"Where the energy went, {span}")
        drawn, note = seen(flows, summary.rtol * _level(inside))
        if drawn:
            yield part(sankey(drawn))
        if note:
            yield f'<p class="note">{escape(note)}</p>'
        yield from _books([b for b in accounts if b.component not in gone], summary)
        if gone:
            yield (
                f'<p class="note">Of {len(accounts)} members those that most energy passed through; the {len(gone)} others are '
                "drawn as one. All are in the table of: phfmu audit FILE</p>"
            )


def _level(inside: History) -> float:
    """The largest energy that a member stored at a step's end, J."""
    return max((float(np.nanmax(np.abs(c["H1"]), initial=0.0)) for c in inside.components.values()), default=0.0)


def _books(accounts: Sequence[ComponentEnergies], summary: LedgerSummary) -> Iterator[str]:
    """The energies of the members as a table; columns that are empty are left out."""
    words = {c.component: c.verdict for c in summary.components}
    names = ("stored", "dissipated", "numerical", "supplied", "events", "residual")
    shown = [n for n in names if any(getattr(b, n) is not None for b in accounts)]
    heads = {"numerical": "lost by the scheme", "events": "by events"}
    head = "".join(f'<th class="n">{heads.get(n, n)}</th>' for n in shown)
    rows = [
        f"<tr><td>{escape(b.component)}</td>"
        + "".join(_cell(getattr(b, n)) for n in shown)
        + f"<td{' class=bad' if words[b.component] == 'VIOLATED' else ''}>{escape(words[b.component])}</td></tr>"
        for b in accounts
    ]
    yield f"<table><tr><th>component</th>{head}<th>verdict</th></tr>{''.join(rows)}</table>"
    yield from _junctions(summary)


def _junctions(summary: LedgerSummary) -> Iterator[str]:
    """Energy that junctions made in the whole run, net and as the sum of magnitudes of steps, those that made most first."""
    most = sorted(summary.junctions, key=lambda j: -max(j.gross, j.worst_residual))[:JUNCTIONS]
    if not most:
        return
    heads = ("made, net", "made, gross", "exchanged", "most in a step")
    head = "".join(f'<th class="n">{text}</th>' for text in heads)
    rows = "".join(
        f"<tr><td>{escape(j.junction)}</td>"
        + "".join(_cell(v) for v in (j.residual, j.gross, j.exchanged, j.worst_residual))
        + f"<td{' class=bad' if j.verdict == 'VIOLATED' else ''}>{escape(j.verdict)}</td></tr>"
        for j in most
    )
    yield f"<table><tr><th>junction</th>{head}<th>verdict</th></tr>{rows}</table>"
    more = len(summary.junctions) - len(most)
    rest = f" The {more} other junctions made less." if more else ""
    yield (
        '<p class="note">Energy that junctions made in the whole run, which their members got more than they gave: gross is the '
        f"sum of the sizes of its steps, in which signs do not cancel.{rest}</p>"
    )


def _cell(value: float | None) -> str:
    return "<td></td>" if value is None else f'<td class="n" title="{value!r} J">{engineering(value, "J")}</td>'


def _events(found: Sequence[Mark]) -> Iterator[str]:
    """A table of the events; of many, what happened how often, and the first ones folded away."""
    if not found:
        return
    yield _heading("Events")
    rows = "".join(f'<tr><td class="n">{m.time:.9g} s</td><td>{escape(m.text)}</td></tr>' for m in found[:EVENTS])
    if len(found) <= FEW:
        yield f"<table>{rows}</table>"
        return
    yield from _kinds(found)
    some = f"the first {EVENTS} of {len(found)}" if len(found) > EVENTS else f"all {len(found)}"
    yield f"<details><summary>{some}</summary><table>{rows}</table></details>"


def _kinds(found: Sequence[Mark]) -> Iterator[str]:
    """The kinds of events with their numbers, first and last times."""
    times: dict[str, list[float]] = {}
    for m in found:
        times.setdefault(m.text, []).append(m.time)
    often = sorted(times, key=lambda text: -len(times[text]))[:FEW]
    head = '<tr><th>event</th><th class="n">times</th><th class="n">first</th><th class="n">last</th></tr>'
    rows = "".join(
        f'<tr><td>{escape(text)}</td><td class="n">{len(times[text])}</td><td class="n">{times[text][0]:.9g} s</td>'
        f'<td class="n">{times[text][-1]:.9g} s</td></tr>'
        for text in often
    )
    yield f"<table>{head}{rows}</table>"
    if len(times) > FEW:
        yield f'<p class="note">and {len(times) - FEW} others, less often</p>'


def _heading(text: str) -> str:
    return f"<h2>{escape(text)}</h2>"
