"""A synchronous machine at the limits of its data and of the grid."""

from __future__ import annotations

from typing import Any

import numpy as np

from phfmu.declare.phdae import PHDAE
from phfmu.studies.stress.case import StressCase, StressOutcome, not_supported, refused
from phfmu.studies.stress.drive import effort, instance, record

TARGET = "synchronous_machine"
MACHINE = "kundur555_1q"
H = 1e-4


def machine(**changes: Any) -> Any:
    """The turbo generator of the library in its steady state, with changed data."""
    from phfmu.components.electrical.machines.machine_data import machine_set
    from phfmu.components.electrical.machines.machine_init import steady_state
    from phfmu.components.electrical.machines.synchronous_machine import synchronous_machine

    return synchronous_machine(machine_set(MACHINE, **changes), start=steady_state(machine_set(MACHINE)))


def scaled(model: PHDAE, factors: dict[str, float]) -> PHDAE:
    """The model with the declared values of states and parameters times `factors`, all entries of each."""
    values = {}
    for v in (*model.states, *model.parameters):
        values |= {n: factors[v.name] * x for n, x in zip(v.names(), v.start, strict=True) if v.name in factors}
    return model.with_starts(values)


def voltages(unit: Any, n: int, amplitude: float) -> np.ndarray:
    """Inputs over n steps: balanced terminal voltages, `amplitude` times the rated ones; field and torque as at the start."""
    from phfmu.components.electrical.machines.machine_data import machine_set

    data = machine_set(MACHINE)
    phase = data.omega * H * (np.arange(n)[:, None] + 0.5) - 2 * np.pi / 3 * np.arange(3)
    peak = amplitude * data.Vn_rms_ll * np.sqrt(2 / 3)
    return np.hstack([peak * np.cos(phase), np.tile(unit.model.u0[3:], (n, 1))])


def driven(
    factors: dict[str, float] | None = None, amplitude: float = 1.0, n: int = 1000, field: bool = True
) -> StressOutcome:
    """n steps of 0.1 ms with scaled values: the balance in units of the energy in play, the iterations, the extremes."""
    d = scaled(machine(), factors or {})
    unit = instance(d if field else d.with_starts({"field.v": 0.0}))
    r = record(unit, H, n, inputs=voltages(unit, n, amplitude))
    speed = r.x[:, -2] / float(unit.parameters[0])
    text = f"balance {r.balance:.1e}, speed {speed.min():.4g} to {speed.max():.4g} rad/s; {effort(r)}"
    return StressOutcome(text, r.finite and r.balance <= 1e-11)


def switched(resistance: float, phases: int) -> StressOutcome:
    """The two-machine scene with a fault of `resistance` ohm on some phases."""
    from phfmu.components.scenes.electrical.two_machine import two_machine
    from phfmu.network.couplings.monolithic import Monolithic
    from phfmu.network.scene import Event
    from phfmu.runs.loop import run
    from phfmu.runs.options import Options

    scene = two_machine()
    names = ["fault.G"] if phases == 3 else [f"fault.G[{i + 1}]" for i in range(phases)]
    events = [Event(t, n, g) for t, g in ((0.02, 1.0 / resistance), (0.06, 0.0)) for n in names]
    unit = instance(scene.declaration())
    result = run(Monolithic(unit.model, unit), Options(stop=0.1, step=H, events=events))
    worst = max(c.worst_relative for c in result.ledger.summary().components)
    v = result.column("bus2.v[1]")
    fault = (result.time > 0.021) & (result.time < 0.06)
    ringing = float(np.abs(np.diff(v[fault])).max())
    (C,) = (p.start[0] for p in scene.system.members["load"].parameters if p.name == "C")  # type: ignore[union-attr]
    tau = resistance * C
    text = f"RC time {tau:.1e} s; worst ledger {worst:.1e}; bus voltage jumps by up to {ringing:.3g} V a step; "
    text += f"{result.iterations / result.steps:.1f} iterations a step"
    return StressOutcome(text, worst <= 1e-11 and bool(np.isfinite(result.values).all()))


def wide() -> StressOutcome:
    """60 s at 0.1 ms: momentum 1e7, angle 2e4 rad, time constants from 0.03 to 8 s."""
    return driven(n=600_000)


def impossible(words: str, **changes: Any) -> StressOutcome:
    """Data that no machine has: refused with these words."""
    from phfmu.components.electrical.machines.machine_data import MachineDataError

    return refused(lambda: machine(**changes), MachineDataError, words)


BALANCE = "balance <= 1e-11"
CASES = (
    StressCase(TARGET, "short circuit at the terminals", BALANCE, lambda: driven(amplitude=0.0)),
    StressCase(TARGET, "twice the rated speed", BALANCE, lambda: driven({"p": 2.0})),
    StressCase(TARGET, "standstill at full voltage", BALANCE, lambda: driven({"p": 0.0})),
    StressCase(TARGET, "resistances x 1e-6", BALANCE, lambda: driven(dict.fromkeys(("Ra", "R_f", "R_kd", "R_kq"), 1e-6))),
    *(StressCase(TARGET, f"inertia x {f:g}, voltage halved", BALANCE,
                 lambda f=f: driven({"J": f, "p": f}, amplitude=0.5)) for f in (1e-2, 1e-4, 1e-6)),
    StressCase(TARGET, "no inertia", "refused", lambda: impossible("J = 0", J=0.0)),
    StressCase(TARGET, "negative inertia", "refused", lambda: impossible("J = -1", J=-1.0)),
    StressCase(TARGET, "negative resistance", "refused", lambda: impossible("Ra = -0.001", Ra=-1e-3)),
    StressCase(TARGET, "singular inductances", "refused", lambda: impossible("d-axis block of L", Ld=0.0)),
    StressCase(TARGET, "no field voltage, no flux", BALANCE, lambda: driven({"psi": 0.0}, field=False)),
    *(StressCase("two_machine", f"fault of {r:g} ohm, {n} phase{'s' if n > 1 else ''}", "ledger <= 1e-11, finite",
                 lambda r=r, n=n: switched(r, n)) for r, n in ((0.05, 3), (0.005, 3), (1e-6, 3), (0.05, 1))),
    StressCase(TARGET, "60 s at 0.1 ms", BALANCE, wide),
    StressCase(TARGET, "open phase", "index change handled", not_supported(
        "opening a phase changes the index; model the switch as a conductance (fault_resistor)")),
)  # fmt: skip
