"""A member from the file of a unit, of the kind that it can be."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import replace
from functools import partial

from phfmu.fmu.importer.reader import FMUInstance
from phfmu.fmu.importer.unit_file import UnitFile
from phfmu.network.members.fmu_member import FMUMember
from phfmu.network.members.member import Member
from phfmu.network.members.predicted_member import PredictedMember
from phfmu.network.members.rollback import REPEAT_MODES, Rollback, response, tells_late, try_rollback

LAST = "it is stepped last, against a predicted response; what that misses is booked at its junctions"
LATE = (
    "tells outputs that follow its inputs at once only after a step; each step is taken in two parts, of a third and two thirds, "
    "for their mean"
)


def made(name: str, file: UnitFile, no_set_prior: bool = True, in_parts: bool = False) -> FMUInstance:
    """An instance for a run from t = 0; no coupling restores a state of a time before the step that is taken."""
    return FMUInstance(
        file.path, file.port_maps, starts=file.starts, start=0.0, name=name, isolate=file.isolate,
        tolerance=file.tolerance, no_set_prior=no_set_prior, in_parts=in_parts,
    )  # fmt: skip


def tried(units: Mapping[str, UnitFile], h: float) -> dict[str, Rollback]:
    """Whether units of other tools take steps of length h back; those of this package restore every bit."""
    found = dict[str, Rollback]()
    for n, f in units.items():
        if not f.interface.energy:
            late = tells_late(partial(made, n, f), h)
            found[n] = replace(try_rollback(partial(made, n, f, in_parts=late), h), late=late)
    return found


def unit_member(name: str, file: UnitFile, h: float, found: Rollback | None = None) -> tuple[Member, list[str]]:
    """The member `name` of a network with steps of length h, and lines about what it cannot do.

    found: what a trial gave; a unit that cannot take steps back is stepped last.  None where no step is taken back.
    """
    notes = [f"{name}: {line}" for line in file.left_out]
    # before the member: some libraries have one instance at a time
    late = not file.interface.energy and tells_late(partial(made, name, file), h) if found is None else found.late
    answer = None if found is None or found.works else response(partial(made, name, file, in_parts=late), h)
    way = found.way if found and found.works else REPEAT_MODES[0]
    unit = made(name, file, way.no_set_prior, late)
    notes += [f"{name}: {line}" for line in unit.lacking]
    notes += [f"{name}: {LATE}"] if late else []
    if answer is not None and found is not None:
        return PredictedMember(FMUMember(name, unit), h, answer), [*notes, f"{name}: {found.words}; {LAST}"]
    notes += [f"{name}: {found.words}"] if found and found.words else []
    return FMUMember(name, unit, way.once_more, found.repeated if found else 0.0), notes
