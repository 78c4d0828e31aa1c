"""The archive: files in sorted order with a fixed date, so that the same content gives the same bytes."""

from __future__ import annotations

import os
import time
import zipfile
from collections.abc import Mapping
from html import escape
from pathlib import Path

from phfmu.fmu.export.description import ExportedUnit, generation_tool
from phfmu.fmu.export.outward import summed_word
from phfmu.fmu.words import plain

#: a date every zip tool can read; SOURCE_DATE_EPOCH replaces it
OLDEST = (1980, 1, 1, 0, 0, 0)

LICENSE = """\
The files in sources/ that are not marked as generated, and their compiled form in binaries/, are:

MIT License

Copyright (c) 2026 phfmu contributors

Permission is hereby granted, free of charge, to any person obtaining a copy
of this software and associated documentation files (the "Software"), to deal
in the Software without restriction, including without limitation the rights
to use, copy, modify, merge, publish, distribute, sublicense, and/or sell
copies of the Software, and to permit persons to whom the Software is
furnished to do so, subject to the following conditions:

The above copyright notice and this permission notice shall be included in all
copies or substantial portions of the Software.

THE SOFTWARE IS PROVIDED "AS IS", WITHOUT WARRANTY OF ANY KIND, EXPRESS OR
IMPLIED, INCLUDING BUT NOT LIMITED TO THE WARRANTIES OF MERCHANTABILITY,
FITNESS FOR A PARTICULAR PURPOSE AND NONINFRINGEMENT. IN NO EVENT SHALL THE
AUTHORS OR COPYRIGHT HOLDERS BE LIABLE FOR ANY CLAIM, DAMAGES OR OTHER
LIABILITY, WHETHER IN AN ACTION OF CONTRACT, TORT OR OTHERWISE, ARISING FROM,
OUT OF OR IN CONNECTION WITH THE SOFTWARE OR THE USE OR OTHER DEALINGS IN THE
SOFTWARE.
"""


def write(path: Path, files: Mapping[str, bytes]) -> None:
    """An archive of `files` (name inside -> content); it appears under its name only when it is complete."""
    path.parent.mkdir(parents=True, exist_ok=True)
    partial = path.with_name(f".{path.name}.{os.getpid()}")
    try:
        with zipfile.ZipFile(partial, "w", zipfile.ZIP_DEFLATED, compresslevel=9) as archive:
            for name in sorted(files):
                info = zipfile.ZipInfo(name, _date())
                info.compress_type = zipfile.ZIP_DEFLATED
                info.create_system = 3
                info.external_attr = 0o100644 << 16
                archive.writestr(info, files[name])
        os.replace(partial, path)
    finally:
        partial.unlink(missing_ok=True)


def _date() -> tuple[int, int, int, int, int, int]:
    epoch = os.environ.get("SOURCE_DATE_EPOCH")
    return max(OLDEST, time.gmtime(int(epoch))[:6]) if epoch else OLDEST


def documentation(unit: ExportedUnit) -> dict[str, bytes]:
    """documentation/: a page about the unit, and the license of the runtime."""
    return {
        "documentation/index.html": _page(unit).encode(),
        "documentation/licenses/license.txt": LICENSE.encode(),
    }


def _page(unit: ExportedUnit) -> str:
    model, title = unit.model, escape(unit.name)
    columns = ("name", "causality", "unit", "start", "description")
    head = "".join(f"<th>{c}</th>" for c in columns)
    rows = "\n".join(
        "<tr>" + "".join(f"<td>{escape(str(_shown(getattr(v, c))))}</td>" for c in columns) + "</tr>"
        for v in unit.variables
    )
    return f"""\
<!DOCTYPE html>
<html lang="en">
<head><meta charset="utf-8"><title>{title}</title></head>
<body>
<h1>{title}</h1>
<p>{escape(plain(unit.declaration.description))}</p>
<p>Port-Hamiltonian component of {model.step.nx} states, {model.step.na} algebraic variables and
{model.step.nu} port inputs, stepped by the scheme '{escape(model.scheme.name)}' of order
{model.scheme.order} in internal steps of at most {unit.step!r} s. Inputs are held over a communication step{_at_nodes(unit)}.
The product of step length, port input and the output named <code>_step</code> is the energy supplied through
the port, exactly; <code>energy.residual</code> is the change of stored energy plus dissipated minus supplied
energy, which is rounding only.</p>{_signs(unit)}{_left_out(unit)}
<table border="1">
<tr>{head}</tr>
{rows}
</table>
<p>Written by {escape(generation_tool())}.</p>
</body>
</html>
"""


def _at_nodes(unit: ExportedUnit) -> str:
    if not unit.at_nodes:
        return ""
    places = ", ".join(f"{c:.6g}" for c in unit.model.nodes)
    ends = "; impulses at its start and end stay until they are set again" if unit.kernels else ""
    return f", or given at its nodes {places} (fractions of the step; what is set last counts){ends}"


def _signs(unit: ExportedUnit) -> str:
    """Changes of sign between units, told for each port: a plain connection gets it wrong, with closed ledgers."""
    ports = [p for p in unit.declaration.ports if p.external and not p.signal]
    if not ports:
        return ""
    lines = []
    for p in ports:
        shared = p.domain.word(p.domain.common)
        what = f"{p.name}: {p.name}.{shared} is equal on both sides of a connection, {p.name}.{summed_word(p)} "
        lines.append(
            what + "is positive out of this unit: connect it plainly to a unit that counts it inward"
            if p.name in unit.outward
            else what + "sums to zero: positive into both units, so a plain connection needs the factor -1 on it"
        )
    items = "\n".join(f"<li>{escape(plain(line))}</li>" for line in lines)
    return f"""
<p>Signs: power is positive into the unit at its ports. Two units that both count inward and are connected plainly, without
the factor -1, drive each other without bound while the ledger of each closes. An importer that cannot put a factor on a
connection needs a unit exported with <code>--outward PORT</code>.</p>
<ul>
{items}
</ul>"""


def _left_out(unit: ExportedUnit) -> str:
    inside = "\n".join(f"<li>t = {e.t:.9g} s: {escape(e.name)} = {e.value:.9g}</li>" for e in unit.events)
    events = f"\n<p>Events in the unit, which lands on them within a communication step:</p>\n<ul>\n{inside}\n</ul>"
    events = events if unit.events else ""
    if not unit.left_out:
        return events
    items = "\n".join(f"<li>{escape(plain(text))}</li>" for text in unit.left_out)
    return f"{events}\n<p>Of the scene it was exported from, this unit leaves out:</p>\n<ul>\n{items}\n</ul>"


def _shown(value: object) -> object:
    return "" if value is None else value
