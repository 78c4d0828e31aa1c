"""Claims of modelDescription.xml itself: it fits the schema, and its variables, units and structure fit each other."""

from __future__ import annotations

from phfmu.fmu.importer.inspect import fmu_problems
from phfmu.vet.finding import ClaimFinding, false, holds
from phfmu.vet.subject import Subject
from phfmu.words import counted

#: problems that are quoted
QUOTED = 4


def description(subject: Subject) -> ClaimFinding:
    """Schema, units, start values, names and structure of the description, as FMPy's validation and this package judge them."""
    found = [" ".join(p.split()) for p in fmu_problems(subject.path)]
    if found:
        more = f"; {len(found) - QUOTED} more" if len(found) > QUOTED else ""
        return false(f"{counted(len(found), 'problem')}: {'; '.join(found[:QUOTED])}{more}")
    about = subject.interface
    return holds(f"FMI {about.version}, {counted(len(about.variables), 'variable')}, no problem")
