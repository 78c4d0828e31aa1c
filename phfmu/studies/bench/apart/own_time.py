"""Time of members apart: in their own functions, and in what joins them; told by the compiled loop itself."""

from __future__ import annotations

from dataclasses import dataclass, replace
from pathlib import Path
from tempfile import TemporaryDirectory
from time import perf_counter
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from phfmu.declare.phdae import PHDAE
    from phfmu.fmu.importer.reader import FMUInstance
    from phfmu.network.couplings.coupled import Coupled
    from phfmu.network.couplings.coupling import Coupling
    from phfmu.network.network import Network

ROUNDS = 30  # turns, of which the shortest counts: what else the machine does makes none shorter
WARM, STEPS = 20, 100  # steps before, and of a turn


@dataclass(frozen=True)
class OwnTime:
    """Time per member and step in us.

    steps: in steps and derivatives of the members;  exchange: in their functions that save, load, set and read;
    join: rows, matrix and records;  solve: of the interface and the impulses;  readings: of the clock that tells these, which
    runs do without;  columns: in Python, of all rows together
    """

    steps: float
    exchange: float
    join: float
    solve: float
    readings: float
    columns: float

    @property
    def own(self) -> float:
        """All that the members' steps and derivatives are not, nor the clock."""
        return self.exchange + self.join + self.solve + self.columns


def own_time(stepper: Coupled, h: float) -> OwnTime:
    """The times of members that the compiled master steps itself, by one thread; RuntimeError if it calls some back."""
    from phfmu.network.couplings.compiled.master import PARTS

    if stepper.master.calls:
        raise RuntimeError(f"members of {stepper.joined.network.name} are stepped in Python")
    spent, turns = stepper.master.timed(), list[tuple[float, list[float]]]()
    stepper.check_start()
    stepper.prepare(0.0, h)
    stepper.advance(0.0, h, WARM)
    for turn in range(ROUNDS):
        spent[:] = 0.0
        before = perf_counter()
        stepper.advance(0.0, h, STEPS, WARM + turn * STEPS)
        whole = perf_counter() - before
        turns.append((whole, [*spent.tolist(), whole - float(spent.sum())]))
    scale = 1e6 / (STEPS * len(stepper.joined.members))
    return OwnTime(**{name: scale * value for name, value in zip((*PARTS, "columns"), min(turns)[1], strict=True)})


def native(network: Network, k: int, h: float, coupling: Coupling | None = None) -> OwnTime:
    """The times of native members, by default at nodes."""
    from phfmu.studies.bench.apart.networks import instances, joined, planned

    return own_time(joined(network, instances(planned(network, k)), coupling=coupling), h)


def units(network: Network, k: int, h: float, version: str = "3.0") -> OwnTime:
    """The times of members exported as FMUs of order 2k, with inputs at nodes and impulses, where they take any."""
    from phfmu.network.couplings.coupled import Coupled
    from phfmu.network.members.fmu_member import FMUMember

    with TemporaryDirectory() as folder:
        declared = {n: replace(d, name=n) for n, d in network.declared.items()}
        members = [FMUMember(n, exported(d, Path(folder), k, h, version)) for n, d in declared.items()]
        try:
            return own_time(Coupled(network, [*members], threads=1), h)
        finally:
            for m in members:
                m.unit.close()


def exported(declaration: PHDAE, folder: Path, k: int, h: float, version: str = "3.0") -> FMUInstance:
    """A member as a unit with all that members apart take."""
    from phfmu.discretise.model import build_model
    from phfmu.fmu.export.export import export
    from phfmu.fmu.export.value_groups import kernels_of
    from phfmu.fmu.importer.reader import FMUInstance
    from phfmu.schemes.collocated import Collocated

    model = build_model(declaration, Collocated(k))
    kicked = k > 1 and bool(kernels_of(model))
    (path,) = export(model, folder, (version,), step=h, node_inputs=k > 1, impulses=kicked)
    return FMUInstance(path)
