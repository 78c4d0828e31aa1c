"""Units at their limits: units of other tools that lie, and units of this package under another tool's master."""

from __future__ import annotations

import tempfile
import zipfile
from contextlib import ExitStack
from dataclasses import replace
from functools import cache
from pathlib import Path
from typing import Any

import numpy as np

from phfmu.studies.stress.case import StressCase, StressOutcome, refused
from phfmu.studies.stress.members.couplings import left, oscillator, run

#: what the unit of liar.c does
HONEST, FORGETS, NOT_A_NUMBER, CHANCE, CHANCE_LATE, DRIFTS, DERIVATIVES = range(7)

_DESCRIPTION = """<?xml version="1.0" encoding="UTF-8"?>
<fmiModelDescription fmiVersion="2.0" modelName="liar" guid="1"><CoSimulation modelIdentifier="liar"
canHandleVariableCommunicationStepSize="true" canGetAndSetFMUstate="true" providesDirectionalDerivative="true"/>
<UnitDefinitions><Unit name="N"><BaseUnit kg="1" m="1" s="-2"/></Unit><Unit name="m/s"><BaseUnit m="1" s="-1"/></Unit>
<Unit name="kg"><BaseUnit kg="1"/></Unit><Unit name="kN"><BaseUnit kg="1" m="1" s="-2" factor="1000"/></Unit></UnitDefinitions>
<ModelVariables>
<ScalarVariable name="F" valueReference="1" causality="input"><Real start="0" unit="{force}"/></ScalarVariable>
<ScalarVariable name="v" valueReference="2" causality="output"><Real unit="m/s"/></ScalarVariable>
<ScalarVariable name="q" valueReference="3" causality="output" initial="exact"><Real start="0"/></ScalarVariable>
<ScalarVariable name="m" valueReference="4" causality="parameter"><Real start="1" unit="kg"/></ScalarVariable>
<ScalarVariable name="k" valueReference="5" causality="parameter"><Real start="0"/></ScalarVariable>
<ScalarVariable name="lie" valueReference="6" causality="parameter" variability="fixed"><Integer start="0"/></ScalarVariable>
</ModelVariables><ModelStructure/></fmiModelDescription>
"""


@cache
def _folder() -> tempfile.TemporaryDirectory[str]:
    """Folder of units that live as long as this process."""
    return tempfile.TemporaryDirectory(prefix="phfmu-stress-")


@cache
def liar(force: str = "N") -> Path:
    """The unit of liar.c, for this machine; `force`: the unit of its force."""
    import fmpy

    from phfmu.engine.build.compile import compile
    from phfmu.fmu.export.sources import headers

    code = Path(__file__).parent / "liar.c"
    library = compile({code.name: code, **headers()}).path.read_bytes()
    path = Path(_folder().name) / f"liar_{force}.fmu"
    with zipfile.ZipFile(path, "w") as out:
        out.writestr("modelDescription.xml", _DESCRIPTION.format(force=force))
        out.writestr(f"binaries/{fmpy.platform}/liar{fmpy.sharedLibraryExtension}", library)
    return path


def scene(lie: int, force: str = "N", mass: float = 1.0) -> Any:
    """The liar and a cart of 2 kg on a spring that is stretched."""
    from phfmu import Network
    from phfmu.components.mechanical import translational as mechanical

    net = Network("lied_to")
    net.add("pump", liar(force), ports={"flange": {"effort": "F", "flow": "v", "sign": 1}})
    net.members["pump"] = net.units["pump"].with_starts({"lie": lie, "m": mass})
    net.add("cart", mechanical.mass(2.0, q=0.3))
    net.add("spring", mechanical.spring(40.0, elongation=0.3))
    net.junction("a", ["pump.flange", "spring.a"])
    net.junction("b", ["cart.flange", "spring.b"])
    return net


