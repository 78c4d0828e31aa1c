"""Options of stepping: the engine, kernels and internal steps of each declared member of a network, its coupling and units.

The engine that steps a model: Python, native, or a unit that is exported for the run.
"""

from __future__ import annotations

import argparse
import sys
from collections.abc import Collection, Mapping, Sequence
from dataclasses import dataclass, replace
from math import inf
from typing import TYPE_CHECKING, Any

from phfmu.words import meant

if TYPE_CHECKING:
    from phfmu.declare.phdae import PHDAE
    from phfmu.network.couplings.signals.sampled_signals import SignalExchange
    from phfmu.network.network import Network


ENGINES = ("auto", "python", "native", "fmu")
#: how the native engine runs kernels
KERNELS = ("auto", "compiled", "interpreted")


def add_engine(parser: argparse.ArgumentParser, engines: Sequence[str]) -> None:
    """--engine, one of `engines`."""
    parser.add_argument("--engine", default="auto", choices=engines,
                        help="native: compiled, whose kernels need no compiler; python: the readable reference, which lands on "
                        "no state events or switches; auto (default): native if the runtime is there or can be compiled, else "
                        "python")  # fmt: skip


def add_stepping(parser: argparse.ArgumentParser) -> None:
    """--kernels, --member, --parts, --threads."""
    parser.add_argument("--kernels", default="auto", choices=KERNELS,
                        help="how the native engine works out the functions of a model, with the same bits: compiled, "
                        "interpreted, or auto: compiled if the cache has them, else interpreted at once, with the compiler "
                        "beside a run that is long enough to earn it")  # fmt: skip
    parser.add_argument("--member", action="append", default=[], metavar="NAME=ENGINE",
                        help="the engine of one member of a network that is stepped apart; may be repeated")  # fmt: skip
    parser.add_argument("--parts", action="append", default=[], metavar="NAME=N",
                        help="internal steps that a member takes in each communication step; may be repeated")  # fmt: skip
    parser.add_argument("--threads", type=int, metavar="N",
                        help="threads that step the native members of a network; results do not depend on it (default: as many "
                             "as pay)")  # fmt: skip


def add_coupling(parser: argparse.ArgumentParser) -> None:
    """--coupling, --sequence, --unconverged, --signals-held."""
    from phfmu.network.couplings.coupling_table import AUTO, COUPLINGS

    lines = [f"{row.name}: {row.about}" for row in COUPLINGS.values()]
    parser.add_argument("--coupling", choices=tuple(COUPLINGS), help="; ".join(lines) + f" (default: {AUTO.name})")
    in_turn = ", ".join(row.name for row in COUPLINGS.values() if row.in_turn)
    parser.add_argument(
        "--sequence", metavar="A,B,..", help=f"the order in which --coupling {in_turn} steps the members"
    )
    parser.add_argument("--unconverged", default="raise", choices=("raise", "halve", "accept"),
                        help="what to do with a step whose coupling does not converge: refuse it (default), take it in "
                        "halves, or keep the best trial, with what its junctions make of energy booked")  # fmt: skip
    parser.add_argument("--signals-held", action="store_true",
                        help="hold signals between members over a step as they are at its start (order 1), not on the line "
                        "through two samples (order 2); --coupling newton iterates those of units that go back")  # fmt: skip


def add_units(parser: argparse.ArgumentParser) -> None:
    """--isolate, --isolate-timeout, --unit-tolerance."""
    parser.add_argument("--isolate", action="store_true",
                        help="FMUs in processes of their own: where one ends or hangs, the run has exit code 3")  # fmt: skip
    parser.add_argument("--isolate-timeout", type=float, metavar="SECONDS",
                        help="the same, and how long a call into an FMU may take (default 60)")  # fmt: skip
    parser.add_argument("--unit-tolerance", type=float, metavar="TOL",
                        help="relative tolerance that FMUs are told of for steps inside them (default: their own)")  # fmt: skip


@dataclass(frozen=True)
class Stepping:
    """Engines and internal steps of members that are stepped apart.

    engines, parts: by member, where they differ from `engine` and 1
    """

    engine: str
    engines: Mapping[str, str]
    parts: Mapping[str, int]

    def engine_of(self, name: str) -> str:
        return self.engines.get(name, self.engine)

    def parts_of(self, name: str) -> int:
        return self.parts.get(name, 1)

    @property
    def words(self) -> str:
        """For the head line of a run."""
        said = [f"{name}: {engine}" for name, engine in self.engines.items() if engine != self.engine]
        said += [f"{name}: {n} steps in each" for name, n in self.parts.items() if n > 1]
        return f"{self.engine} engine" + (f" ({', '.join(said)})" if said else "")


