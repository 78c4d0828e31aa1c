"""Names and units of everything that a model tells: of its ports, its variables and its energy ledger.

The one place for them: result tables, units and the audit take them from here.  Names have the form `port.member`.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass, field
from typing import TYPE_CHECKING, Literal

import numpy as np

from phfmu.declare.elements import labelled
from phfmu.declare.phdae import ACCOUNT
from phfmu.declare.port import conjugate
from phfmu.declare.variable import VariableKind

if TYPE_CHECKING:
    from phfmu.declare.phdae import PHDAE
    from phfmu.declare.port import Port
    from phfmu.declare.variable import Number, Variable
    from phfmu.discretise.model import Model

#: words of the FMI standard
Causality = Literal["independent", "parameter", "input", "output", "local"]

#: endings of names: mean of the last step, value at the present time, energy through a port
MEAN, END, ENERGY = "_step", "_end", ".energy"
#: residuals of hidden constraints
CONSTRAINT = "constraint."


#: what a signal is: a port's value at the present time, its mean over the last step, an algebraic variable as the step has it and
#: at the step's end, an energy of the books, what a hidden constraint misses, whether a row lies within a step
SignalKind = Literal[
    "state", "observable", "input", "port", "mean", "algebraic", "end", "energy", "constraint", "event", "mark"
]
_KINDS: dict[str, SignalKind] = {
    "x": "state", "a": "algebraic", "a_end": "end", "y_end": "port", "y_step": "mean", "observables": "observable",
    "input": "input", "happened": "event", "mode": "event",
}  # fmt: skip


@dataclass(frozen=True)
class Quantity:
    """One scalar: the sum of `count` entries of `block` from `first` on.

    `block`: one of an instance's signals (x, a, y_step, energy, ..), or a place that only units have (parameter, tunable,
    input, node_input, node_output, impulse, jump, gap, row_*).  `start` is None if calculated; `unit` "1" is none;
    `nominal` None: not known; `checks`: it is what a hidden constraint misses.
    """

    name: str
    causality: Causality
    block: str
    first: int
    count: int = 1
    start: float | None = None
    unit: str = "1"
    nominal: float | None = None
    description: str = ""
    checks: bool = field(default=False, kw_only=True)

    @property
    def kind(self) -> SignalKind:
        """The kind of the signal; all that is not named in `_KINDS` is booked."""
        if self.checks:
            return "constraint"
        return "mean" if self.block.startswith("row_") else _KINDS.get(self.block, "energy")


#: name after `energy.`, block and meaning of the entries of the energy ledger, J
LEDGER = (
    ("stored", "H", "stored energy"),
    ("supplied", "supplied", "energy supplied through ports since the start"),
    ("dissipated", "dissipated", "energy dissipated since the start"),
    ("residual", "residual", "change of stored + dissipated - supplied energy since the start"),
    ("gap", "gap", "change of stored energy since the start that the ledgers of the steps do not explain"),
)
#: the same of one communication step, free of the cancellation of differences
STEP_LEDGER = (
    (f"stored{MEAN}", "row_stored", "change of stored energy in the last step"),
    (f"supplied{MEAN}", "row_supplied", "energy supplied through ports in the last step"),
    (f"dissipated{MEAN}", "row_dissipated", "energy dissipated in the last step"),
    (f"moved{MEAN}", "row_moved", "sum over the energies of |change| in the last step"),
)
#: the same of changes between steps and of jumps, in models that have such
JUMPED = ("events", "jumped", "energy brought since the start by changes of parameters and signals between steps")
#: the part of stored energy that no state enters, in units of models that have such
CONSTANT = "constant"
#: of models with state events: name, unit and meaning of what is counted
HAPPENED = (
    ("events.count", "1", "state events since the start, those that happen together being one"),
    ("events.last", "s", "time of the last state event, of the start before the first"),
    ("events.lost", "J", "energy lost in jumps of the states since the start"),
)
#: the column that marks rows within steps
MARKS = "interpolated"
#: begins the names of values that state events set
MODE = "mode."
#: ending, block and time of the outputs of a port
OUTPUTS = (("", "y_end", "at the present time"), (MEAN, "y_step", "mean of the last step"))


def quantities(model: Model) -> tuple[Quantity, ...]:
    """All quantities of a model in the order in which tables and units list them."""
    d = model.declaration
    return (
        Quantity("time", "independent", "x", model.step.nx, unit="s", description="time"),
        *_parameters(model),
        *_ports(model),
        *_totals(model),
        *_starts(d.states, "local", "x", list(model.x0)),
        *_algebraics(model),
        *_observables(model),
        *_checks(model),
    )


def ordered_ports(declaration: PHDAE) -> list[tuple[Port, int]]:
    """Ports with the place of their first scalar pair: external ones first, then those fed from inside."""
    result, place = [], 0
    for external in (True, False):
        for port in declaration.ports:
            if port.external == external:
                result.append((port, place))
                place += port.n
    return result


def port_energy(port: str) -> str:
    """terminal -> terminal.energy."""
    return port + ENERGY


def pair_energies(port: Port) -> list[str]:
    """terminal -> terminal.energy_step[1], ..."""
    base = port.name + ENERGY + MEAN
    return [base] if port.size is None else [f"{base}[{i + 1}]" for i in range(port.size)]


def end_name(name: str) -> str:
    """lambda[1] -> lambda_end[1]."""
    base, bracket, index = name.partition("[") if "[" in name.rsplit(".", 1)[-1] else (name, "", "")
    return f"{base}{END}{bracket}{index}"


def total(quantity: str, member: str = "") -> str:
    """stored -> energy.stored, of a member gen.energy.stored."""
    return f"{member}.energy.{quantity}" if member else f"energy.{quantity}"


def check_names(model: Model) -> list[str]:
    """constraint.velocity.lambda[1], constraint.position.lambda[1], ... in the order of the checks."""
    return [check_name(check.level, check.name) for check in model.checks]


def check_name(level: str, name: str) -> str:
    """velocity, lambda[1] -> constraint.velocity.lambda[1]."""
    return f"{CONSTRAINT}{level}.{name}"


def derivative_name(signal: str, by: str) -> str:
    """gen.w, gen.J -> d(gen.w)/d(gen.J)."""
    return f"d({signal})/d({by})"


def of_member(member: str, name: str) -> str:
    """Name in the whole of what a member calls `name`: gen.I[1], constraint.velocity.arm.lambda[1].

    A member without a name is composed of others, and calls all by their names already.
    """
    if not member:
        return name
    if not name.startswith(CONSTRAINT):
        return f"{member}.{name}"
    level, _, own = name.removeprefix(CONSTRAINT).partition(".")
    return check_name(level, f"{member}.{own}")


def labels(declaration: PHDAE) -> dict[str, str]:
    """Names -> what readers call them, where the entries of a vector have names: gen.I[4] -> gen.I[fd]."""
    d, found = declaration, dict[str, str]()
    for v in (*d.states, *d.algebraics, *d.parameters, *d.observables):
        if v.elements:
            found |= dict(zip(v.names(), labelled(v.names(), v.elements), strict=True))
    for v in d.algebraics:
        if v.elements:
            ends = [end_name(n) for n in v.names()]
            found |= dict(zip(ends, labelled(ends, v.elements), strict=True))
    for p in d.ports:
        rows = (p.input_names(), *(p.output_names(ending) for ending, _, _ in OUTPUTS)) if p.elements else ()
        found |= {n: label for names in rows for n, label in zip(names, labelled(names, p.elements), strict=True)}
    return found


def entries(value: Number, n: int) -> list[float]:
    """One number, or one per entry, as n of them."""
    return np.broadcast_to(np.asarray(value, float), (n,)).tolist()


def _scalars(declared: Sequence[Variable]) -> Iterator[tuple[int, str, str, Variable, int]]:
    """(place, name, description, variable, entry) of every scalar."""
    place = 0
    for v in declared:
        for i, name in enumerate(v.names()):
            text = v.description or f"{v.kind} {v.name}"
            yield place, name, text if v.size is None else f"{text}, entry {i + 1}", v, i
            place += 1


def _starts(declared: Sequence[Variable], causality: Causality, block: str, start: list[float]) -> list[Quantity]:
    return [
        Quantity(name, causality, block, i, 1, float(start[i]), v.unit, _nominal(v, j), text)
        for i, name, text, v, j in _scalars(declared)
    ]


def _parameters(model: Model) -> Iterator[Quantity]:
    for i, name, text, v, j in _scalars(model.declaration.parameters):
        causality, block = ("input", "tunable") if v.signal else ("parameter", "parameter")
        yield Quantity(name, causality, block, i, 1, float(model.p0[i]), v.unit, _nominal(v, j), text)


def _nominal(v: Variable, entry: int) -> float | None:
    """Parameters have no nominal value of their own."""
    return None if v.kind is VariableKind.PARAMETER or not v.nominal[entry] else abs(v.nominal[entry])


def _algebraics(model: Model) -> Iterator[Quantity]:
    what = "carried on by the scheme" if model.step.carries else "mean of the last step"
    for i, name, text, v, j in _scalars(model.declaration.algebraics):
        yield Quantity(name, "local", "a", i, 1, None, v.unit, _nominal(v, j), f"{text}, {what}")
    for i, name, text, v, j in _scalars(model.declaration.algebraics):
        about = f"{text}, at the present time"
        yield Quantity(end_name(name), "local", "a_end", i, 1, None, v.unit, _nominal(v, j), about)


def _ports(model: Model) -> Iterator[Quantity]:
    for port, first in ordered_ports(model.declaration):
        if port.signal:
            yield from _taken(model, port, first)
            continue
        given, found = port.domain.word(port.given), port.domain.word(conjugate(port.given))
        text = f"of port {port.name}" + (f" ({port.description})" if port.description else "")
        causality: Causality = "output" if port.external else "local"
        if port.external:
            nominal = entries(port.nominal, port.n)
            for i, name in enumerate(port.input_names()):
                yield Quantity(
                    name, "input", "input", first + i, 1, float(model.u0[first + i]), port.input_unit, abs(nominal[i]) or None,
                    f"{given} {text}, held over a step",
                )  # fmt: skip
        for ending, block, when in OUTPUTS:
            for i, name in enumerate(port.output_names(ending)):
                about = f"{found} {text}, {when}"
                yield Quantity(name, causality, block, first + i, 1, None, port.output_unit, description=about)
        about = f"energy {text}, supplied since the start"
        yield Quantity(port_energy(port.name), causality, "energy", first, port.n, None, "J", description=about)


def _taken(model: Model, port: Port, first: int) -> Iterator[Quantity]:
    """The inputs of a signal at nodes; its outputs are told as what they are."""
    for i, name in enumerate(port.input_names() if port.external and not port.sends else ()):
        start, about = float(model.u0[first + i]), port.description or f"signal {port.name}"
        yield Quantity(name, "input", "input", first + i, 1, start, port.input_unit, None, about)


def _totals(model: Model) -> Iterator[Quantity]:
    n = model.step.ncomp
    for name, block, text in LEDGER:
        yield Quantity(total(name), "output", block, 0, n, None, "J", description=text)
    for name, block, text in STEP_LEDGER:
        yield Quantity(total(name), "local", block, 0, n, None, "J", description=text)
    if n == 1:
        return
    first = [i for i, member in enumerate(model.members) if ACCOUNT not in member]
    for i, end in zip(first, [*first[1:], n], strict=True):  # a member is followed by the accounts of its terms
        member = model.members[i]
        for name, block, text in LEDGER if member else ():
            yield Quantity(total(name, member), "local", block, i, end - i, None, "J", description=f"{member}: {text}")


def jumps(model: Model) -> Iterator[Quantity]:
    """Quantities of a unit whose stored energy depends on what may be set between steps, or jumps."""
    name, block, text = JUMPED
    text += ", and by jumps of the states" if model.events is not None else ""
    yield Quantity(total(name), "output", block, 0, model.step.ncomp, None, "J", description=text)


def state_events(model: Model) -> Iterator[Quantity]:
    """Quantities of a unit with state events: how many there were and when, and the modes."""
    for i, (name, unit, text) in enumerate(HAPPENED):
        yield Quantity(name, "output", "happened", i, 1, None, unit, description=text)
    index = {n: i for i, n in enumerate(n for v in model.declaration.parameters for n in v.names())}
    for name in model.declaration.modes:
        i = index[name]
        yield Quantity(
            MODE + name, "local", "mode", i, 1, float(model.p0[i]), description=f"mode {name}, set by state events"
        )


def _observables(model: Model) -> Iterator[Quantity]:
    place = 0
    for o in model.declaration.observables:
        for i in range(o.expr.numel()):
            name = model.observable_names[place]
            text = o.description or f"observable {o.name}"
            text = text if o.expr.numel() == 1 else f"{text}, entry {i + 1}"
            causality: Causality = "output" if o.signal else "local"
            yield Quantity(name, causality, "observables", place, 1, None, o.unit, description=text)
            place += 1
    for name in model.declaration.modes:
        yield Quantity(name, "local", "observables", place, description="mode, set by state events")
        place += 1


def _checks(model: Model) -> Iterator[Quantity]:
    first = len(model.observable_names)
    for i, (name, check) in enumerate(zip(check_names(model), model.checks, strict=True)):
        text = f"residual of the hidden constraint of {check.name}, {check.level} level"
        yield Quantity(name, "output", "observables", first + i, description=text, checks=True)