def lied_to(lie: int, force: str = "N", mass: float = 1.0, h: float = 0.01) -> tuple[Any, list[str]]:
    """The result of 0.5 s, and what is told before."""
    from phfmu.network.couplings.coupled import Coupled
    from phfmu.network.members.engine_member import EngineMember
    from phfmu.network.members.unit_member import tried, unit_member
    from phfmu.studies.stress.drive import instance

    net = scene(lie, force, mass)
    pump, told = unit_member("pump", net.units["pump"], h, tried(net.units, h)["pump"])
    units = {n: instance(replace(d, name=n)) for n, d in net.declared.items()}
    members: list[Any] = [pump, *(EngineMember(n, u.model, u) for n, u in units.items())]
    return run(Coupled(net, members), 0.5, h), told


def apart(one: Any, two: Any) -> float:
    return max(float(np.abs(one.column(n) - two.column(n)).max()) for n in ("pump.v", "cart.v", "spring.e"))


def named(lie: int) -> StressOutcome:
    """A lie that a trial before the run finds: the unit is stepped last, what that misses is booked."""
    result, told = lied_to(lie)
    line = next((t for t in told if t.startswith("pump: does not restore its state")), "")
    off = apart(result, lied_to(HONEST)[0])
    s = result.ledger.summary()
    estimated = next(c for c in s.components if c.component == "pump").verdict != "closed"
    return StressOutcome(
        f"{line or 'not told'}; {off:.1e} from the honest run, unexplained {left(s):.1e}",
        "stepped last" in line and left(s) <= 1e-12 and estimated,
    )


def believed(lie: int) -> StressOutcome:
    """A lie about what nobody asks a unit of another tool for."""
    result, told = lied_to(lie)
    off = apart(result, lied_to(HONEST)[0])
    return StressOutcome(f"{off:.1e} from the honest run, {len(told)} lines told", off == 0.0 and not told)


def found_out(lie: int, *words: str) -> StressOutcome:
    """A lie that begins in the run: it ends with the unit's name."""
    from phfmu import StepFailure

    return refused(lambda: lied_to(lie), StepFailure, "pump", *words)


def converted() -> StressOutcome:
    """A force of 1 kN that the unit takes for 1 moves a mass of 1 as 1 N moves one of 1 g."""
    off = apart(lied_to(HONEST, "kN", 1e-3)[0], lied_to(HONEST)[0])
    return StressOutcome(f"{off:.1e} from the same unit in N", off <= 1e-11)


def unfit() -> StressOutcome:
    """An effort in kg is none: power would not be in W."""
    from phfmu.fmu.export.variables import FMUError

    found = refused(lambda: scene(HONEST, "kg"), FMUError, "effort F in kg")
    return replace(found, happened=found.happened.replace(f"{_folder().name}/", ""))


def elsewhere(h: float, version: str, growth: float) -> StressOutcome:
    """The scene `oscillator` as units under a plain Jacobi loop: values of the last instant, the factor -1 on forces.

    growth: of the energy in 1 s, in units of H0, as an implicit midpoint rule by hand under such a loop has it.
    """
    from phfmu.discretise.model import build_model
    from phfmu.fmu.export.export import export
    from phfmu.fmu.importer.reader import FMUInstance
    from phfmu.network.couplings.jacobi import Jacobi
    from phfmu.studies.stress.members.couplings import coupled

    net, stop = oscillator(), 1.0
    with ExitStack() as stack:
        folder = stack.enter_context(tempfile.TemporaryDirectory())
        units = {
            n: stack.enter_context(FMUInstance(export(build_model(replace(d, name=n)), folder, (version,), step=h)[0]))
            for n, d in net.declared.items()
        }
        start, junctions = {n: float(u.energies()[0]) for n, u in units.items()}, 0.0
        for k in range(round(stop / h)):
            _exchange(net, units)
            for u in units.values():
                u.do_step(k * h, h)
            junctions += sum(float(u.ledger()["pairs"].sum()) for u in units.values())
        H = {n: float(u.energies()[0]) for n, u in units.items()}
        worst = max(abs(float(u.get(["energy.residual"])[0])) / max(H[n], start[n], 1e-300) for n, u in units.items())
        gap = max(abs(u.gap() or 0.0) / max(H[n], start[n], 1e-300) for n, u in units.items())
    made, H0 = sum(H.values()) - sum(start.values()), sum(start.values())
    ours = run(coupled(net, Jacobi()), stop, h).ledger.summary()
    ratio = made / sum(j.residual for j in ours.junctions)
    return StressOutcome(
        f"energy grew by {made / H0:.3g} H0, all of it made by the connections ({abs(made - junctions) / abs(made):.1e} left); "
        f"residual of a unit {worst:.1e} of its energy, gap {gap:.1e}; {ratio:.6f} of --coupling jacobi",
        max(worst, gap) <= 1e-12
        and abs(made - junctions) <= 1e-11 * abs(made)
        and abs(ratio - 1) <= 1e-9
        and abs(made / H0 / growth - 1) <= 0.03,
    )