def asked_apart(args: argparse.Namespace) -> bool:
    """Whether members are to be stepped in ways of their own, so that they cannot be one model."""
    return bool(args.member or args.parts)


def engines_asked(args: argparse.Namespace, network: Network) -> dict[str, str]:
    """Engines of members by --member; raises ValueError for a name that is no member, and for no engine."""
    found = _pairs(args.member, "--member", "ENGINE", network)
    for name, engine in found.items():
        if engine not in ENGINES:
            raise ValueError(f"--member {name}={engine}: no such engine; {meant(engine, ENGINES)}")
    return found


def parts_asked(args: argparse.Namespace, network: Network) -> dict[str, int]:
    """Internal steps of members by --parts; raises ValueError for a name that is no member, and for no positive number."""
    out = {}
    for name, text in _pairs(args.parts, "--parts", "N", network).items():
        if not (text.isdecimal() and int(text) > 0):
            raise ValueError(f"--parts {name}={text}: expected a number of internal steps from 1")
        out[name] = int(text)
    return out


def threads_asked(args: argparse.Namespace) -> int | None:
    """Threads by --threads, None: as many as pay; raises ValueError below one."""
    if args.threads is not None and args.threads < 1:
        raise ValueError(f"--threads {args.threads}: expected a number of threads from 1")
    return args.threads


#: s that a call into a unit in a process of its own may take, unless told
ISOLATE = 60.0


def isolate_of(args: argparse.Namespace) -> float | None:
    """s that a call into a unit in a process of its own may take; None: units run in this process."""
    seconds = args.isolate_timeout
    if seconds is not None and not seconds > 0:
        raise ValueError(f"--isolate-timeout {seconds:g} s must be positive")
    return ISOLATE if seconds is None and args.isolate else seconds


def tolerance_of(args: argparse.Namespace) -> float | None:
    """The relative tolerance that units are told of; None: their own."""
    value = args.unit_tolerance
    if value is not None and not 0 < value < inf:
        raise ValueError(f"--unit-tolerance {value:g}: expected a positive number, e.g. 1e-6")
    return value


def with_unit_options(args: argparse.Namespace, system: Any) -> Any:
    """The system with its units in processes of their own, or with a tolerance, if that is asked for."""
    from phfmu.network.network import Network

    seconds, tolerance = isolate_of(args), tolerance_of(args)
    if seconds is None and tolerance is None:
        return system
    if not isinstance(system, Network) or not system.units:
        option = "--isolate" if tolerance is None else "--unit-tolerance"
        raise ValueError(f"{args.target}: {option} is for FMUs, and there is none in it")
    own = {n: replace(file, isolate=seconds, tolerance=tolerance) for n, file in system.units.items()}
    return replace(system, members={n: own.get(n, m) for n, m in system.members.items()})


#: the course of signals over a step, in words of the head line
SIGNAL_WORDS: dict[SignalExchange, str] = {
    "extrapolated": "",
    "held": ", signals held",
    "agreed-or-extrapolated": ", signals iterated",
    "agreed": ", signals iterated",
}


def signals_asked(
    args: argparse.Namespace, network: Network, stuck: Sequence[str], held: bool, circling: Sequence[str]
) -> tuple[SignalExchange, list[str]]:
    """The course of signals over a step if some are `held`, and notes about it: `stuck` units cannot take steps back.

    Signals are iterated where that is asked for, and where those of `circling` units come back to them.
    ValueError where they are to be held and there are none.
    """
    from phfmu.network.couplings.coupling_table import NEWTON

    if args.signals_held and not held:
        raise ValueError(
            f"{args.target}: --signals-held is for signals that members hold over steps, and there are none"
        )
    if args.signals_held:
        return "held", []
    ends = {end for w in network.wires for end in (w.source, w.target)}
    asked = args.coupling == NEWTON.name and held and ends & set(network.units)
    if not asked and circling and not stuck:
        return "agreed-or-extrapolated", [
            f"signals of {', '.join(circling)} come back to them: they are iterated (--signals-held holds them over steps)"
        ]
    if not asked:
        return "extrapolated", []
    if stuck:
        return "extrapolated", [f"signals are not iterated: {', '.join(stuck)} cannot take steps back"]
    return "agreed", []


