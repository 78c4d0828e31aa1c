"""Where the energy went, as text."""

import io
import math
from collections.abc import Callable, Iterator
from typing import TYPE_CHECKING, Any

from phfmu.words import counted

from .analysis import DEFAULT_RTOL, summarise
from .rows import ESTIMATED
from .summary import ComponentSummary, LedgerSummary, NetworkSummary
from .sums import relative

if TYPE_CHECKING:
    import pyarrow as pa
    from rich.table import Table


def audit_table(
    source: "pa.Table | LedgerSummary",
    rtol: float = DEFAULT_RTOL,
    *,
    width: int = 100,
    color: bool = False,
) -> str:
    """Text of where the energy went, from an audit table or a ledger's summary; energies in joule.

    Components (start, end, stored, dissipated, supplied, worst step, verdict), ports, junctions, network,
    events; columns and tables that the run has nothing for are left out.
    """
    from rich.console import Console

    summary = source if isinstance(source, LedgerSummary) else summarise(source)
    console = Console(
        file=io.StringIO(),
        width=width,
        force_terminal=color,
        no_color=not color,
        highlight=False,
        markup=False,  # names may hold brackets
        emoji=False,
    )
    for part in _parts(summary, rtol):
        if not isinstance(part, str):
            console.print()
        console.print(part, soft_wrap=isinstance(part, str))
    assert isinstance(console.file, io.StringIO)
    return "\n".join(line.rstrip() for line in console.file.getvalue().splitlines()) + "\n"


def _parts(summary: LedgerSummary, rtol: float) -> Iterator[Any]:
    if not summary.steps:
        yield "no steps: nothing was stored, dissipated or supplied"
    else:
        span = f"{counted(summary.steps, 'step')} from t = {summary.t_start:.6g} s to {summary.t_end:.6g} s"
        yield f"Energy in joule, positive into the component; {span}"
    if summary.components:
        yield _filled_table("component", summary.components, _component_columns(summary, rtol))
        yield from _complaints(summary, rtol)
    if summary.ports:
        joined = any(port.junction for port in summary.ports)
        columns: dict[str, Callable[[Any], str]] = {"supplied": lambda p: _joule(p.supplied)}
        if joined:
            columns["junction"] = lambda p: p.junction or "(external)"
        if any(port.quality == ESTIMATED for port in summary.ports):
            columns["quality"] = lambda p: p.quality
        yield _filled_table("port", summary.ports, columns, name=lambda p: f"{p.component}.{p.port}")
    if summary.junctions:
        columns = {
            "residual": lambda j: _joule(j.residual),
            "worst step": lambda j: _joule(j.worst_residual),
            "exchanged": lambda j: _joule(j.exchanged),
        }
        yield _filled_table("junction", summary.junctions, columns)
    if summary.network is not None:
        yield _network_table(summary.network)
    if summary.events:
        yield "events: " + ", ".join(f"{count} {kind}" for kind, count in summary.events.items())


def _component_columns(summary: LedgerSummary, rtol: float) -> dict[str, Callable[[Any], str]]:
    columns: dict[str, Callable[[Any], str]] = {
        "H start": lambda c: _joule(c.H_start),
        "H end": lambda c: _joule(c.H_end),
        "stored": lambda c: _joule(c.stored),
    }
    for name in ("dissipated", "numerical", "supplied", "jumps"):
        if any(getattr(component, name) is not None for component in summary.components):
            columns[name] = lambda c, name=name: _joule(getattr(c, name))
    columns["worst"] = lambda c: f"{c.worst_relative:.1e}"
    columns["verdict"] = lambda c: _judged(c, rtol)
    return columns


def _judged(component: ComponentSummary, rtol: float) -> str:
    if component.quality == ESTIMATED:
        return ESTIMATED
    return "closed" if component.worst_relative <= rtol else "VIOLATED"


def _complaints(summary: LedgerSummary, rtol: float) -> Iterator[str]:
    """One line for each component that does not close, with the numbers of its worst step."""
    for c in summary.components:
        if _judged(c, rtol) == "VIOLATED":
            yield (
                f"{c.component}: step {c.worst_step} at t = {c.worst_t0:.9g} s misses "
                f"{c.worst_residual:.3e} J, {c.worst_relative:.1e} of its energies; allowed: {rtol:.1e}"
            )
        if relative(c.gap, c.magnitude) > max(rtol, 1e-12 * math.sqrt(summary.steps)):
            yield f"{c.component}: H changed by {c.gap:.3e} J between its steps; no event books it"


def _filled_table(
    title: str,
    rows: list[Any],
    columns: dict[str, Callable[[Any], str]],
    name: Callable[[Any], str] | None = None,
) -> "Table":
    table = _table(title)
    words = {"verdict", "quality", "junction"}
    for header in columns:
        table.add_column(header, justify="left" if header in words else "right", no_wrap=header != "junction")
    for row in rows:
        first = name(row) if name else getattr(row, title)
        table.add_row(first, *(cell(row) for cell in columns.values()))
    return table


def _network_table(network: NetworkSummary) -> "Table":
    table = _table("network")
    table.add_column("energy", justify="right", no_wrap=True)
    rows = {
        "stored": network.stored,
        "dissipated": network.dissipated,
        "lost by the scheme": network.numerical,
        "supplied from outside": network.external,
        "created by the junctions": network.junction_residual,
        "unexplained": network.unexplained,
        "unexplained, worst step": network.worst_unexplained,
    }
    for label, value in rows.items():
        if value is not None:
            table.add_row(label, _joule(value))
    return table


def _table(title: str) -> "Table":
    from rich.box import Box
    from rich.table import Table

    # a rule below the header and nothing else, in ASCII: any pipe takes it
    rule = Box("    \n" * 2 + " -- \n" + "    \n" * 5, ascii=True)
    table = Table(box=rule, show_edge=False, padding=(0, 1, 0, 0), pad_edge=False)
    table.add_column(title, overflow="fold", min_width=10)
    return table


def _joule(value: float | None) -> str:
    return "" if value is None else f"{value:.3e}"
