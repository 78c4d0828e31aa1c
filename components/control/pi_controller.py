"""Proportional and integral control."""

from __future__ import annotations

from phfmu import PHDAE, driven, parameter, signal_input, signal_output, state


def pi_controller(
    kp: float = 1.0, ki: float = 1.0, *, reference: float = 0.0, measured: float = 0.0, x: float = 0.0,
    unit: str = "1", command: str = "1",
) -> PHDAE:  # fmt: skip
    """A controller: the error of a measured signal and its integral make a command.

        x' = e,   e = reference - measured,   command = kp e + ki x

    H:  0: its state has no energy, and it does no work
    States:          x [unit.s], integral of the error
    Signal inputs:   reference, measured [unit];  signal outputs: command [`command`], error [unit]
    Parameters:      kp [command/unit], ki [command/unit/s]
    """
    wanted = signal_input("reference", reference, unit=unit, description="what the measured signal should be")
    found = signal_input("measured", measured, unit=unit, description="measured signal")
    integral = state("x", unit=f"s.{unit}", start=x, description="integral of the error")
    over, _, under = unit.partition("/")
    gain = "1" if unit == command else f"{under or 1}.{command}/{over}"
    p = parameter("kp", kp, unit=gain, description="proportional gain")
    i = parameter("ki", ki, unit=f"{gain}/s", description="integral gain")
    error = wanted - found
    return PHDAE(
        "pi_controller",
        states=(integral,),
        parameters=(p, i, wanted, found),
        ports=(driven("integrator", {integral: error}, description="the error, integrated; no work"),),
        observables=(
            signal_output("command", p * error + i * integral, unit=command, description="kp e + ki x"),
            signal_output("error", error, unit=unit, description="reference - measured"),
        ),
        description="proportional and integral controller",
    )
