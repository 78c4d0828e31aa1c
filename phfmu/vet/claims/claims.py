"""All claims, in the order in which they are tried."""

from __future__ import annotations

from collections.abc import Sequence

from phfmu.fmu.importer.inspect import fmu_problems
from phfmu.vet.claims import calls, derivatives, determinism, energy, footprint, references, rollback, stepping, values
from phfmu.vet.finding import Claim, ClaimFinding, false, holds
from phfmu.vet.subject import Subject
from phfmu.words import counted, meant

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


CLAIMS = (
    Claim("description", "schema, units, start values, names and structure (FMPy's validation and this package)", description),
    Claim("steps", "the steps of its experiment, with inputs at rest and moved", stepping.steps),
    Claim("start values", "variables that begin at a start value are read after initialisation", values.start_values),
    Claim("parameters kept", "each parameter is set before the start and read after two steps", values.parameters_kept),
    references.CLAIM,
    Claim("state restored", "saved, gone astray, restored, and stepped again, twice", rollback.state_restored),
    Claim("state as bytes", "serialised, and stepped again in another instance and in a new process", rollback.state_as_bytes),
    Claim("two instances", "a run by itself, and beside another instance", determinism.two_instances),
    Claim("two processes", "the same run in another process", determinism.two_processes),
    Claim("order of calls", "inputs and outputs one by one, in reverse, twice", determinism.order_of_calls),
    Claim("threads", "two instances in two threads", determinism.threads),
    Claim("reset", "a run, a reset, and the run again", stepping.reset),
    Claim("step sizes", "h, h/2 and h/3 under the same inputs", stepping.step_sizes),
    Claim("unequal steps", "steps of three lengths in turns", stepping.unequal_steps),
    Claim("directional derivatives", "against central differences, of the instant and of the step", derivatives.directional),
    Claim("adjoint derivatives", "against the directional ones", derivatives.adjoint),
    Claim("finite values", "every value that comes with OK, over the experiment", values.finite_values),
    Claim("unchanged at rest", "values read twice, and after the same inputs are set again", values.unchanged_at_rest),
    Claim("feedthrough", "each input moved between steps, against the declared dependencies", values.feedthrough),
    Claim("input timing", "an input moved before one step only: when outputs answer (told)", values.input_timing),
    Claim("early return", "steps that may return early, and that may not", calls.early_return),
    Claim("intermediate update", "a callback, against what is declared", calls.intermediate_update),
    Claim("memory", "bytes in use over 1e4 steps", footprint.memory),
    Claim("files", "files and handles after the instance is freed", footprint.files),
    Claim("outward", "sockets and processes while it runs (told, not judged)", footprint.outward),
    Claim("ledger", "stored + dissipated = supplied in each step, where it keeps books", energy.ledger),
    Claim("passivity", "energy given out at its ports from rest, along sines and the worst input found", energy.passivity),
)  # fmt: skip


def chosen(names: Sequence[str]) -> tuple[Claim, ...]:
    """The claims of these names, in order, after `steps`, which tells which inputs can be moved; all for no name.

    KeyError names close ones for a name that is none.
    """
    known = {claim.name: claim for claim in CLAIMS}
    for name in names:
        if name not in known:
            raise KeyError(f"--claim: there is no claim '{name}'; {meant(name, known)}")
    return tuple(c for c in CLAIMS if c.name in {*names, "steps"}) if names else CLAIMS
