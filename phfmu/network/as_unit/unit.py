"""A coupled network as a unit: its members, stepped apart and joined by the master inside.

Its variables are those of the members, `member.name`, with the sums of their ledgers, the junction unknowns, and the energies
made at the junctions.  What junctions feed is told and cannot be set; ports that they leave free are the ports of the unit.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import casadi as ca

from phfmu.declare.entries.parameter_limits import limits
from phfmu.declare.phdae import PHDAE
from phfmu.discretise.model import Model
from phfmu.engine.build.runtime_sources import driver_sources
from phfmu.engine.native.native import NativeInstance
from phfmu.fmu.export.description import ExportedUnit
from phfmu.fmu.export.outward import require_ports, turned
from phfmu.fmu.export.schedule import fed_inside
from phfmu.fmu.export.variables import FMUError, FMUVariable, listed
from phfmu.network.as_unit.composed import ComposedEvents
from phfmu.network.as_unit.embedded import EmbeddedUnit
from phfmu.network.as_unit.landers import Landers, not_landed
from phfmu.network.as_unit.text import SOLVER_FILES, network_files
from phfmu.network.couplings.choice.coupling_choice import NamedCoupling
from phfmu.network.couplings.choice.gathered import COMPOSED
from phfmu.network.couplings.compiled.master import Master
from phfmu.network.couplings.compiled.shares import NativeShare, ShareMaker, own_share
from phfmu.network.couplings.coupled import Coupled
from phfmu.network.couplings.newton import Newton
from phfmu.network.couplings.unconverged import plain
from phfmu.network.members.engine_member import EngineMember
from phfmu.network.members.fmu_member import FMUMember
from phfmu.network.members.member import Member
from phfmu.network.members.rollback import Rollback
from phfmu.network.network import Network
from phfmu.schemes.scheme import Scheme
from phfmu.signals import (
    HAPPENED,
    JUMPED,
    LEDGER,
    MEAN,
    MODE,
    STEP_LEDGER,
    Quantity,
    check_names,
    of_member,
    port_energy,
    quantities,
    total,
)

#: of the master, what a unit of coupled members has not: threads, units of this package as members
OTHER_MASTERS = ("crew.c", "unit.c")
#: and what it has where units of other tools are in it
CALLS = ("unit.h", "unit_call.c", "unit_fmi2.c", "unit_fmi3.c")
#: and where members have state events
LANDING = ("network_landing.c", "network_landing.h")
#: where they land together with all others, and inside their steps
LANDERS, INSIDE = ("network_lander.c", "network_lander.h"), ("member_landing.c", "member_landing.h")
#: where they land as one composed declaration, and what both ways to land together are made of
AS_ONE = tuple(f"{name}.{end}" for name in ("composed_lander", "composed_refusal", "relation") for end in "ch")
LENT = ("lent_network.c", "lent_network.h")
#: blocks of a model -> what of a plan is as long; others are as long as there are components
_LENGTHS = {
    "x": "nx", "a": "na", "a_end": "na", "y_step": "nq", "y_end": "nq", "energy": "nq", "row_pairs": "nq", "parameter": "np",
    "tunable": "np", "mode": "np", "input": "nu", "observables": "nobs",
}  # fmt: skip


#: what the whole tells of all members, also where one that is composed of several has no name
_TOTALS = {total(name) for name, _, _ in (*LEDGER, *STEP_LEDGER)}


@dataclass(frozen=True, eq=False)
class NetworkUnit(ExportedUnit):
    """A network as a unit; `whole`: members and coupling; `models`: of the members, in their order, or of units inside.

    `model` is what is said of the whole where a unit of one model says it of that.  Raises FMUError for what no unit can be.
    """

    whole: Coupled = None  # type: ignore[assignment]
    models: tuple[Model | EmbeddedUnit, ...] = ()

    derives = False
    about = "ph_network", "ph_the_network", "ph_map_network"

    def __post_init__(self) -> None:
        require_ports(self.declaration, self.outward)

    @cached_property
    def master(self) -> Master:
        """The compiled master, whose tables the unit has; it steps members with state events itself."""
        found = self.whole.master
        if self.lands:
            found = self.whole.compiled(_stepped_in_c)
        if reason := self._signals_outside():
            raise FMUError(f"{self.name}: {reason}")
        if found.solver not in SOLVER_FILES:
            raise FMUError(
                f"{self.name}: its coupling, {type(self.whole.coupling).__name__}, is a rule in Python, which a unit has "
                "none of; take --coupling newton, anderson, gauss-seidel or jacobi"
            )
        return found

    def _signals_outside(self) -> str:
        """Why the master does not exchange the signals itself; "" if it does."""
        if not self.whole.signals_held:
            return ""
        if not self.whole.samples_inside:
            return (
                "some of its signals are exchanged at nodes and others held over a step, which a unit does not do; take "
                "--coupling gauss-seidel, which holds all"
            )
        ends = {n for w in self.whole.joined.network.wires for n in (w.source, w.target)}
        if isinstance(plain(self.whole.coupling), Newton) and (
            inside := [m.name for m in self.units if m.name in ends]
        ):
            return (
                f"signals of {', '.join(inside[:4])} would be iterated to agreement, which a unit does not do; take --coupling "
                "gauss-seidel, which extrapolates them"
            )
        return ""

    @property
    def members(self) -> list[tuple[str, Model | EmbeddedUnit]]:
        """Names of the members and what they are."""
        return [(m.name, model) for m, model in zip(self.whole.joined.members, self.models, strict=True)]

    @property
    def named(self) -> list[tuple[str, Model]]:
        """Names and models of those that have one."""
        return [(name, m) for name, m in self.members if not isinstance(m, EmbeddedUnit)]

    @property
    def units(self) -> list[EmbeddedUnit]:
        """Units of other tools inside."""
        return [m for m in self.models if isinstance(m, EmbeddedUnit)]

    @property
    def landing_members(self) -> list[tuple[str, Model]]:
        """Names and models of those with state events."""
        return [(name, m) for name, m in self.named if m.events is not None]

    @property
    def lands(self) -> bool:
        return bool(self.landing_members)

    @property
    def landing(self) -> str:
        functions = "".join(f"    .{n} = fmu_network_{n},\n" for n in ("create", "release", "step"))
        functions += f"    .refused = fmu_{'composed' if self.composed else 'network'}_refused,\n"
        return f"static const fmu_landing landing = {{\n{functions}}};\n"

    @property
    def headers(self) -> tuple[str, ...]:
        found = ("network.h", "network_landing.h") if self.lands else ("network.h",)
        return (*found, "composed_refusal.h") if self.composed else found

    @property
    def saves(self) -> bool:
        return all(m.file.interface.saves for m in self.units)

    @property
    def serialises(self) -> bool:
        return self.saves and all(m.file.interface.serialises for m in self.units)

    @property
    def varies(self) -> bool:
        return not any(m.file.interface.one_step for m in self.units)

    def resources(self, platforms: Sequence[str]) -> dict[str, bytes]:
        return {n: data for m in self.units for n, data in m.files(platforms).items()}

    def texts(self) -> dict[str, str]:
        return network_files(self.whole, self.master, self.models, self.step, self.composed or self.together)

    @cached_property
    def composed(self) -> ComposedEvents | None:
        """The composed declaration that all members land as; None if they do not."""
        if self.whole.switching is None:
            return None
        return ComposedEvents(self.whole, tuple(m for _, m in self.named), self.step)

    @property
    def changes_modes(self) -> bool:
        return self.composed is not None

    @cached_property
    def together(self) -> Landers | None:
        """Members that land together, each by its own guards; None if there are none."""
        if self.composed:
            return None
        members = enumerate(self.whole.joined.members)
        own = [i for i, m in members if isinstance(m, EngineMember) and m.together]
        models = tuple(m for i, m in enumerate(self.models) if i in own and not isinstance(m, EmbeddedUnit))
        names = tuple(self.whole.joined.members[i].name for i in own)
        return Landers(models, tuple(own), names, len(self.models)) if own else None

    @property
    def inside(self) -> bool:
        """Whether some members land inside their own steps."""
        return not self.composed and len(self.landing_members) > len(self.together.members if self.together else ())

    def drivers(self) -> dict[str, Path]:
        found = driver_sources("network/couplings", "network/as_unit")
        own = SOLVER_FILES[self.master.solver]
        others = {
            *OTHER_MASTERS,
            *(() if self.units else (*CALLS, *(name for name in found if name.startswith("embedded")))),
            *(() if self.lands else LANDING),
            *(() if self.together else LANDERS),
            *(() if self.composed else AS_ONE),
            *(() if self.together or self.composed else LENT),
            *(() if self.inside else INSIDE),
            *(name for files in SOLVER_FILES.values() for name in files if name not in own),
        }
        return {name: path for name, path in found.items() if name not in others}

    @property
    def checks(self) -> list[tuple[str, float]]:
        return [
            (of_member(name, n), s)
            for name, m in self.named
            for n, s in zip(check_names(m), m.check_scale, strict=True)
        ]

    @property
    def equations(self) -> list[tuple[str, Sequence[str], Sequence[str]]]:
        junctions = [f"the sum at {n}" for n in self.whole.joined.face.names]
        rows = [
            (name, (), ()) if isinstance(m, EmbeddedUnit) else (name, m.row_names, m.instant_names)
            for name, m in self.members
        ]
        return [*rows, ("junctions", junctions, ())]

    @cached_property
    def variables(self) -> tuple[FMUVariable, ...]:
        """The table; the place of a variable is its value reference."""
        found, limit = [], dict[str, Any]()
        for name, m in self.named:
            limit |= {of_member(name, n): v for n, v in limits(m.declaration).items()}
        for q in self._quantities():
            known = limit.get(q.name.removeprefix(MODE)) if q.block in ("parameter", "tunable", "mode") else None
            found.append((q, known))
        table = listed(self.name, found, self.ledger_outputs, self.tunable, set())
        outward = {of_member(m.name, n) for m in self.units for n in m.outward()}
        table = tuple(replace(v, sign=-v.sign) if v.name in outward else v for v in table)
        return turned(table, [p for p in self.declaration.ports if p.name in self.outward])

    @cached_property
    def jumps(self) -> bool:
        free = [
            (m, s)
            for name, m in self.named
            for v in m.declaration.parameters
            for s, n in zip(ca.vertsplit(v.sx), v.names(), strict=True)
            if v.signal or of_member(name, n) in self.tunable
        ]
        return any(bool(ca.depends_on(m.declaration.hamiltonian, s)) for m, s in free)

    def direct(self, v: FMUVariable) -> bool:
        """Outputs at the present time of a member may change as soon as its own inputs do."""
        return v.block == "PH_Y_END" or (v.depends_on_inputs and v.block != "FMU_JOINED")

    # -- what the members tell ----------------------------------------------------------------------------------------

    def _quantities(self) -> Iterator[Quantity]:
        first = dict.fromkeys((*_LENGTHS, ""), 0)
        yield Quantity("time", "independent", "x", self.model.step.nx, unit="s", description="time")
        for name, m in self.members:
            yield from self._of_member(name, m, first)
            for block, what in _LENGTHS.items():
                first[block] += m.instant.nobs if what == "nobs" else getattr(m.step, what)
            first[""] += m.step.ncomp
        yield from self._totals()
        joined = self.whole.joined
        inputs = {of_member(m.name, n) for m in joined.members for n in m.input_names}
        for i, name in enumerate(joined.face.names):
            if name not in inputs:
                text = "at its junction, mean of the last step"
                yield Quantity(name, "local", "joined", i, 1, None, joined.units[name], description=text)
        yield from self._junctions(self.master.found.columns + first["input"])
        if self.lands:
            yield from self._happened()

    def _of_member(self, name: str, model: Model | EmbeddedUnit, first: dict[str, int]) -> Iterator[Quantity]:
        """Quantities of a member; `first`: its first entry of each block; what junctions and signals feed cannot be set."""
        network = self.whole.joined.network
        ends = {e.port for j in network.junctions for e in j.ends if e.member == name}
        ends |= {w.input.partition("[")[0] for w in network.wires if w.target == name}
        held = {w.input for w in network.wires if w.target == name and (name, w.input) not in self.whole.joined.taken}
        if isinstance(model, EmbeddedUnit):
            joined = [p for p in model.unit.ports if p.name in ends]
            inputs, inner = {n for p in joined for n in p.inputs}, set[str]()
            told = model.quantities(frozenset(p.name for p in joined))
        else:
            fed = [p for p in model.declaration.ports if p.name in ends]
            inputs = {n for p in fed for n in p.input_names()}
            inner = {n for p in fed for e in ("", MEAN) for n in p.output_names(e)} | {port_energy(p.name) for p in fed}
            told = quantities(model)
        modes = set[str]() if isinstance(model, EmbeddedUnit) else {*model.declaration.modes}
        for q in told:
            if q.causality == "independent" or q.name in modes or (not name and q.name in _TOTALS):
                continue
            at = q.first + first[q.block if q.block in _LENGTHS else ""]
            found = replace(q, name=of_member(name, q.name), first=at)
            if q.name in held or q.name.partition("[")[0] in held:
                text = f"{q.description}: signal, held over a step".removeprefix(": ")
                yield replace(found, causality="local", start=None, description=text)
                continue
            if q.name in inputs:
                text = q.description.replace("held over a step", "mean of the last step, given by the junction")
                place = self.master.found.columns + at
                yield replace(found, causality="local", block="joined", first=place, start=None, description=text)
            elif q.name in inner or (q.causality == "output" and q.name.startswith("energy.")):
                yield replace(found, causality="local")
            else:
                yield found

    def _totals(self) -> Iterator[Quantity]:
        n = self.model.step.ncomp
        for name, block, text in LEDGER:
            yield Quantity(total(name), "output", block, 0, n, None, "J", description=text)
        for name, block, text in STEP_LEDGER:
            yield Quantity(total(name), "local", block, 0, n, None, "J", description=text)
        if self.jumps or self.lands:
            name, block, text = JUMPED
            text += ", and by jumps of the states" if self.lands else ""
            yield Quantity(total(name), "output", block, 0, n, None, "J", description=text)

    def _happened(self) -> Iterator[Quantity]:
        """Quantities that state events tell, and the modes that they set."""
        for i, (name, unit, text) in enumerate(HAPPENED):
            yield Quantity(name, "output", "happened", i, 1, None, unit, description=text)
        first = 0
        for member, m in self.members:
            if not isinstance(m, EmbeddedUnit):
                names = [n for v in m.declaration.parameters for n in v.names()]
                for mode in m.declaration.modes:
                    own, i = of_member(member, mode), names.index(mode)
                    text = f"mode {own}, set by state events"
                    yield Quantity(MODE + own, "local", "mode", first + i, 1, float(m.p0[i]), description=text)
            first += m.step.np

    def _junctions(self, first: int) -> Iterator[Quantity]:
        """Energies made there."""
        own = [j.name for j in self.whole.joined.network.junctions]
        n, what = len(own), "energy made at the junction, that its ports give to the members together"
        for i, name in enumerate(own):
            yield Quantity(
                f"{name}.energy_step",
                "local",
                "joined",
                first + i,
                1,
                None,
                "J",
                description=f"{what}, in the last step",
            )
            yield Quantity(
                f"{name}.energy", "local", "joined", first + n + i, 1, None, "J", description=f"{what}, since the start"
            )
        text = "sizes of the energies made at all junctions in all steps since the start, added"
        if n:
            yield Quantity("energy.junctions", "output", "joined", first + 2 * n, 1, None, "J", description=text)


def network_unit(
    network: Network, coupling: NamedCoupling, whole: Coupled, models: Sequence[Model | EmbeddedUnit], **options: Any
) -> NetworkUnit:
    """The unit of a network whose members are coupled as in `whole`; `options`: of `ExportedUnit`."""
    joined = {e for j in network.junctions for e in j.ends}
    ports = [
        replace(p, name=of_member(name, p.name), start=p.start)
        for name, d in network.declared.items()
        for p in d.ports
        if p.external and not any(e.member == name and e.port == p.name for e in joined)
    ]
    modes = tuple(of_member(name, n) for name, d in network.declared.items() for n in d.modes)
    declaration = SimpleNamespace(name=network.name, description=network.description, ports=ports, modes=modes)
    plan = SimpleNamespace(
        nx=sum(m.step.nx for m in models), na=sum(m.step.na for m in models), nu=sum(m.step.nu for m in models),
        ncomp=sum(m.step.ncomp for m in models), k=1,
    )  # fmt: skip
    own = [m for m in models if not isinstance(m, EmbeddedUnit)]
    order = max((m.scheme.order for m in own), default=coupling.order) if coupling.nodes else coupling.order
    scheme = SimpleNamespace(name=f"{coupling.words} of members", order=order)
    model: Any = SimpleNamespace(
        declaration=declaration, step=plan, t0=own[0].t0 if own else 0.0, scheme=scheme, events=None, modes=None
    )
    return NetworkUnit(model=model, whole=whole, models=tuple(models), **options)


def _stepped_in_c(member: Member) -> ShareMaker:
    """The share of a member in a unit."""
    native = isinstance(member, EngineMember) and isinstance(member.instance, NativeInstance)
    return NativeShare if native else own_share(member)


def coupled_members(
    network: Network, coupling: NamedCoupling, schemes: Mapping[str, Scheme], step: float, found: Mapping[str, Rollback]
) -> tuple[Coupled, list[Model | EmbeddedUnit]]:
    """The members of a network, native ones of their schemes and units of other tools, under a coupling, and what they are.

    `found`: whether the units take steps of this length back, where the coupling asks that of them.
    Errors: FMUError; ValueError where outputs do not give the junctions their values, as couplings in turn need.
    """
    from phfmu.discretise.model import build_model
    from phfmu.engine.switched import stepped
    from phfmu.fmu.export.value_groups import telling_constant
    from phfmu.network.couplings.choice.partitioned_network import PartitionedNetwork
    from phfmu.network.members.engine_member import EngineMember
    from phfmu.network.members.unit_member import unit_member

    if stuck := [f"{n} {r.words}" for n, r in found.items() if not r.works]:
        raise FMUError(
            f"{network.name}: {'; '.join(stuck)}: it would be stepped last, against a prediction, which a unit does not do; "
            "take --coupling gauss-seidel, or a shorter step"
        )
    if not coupling.nodes and (some := [n for n, d in network.declared.items() if d.switches]):
        raise FMUError(
            f"{network.name}: {', '.join(some[:4])} have ideal switches, which only --coupling newton lands on inside a unit; "
            "take that, or export it composed, without --as-unit"
        )
    separate = network.separate(
        PartitionedNetwork(network).holding(lambda name: coupling.nodes and schemes[name].node_values)
    )
    models, members = list[Model | EmbeddedUnit](), list[Any]()
    for name, member in network.members.items():
        if isinstance(member, PHDAE):
            model = telling_constant(build_model(separate[name], schemes[name]))
            members.append(EngineMember(name, model, stepped(model, NativeInstance)))
            models.append(model)
        else:
            unit, _ = unit_member(name, member, step, found.get(name))
            assert isinstance(unit, FMUMember)
            members.append(unit)
            models.append(EmbeddedUnit(unit, member))
    try:
        whole = Coupled(network, members, coupling.make)
    except ValueError as error:
        if not any(d.switches for d in network.declared.values()):
            raise
        raise FMUError(f"{network.name}: {error}; composed, it is exported without --as-unit") from None
    if reason := not_landed(whole):
        raise FMUError(f"{network.name}: {reason}; export it composed, without --as-unit")
    if some := whole.across():
        raise FMUError(
            f"{network.name}: the jumps of {', '.join(some[:4])} move what other members share, and no impulse reaches these "
            "inside the step of one; export it composed, without --as-unit"
        )
    if whole.switching is not None and whole.switching.model.modes is not None:
        whole.switching.in_mode(whole.switching.model.modes.modes.start)
    whole.check_start()
    if not whole.solves_rows:  # whether outputs give the junctions their values
        whole.prepare(0.0, step)
    return whole, models


def with_fed_inside(network: Network, names: Sequence[str]) -> Network:
    """The network with free ports of members fed by parameters that are called like their inputs, those among `names`."""
    own: dict[str, list[str]] = {}
    for name in names:
        member, _, rest = name.partition(".")
        member, rest = (member, rest) if member in network.members else (COMPOSED, name)
        own.setdefault(member, []).append(rest)
    members = {n: fed_inside(d, own[n]) if n in own and isinstance(d, PHDAE) else d for n, d in network.members.items()}
    return replace(network, members=members)