def _exchange(net: Any, units: dict[str, Any]) -> None:
    """Each input is an output of the other end of its junction, a force with the factor -1."""
    y = {n: u.end_output() for n, u in units.items()}
    place = {n: [p.name for p in net.members[n].ports if p.external] for n in units}
    u = {n: np.zeros(len(place[n])) for n in units}
    for j in net.junctions:
        for end in j.ends:
            (other,) = (e for e in j.ends if e is not end)
            value = y[other.member][place[other.member].index(other.port)]
            sign = -1.0 if net.port_of(end).given == "effort" else 1.0
            u[end.member][place[end.member].index(end.port)] = sign * value
    for n, unit in units.items():
        unit.set_input(u[n])


def struck() -> StressOutcome:
    """An impulse of 3 N s on 2 kg that moves: the jump of its speed, and the work J (v- + v+) / 2."""
    from phfmu.components.mechanical.translational import mass
    from phfmu.studies.stress.drive import instance

    unit = instance(mass(2.0, v=0.5))
    unit.set_impulses([3.0], [0.0])
    unit.do_step(0.0, 0.1)
    v, work = float(unit.x[1]), float(unit.ledger()["pairs"][0])
    return StressOutcome(f"v = {v:.17g} m/s, work {work:.17g} J", abs(v - 2.0) <= 1e-15 and abs(work - 3.75) <= 1e-14)


CASES = (
    StressCase("units", "a unit that restores its state in part", "named, stepped last; unexplained <= 1e-12, never closed",
               lambda: named(FORGETS)),
    StressCase("units", "a unit that takes another step every time", "named, stepped last; unexplained <= 1e-12, never closed",
               lambda: named(CHANCE)),
    StressCase("units", "outputs that change without an input", "named, stepped last; unexplained <= 1e-12, never closed",
               lambda: named(DRIFTS)),
    StressCase("units", "steps that do not repeat, from 0.25 s on", "ends with the name of the unit; no shorter step is advised",
               lambda: found_out(CHANCE_LATE, "does not restore its state", "--coupling gauss-seidel")),
    StressCase("units", "an output that is not a number, from 0.25 s on", "ends with the names of unit and output",
               lambda: found_out(NOT_A_NUMBER, "'v' = nan")),
    StressCase("units", "directional derivatives that are wrong", "not asked for: the bits of the honest unit",
               lambda: believed(DERIVATIVES)),
    StressCase("units", "a force in kN", "converted: 1e-11", converted),
    StressCase("units", "a force in kg", "refused with variable and unit", unfit),
    *(StressCase("units", f"another master, plain Jacobi, FMI {v}, h = {h:g} s",
                 f"units close to 1e-12; the connections make all energy, {g:g} H0 to 3 %, as --coupling jacobi does to 1e-9",
                 lambda v=v, h=h, g=g: elsewhere(h, v, g)) for v, h, g in (("2.0", 0.01, 19.0), ("3.0", 0.04, 2.2e4))),
    StressCase("struck", "an impulse on a mass", "jump J / m, work J (v- + v+) / 2", struck),
)  # fmt: skip
