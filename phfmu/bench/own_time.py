"""What joining members costs beside their own calls: of native members, whose steps go in compiled code, and of FMUs."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace
from functools import partial
from pathlib import Path
from statistics import median
from tempfile import TemporaryDirectory
from time import thread_time
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from phfmu.declare.phdae import PHDAE
    from phfmu.engine.native import NativeInstance
    from phfmu.fmu.reader import FMUInstance
    from phfmu.network.couplings.stepper import Stepper
    from phfmu.network.junctions.network import Network
    from phfmu.network.members.engine_member import EngineMember

ROUNDS = 9  # turns that a median is of
CALLS, FEW = 500, 10  # of a member's step or sensitivity in a turn; steps from one state
FMU_STEPS = 20  # of a turn


@dataclass(frozen=True)
class OwnTime:
    """CPU time per member and step in us: `calls` in the members' own functions, `own` of all else that a step apart is."""

    calls: float
    own: float


def native(members: list[EngineMember], h: float, apart: float, trials: float) -> OwnTime:
    """Of native members of which a step apart takes `apart` us: as many trials as it takes, and one sensitivity each.

    Steps from where the members are, timed in compiled code, without records.
    """
    from phfmu.engine.native import NativeInstance

    calls = 0.0
    for m in members:
        alone = NativeInstance(m.model)  # without impulses
        state = m.get_state()[: alone.handle.state_size]
        calls += trials * _median(partial(_steps, alone, state, h)) / CALLS + _sensitivity(alone, h)
    return OwnTime(calls / len(members), (apart - calls) / len(members))


def _steps(instance: NativeInstance, state: bytes, h: float) -> None:
    for _ in range(CALLS // FEW):
        instance.set_state(state)
        instance.run(instance.time, h, FEW, record=())


def _sensitivity(instance: NativeInstance, h: float) -> float:
    """dY/dU of a step (us), less what calling it from Python costs."""
    import numpy as np

    instance.do_step(instance.time, h)
    handle, out = instance.handle, np.empty((instance.model.step.nu,) * 2)
    spent = {}
    for name, arguments in {
        "ph_sensitivity": (handle.instance, out.ctypes.data),
        "ph_solves": (handle.instance,),
    }.items():
        spent[name] = _median(partial(_repeated, getattr(handle.lib, name), arguments)) / CALLS
    return max(spent["ph_sensitivity"] - spent["ph_solves"], 0.0)


def _repeated(function: Callable[..., Any], arguments: tuple[Any, ...]) -> None:
    for _ in range(CALLS):
        function(*arguments)


def _median(turn: Callable[[], None]) -> float:
    """CPU time of a turn in us."""
    times = []
    for _ in range(ROUNDS):
        before = thread_time()
        turn()
        times.append(1e6 * (thread_time() - before))
    return median(times)


class _Clock:
    """CPU time in s that was spent in the functions of some libraries."""

    def __init__(self) -> None:
        self.spent = 0.0

    def watch(self, slave: Any) -> None:
        """The functions of its library, for the bindings and for those who call them directly."""
        slave._functions.clear()
        for name, function in slave.fmu._functions.items():
            timed = self._around(function)
            slave.fmu._functions[name] = timed
            setattr(slave.fmu.dll, name, timed)

    def _around(self, function: Any) -> Any:

        def timed(*arguments: Any) -> Any:
            before = thread_time()
            try:
                return function(*arguments)
            finally:
                self.spent += thread_time() - before

        timed.__name__, timed.restype = function.__name__, function.restype  # pyright: ignore
        return timed


def units(network: Network, k: int, h: float) -> OwnTime:
    """Of members exported as FMUs of order 2k, with inputs at nodes and impulses, where they take any."""
    from phfmu.network.couplings.coupled import Coupled
    from phfmu.network.members.fmu_member import FMUMember

    with TemporaryDirectory() as folder:
        declared = {n: replace(d, name=n) for n, d in network.declared.items()}
        members = [FMUMember(n, _exported(d, Path(folder), k, h)) for n, d in declared.items()]
        clock = _Clock()
        for m in members:
            clock.watch(m.unit._slave)
        stepper = Coupled(network, [*members])
        stepper.check_start()
        stepper.prepare(0.0, h)
        stepper.advance(0.0, h, FMU_STEPS)
        return _timed(stepper, clock, len(members), h)


def _exported(declaration: PHDAE, folder: Path, k: int, h: float) -> FMUInstance:
    from phfmu.discretise.model import build_model
    from phfmu.fmu.export import export
    from phfmu.fmu.impulse_values import kernels_of
    from phfmu.fmu.reader import FMUInstance
    from phfmu.schemes.collocated import Collocated

    model = build_model(declaration, Collocated(k))
    kicked = k > 1 and bool(kernels_of(model))
    (path,) = export(model, folder, ("3.0",), step=h, node_inputs=k > 1, impulses=kicked)
    return FMUInstance(path)


def _timed(stepper: Stepper, clock: _Clock, members: int, h: float) -> OwnTime:
    calls, own = [], []
    for turn in range(ROUNDS):
        clock.spent, before = 0.0, thread_time()
        stepper.advance(0.0, h, FMU_STEPS, (turn + 1) * FMU_STEPS)
        whole = thread_time() - before
        calls.append(clock.spent)
        own.append(whole - clock.spent)
    scale = 1e6 / (FMU_STEPS * members)
    return OwnTime(scale * median(calls), scale * median(own))
