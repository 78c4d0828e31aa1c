"""Two-point control."""

from __future__ import annotations

from phfmu import PHDAE, Guard, StateEvent, parameter, signal_input, signal_output


def relay(
    lower: float = 0.0, upper: float = 1.0, *, low: float = 0.0, high: float = 1.0, measured: float = 0.0, on: bool = False,
    unit: str = "1", command: str = "1",
) -> PHDAE:  # fmt: skip
    """A relay with hysteresis: on where its input rises to `upper`, off where it falls to `lower`.

        command = low + (high - low) s;   s = 1 from measured = upper, rising, to measured = lower, falling

    H:  0: no state, no work
    Signal inputs:   measured [unit];  signal outputs: command [`command`]
    Parameters:      lower, upper [unit]; low, high [command]
    Modes:           on: s, 1 or 0
    `on`: at the start;  `low` above `high`: a relay that turns off what raises its input.
    Errors: ValueError where lower is not below upper: it would switch without end.
    """
    if not lower < upper:
        raise ValueError(f"relay: lower = {lower:g} must be below upper = {upper:g} {unit}")
    found = signal_input("measured", measured, unit=unit, description="measured signal")
    below = parameter("lower", lower, unit=unit, description="falling to it turns the relay off")
    above = parameter("upper", upper, unit=unit, description="rising to it turns the relay on")
    off, full = (
        parameter(n, x, unit=command, description=f"command while {d}")
        for n, x, d in (("low", low, "off"), ("high", high, "on"))
    )
    s = parameter("on", float(on), min=0.0, max=1.0, description="1 on, 0 off")
    size = upper - lower
    return PHDAE(
        "relay",
        parameters=(found, below, above, off, full, s),
        observables=(signal_output("command", off + (full - off) * s, unit=command, description="what it commands"),),
        state_events=(
            StateEvent(Guard("turns_on", found - above, 1, size, unit), when={"on": 0.0}, sets={"on": 1.0}),
            StateEvent(Guard("turns_off", found - below, -1, size, unit), when={"on": 1.0}, sets={"on": 0.0}),
        ),
        description="relay with hysteresis",
    )
