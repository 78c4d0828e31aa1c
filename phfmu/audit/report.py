"""Where the energy went, as text."""

import io
from collections.abc import Callable, Iterator
from typing import TYPE_CHECKING, Any

from phfmu.words import counted, shown

from .analysis import summarise
from .booking import ESTIMATED
from .judge import DEFAULT_RTOL, VIOLATED
from .summary import LedgerSummary, NetworkSummary

if TYPE_CHECKING:
    import pyarrow as pa
    from rich.table import Table


def audit_table(
    source: "pa.Table | LedgerSummary",
    rtol: float = DEFAULT_RTOL,
    *,
    width: int = 120,
    color: bool = False,
) -> str:
    """Text of where the energy went, from an audit table or a ledger's summary; energies in joule.

    Components (start, end, stored, dissipated, supplied, largest residual as a part of what is allowed, verdict), ports,
    junctions, network, what does not close, events; columns and tables that the run has nothing for are left out.
    `rtol` judges a table; a summary is judged.
    """
    from rich.console import Console

    summary = source if isinstance(source, LedgerSummary) else summarise(source, rtol)
    console = Console(
        file=io.StringIO(),
        width=width,
        force_terminal=color,
        no_color=not color,
        highlight=False,
        markup=False,  # names may hold brackets
        emoji=False,
    )
    for part in _parts(summary):
        if not isinstance(part, str):
            console.print()
        console.print(part, soft_wrap=isinstance(part, str))
    assert isinstance(console.file, io.StringIO)
    return "\n".join(line.rstrip() for line in console.file.getvalue().splitlines()) + "\n"


def _parts(summary: LedgerSummary) -> Iterator[Any]:
    if not summary.steps:
        yield "no steps: nothing was stored, dissipated or supplied"
    else:
        span = f"{counted(summary.steps, 'step')} from t = {summary.t_start:.6g} s to {summary.t_end:.6g} s"
        yield f"Energy in joule, positive into the component; {span}"
    if summary.components:
        yield _filled_table("component", summary.components, _component_columns(summary))
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
            "verdict": lambda j: j.verdict,
        }
        yield _filled_table("junction", summary.junctions, columns)
    if summary.network is not None:
        yield _network_table(summary.network)
    if summary.violations:
        yield _table(
            f"{VIOLATED}: what does not close; allowed: {summary.rtol:.1e} of the energies in play, and rounding"
        )
        yield from (shown(str(v)) for v in summary.violations)
    if summary.events:
        yield "events: " + ", ".join(f"{count} {shown(kind)}" for kind, count in summary.events.items())


def _component_columns(summary: LedgerSummary) -> dict[str, Callable[[Any], str]]:
    columns: dict[str, Callable[[Any], str]] = {
        "H start": lambda c: _joule(c.H_start),
        "H end": lambda c: _joule(c.H_end),
        "stored": lambda c: _joule(c.stored),
    }
    for name in ("dissipated", "numerical", "supplied", "jumps"):
        if any(getattr(component, name) is not None for component in summary.components):
            columns[name] = lambda c, name=name: _joule(getattr(c, name))
    columns["worst"] = lambda c: f"{c.worst_ratio:.1e}"
    columns["verdict"] = lambda c: c.verdict
    return columns


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
        table.add_row(*(shown(text) for text in (first, *(cell(row) for cell in columns.values()))))
    return table


def _network_table(network: NetworkSummary) -> "Table":
    table = _table("network")
    table.add_column("energy", justify="right", no_wrap=True)
    table.add_column("verdict")
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
            table.add_row(label, _joule(value), network.verdict if label == "unexplained" else "")
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