def _pairs(items: list[str], option: str, what: str, network: Network) -> dict[str, str]:
    out: dict[str, str] = {}
    for item in items:
        name, sign, value = (part.strip() for part in item.partition("="))
        if not sign or not value:
            raise ValueError(f"{option} {item}: expected NAME={what}")
        if name in network.units:
            raise ValueError(f"{option} {item}: {name} is an FMU, whose method is compiled in")
        if name not in network.members:
            raise ValueError(f"{option} {item}: {network.name} has no member '{name}'; {meant(name, network.members)}")
        if name in out:
            raise ValueError(f"{option} {item}: there is {option} {name}={out[name]} already")
        out[name] = value
    return out


def engine_of(engine: str) -> str:
    """`auto` resolved: native if a compiler is found, or what one left in the cache, else python, which is said on stderr."""
    if engine != "auto":
        return engine
    from phfmu.engine.build.compile import CompilerMissing
    from phfmu.engine.native.library import require_runtime

    try:
        require_runtime()
    except CompilerMissing as error:
        print(f"phfmu: no C compiler ({error}); using the Python engine", file=sys.stderr)
        return "python"
    return "native"


def instance_of(model: Any, engine: str, kernels: Any = "auto", steps: float = 0) -> Any:
    """A Python or native instance of a discretised model; `steps`: about as many as it will take."""
    if engine == "python":
        from phfmu.engine.model import require_no_landing
        from phfmu.engine.reference.python import PythonInstance

        require_no_landing(model)
        return PythonInstance(model)
    from phfmu.engine.native.native import NativeInstance
    from phfmu.engine.switched import stepped

    return stepped(model, lambda m: NativeInstance(m, _announce, kernels, steps))


def kernels_asked(args: argparse.Namespace, engines: Collection[str]) -> str:
    """Way to run kernels by --kernels; raises ValueError where no engine that is asked for has a choice."""
    kernels = getattr(args, "kernels", "auto")
    if kernels != "auto" and "native" not in engines:
        raise ValueError(f"--kernels {kernels} is for the native engine, here it is {' and '.join(sorted(engines))}")
    return kernels


class KernelReport:
    """Words of a run about its kernels, interpreted or compiled, which may change in it."""

    def __init__(self) -> None:
        self._instances: list[Any] = []
        self._first = ""

    def of(self, instance: Any) -> Any:
        """The instance, which is one of these from now on."""
        self._instances.append(instance)
        return instance

    @property
    def words(self) -> str:
        """For the end of a head line; nothing where no instance is native."""
        found = {k for i in self._instances if (k := getattr(i, "kernels", None)) is not None}
        now = " and ".join(sorted(found))
        self._first = self._first or now
        said = now if now == self._first else f"{self._first}, then {now}"
        return f", kernels {said}" if said else ""


def _announce() -> None:
    """The first run of a set of equations on a machine waits for the compiler; say so on a terminal."""
    if sys.stderr.isatty():
        print("phfmu: compiling for this machine, once (--engine python runs without)", file=sys.stderr)


def as_fmu(
    declaration: PHDAE,
    scheme: Any,
    fmi: str | None,
    step: float,
    node_inputs: bool = False,
    impulses: bool = False,
) -> Any:
    """The declaration exported to a temporary folder and loaded again."""
    import atexit
    import shutil
    import tempfile

    from phfmu.discretise.model import build_model
    from phfmu.fmu.export.export import export
    from phfmu.fmu.importer.reader import FMUInstance
    from phfmu.fmu.version import LATEST

    folder = tempfile.mkdtemp(prefix="phfmu-")
    atexit.register(shutil.rmtree, folder, ignore_errors=True)
    model, versions = build_model(declaration, scheme), (fmi or LATEST,)
    modes = {*model.declaration.modes}  # which state events set, inside the unit
    tunable = [n for v in declaration.parameters if not v.signal for n in v.names() if n not in modes]
    (path,) = export(
        model, folder, versions, step=step, node_inputs=node_inputs, impulses=impulses, tunable=tunable
    )  # fmt: skip
    return FMUInstance(path)
