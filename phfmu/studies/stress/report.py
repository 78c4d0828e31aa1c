"""The answers as a page and as lines on the terminal."""

from __future__ import annotations

from collections import Counter
from collections.abc import Sequence
from pathlib import Path

from phfmu.studies.stress.case import StressResult, Verdict
from phfmu.studies.tables import markdown_table

HEAD = """# Stiff and extreme cases

Every case is a question with a criterion; what happened stands beside it. Energies are relative to the start (`H0`) or,
as `balance`, the largest |stored + dissipated - supplied| of a member and step over the energy in play. `g` is the
largest position constraint. A step is solved by sweeps of the Schur stepper or by iterations of Newton's method; both
where the first left it to the second. Restarts began from rest or from shorter steps. "At rest": nothing moves in the
target, so the criterion could not fail. "Not supported" says why a case cannot be posed. A run of 1e6 steps (some 10 s)
waits for `--long`.

    {command}

{counts}.
"""


def short(line: StressResult) -> str:
    """One line for the terminal."""
    return f"{line.verdict.value:13}  {line.case.target}: {line.case.name}: {line.happened}  [{line.case.criterion}]"


def tally(lines: Sequence[StressResult]) -> str:
    """Counts of the verdicts, in words."""
    found = Counter(line.verdict for line in lines)
    return ", ".join(f"{found[v]} {v.value.lower()}" for v in Verdict if found[v])


def page(lines: Sequence[StressResult], arguments: str) -> str:
    """The page in Markdown, a table per target."""
    text = [HEAD.format(command=f"phfmu stress {arguments}".rstrip(), counts=tally(lines))]
    for target in dict.fromkeys(line.case.target for line in lines):
        own = (x for x in lines if x.case.target == target)
        rows = ((x.case.name, x.happened, x.case.criterion, x.verdict.value) for x in own)
        escaped = ([c.replace("|", "\\|").replace("\n", " ") for c in row] for row in rows)
        text += [f"## {target}", "", markdown_table(["case", "what happened", "criterion", "verdict"], escaped), ""]
    return "\n".join(text)


def write(lines: Sequence[StressResult], folder: str | Path, arguments: str) -> Path:
    """stress.md in `folder`."""
    Path(folder).mkdir(parents=True, exist_ok=True)
    path = Path(folder) / "stress.md"
    path.write_text(page(lines, arguments))
    return path
