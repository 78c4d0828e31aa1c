"""Ledgers made of arrays: two members, four ports, no model."""

from pathlib import Path

import numpy as np

from phfmu.audit import (
    AuditWriter,
    Booking,
    Ledger,
    PortKey,
)
from phfmu.outcome.steps import Steps

# two members on a bus that leaks a little; b's port there has two pairs, and b has a port to the outside
BOOKING = Booking(
    ("a", "b"),
    (
        PortKey("a", "p", junction="bus"),
        PortKey("b", "p", index=1, junction="bus"),
        PortKey("b", "p", index=2, junction="bus"),
        PortKey("b", "field"),
    ),
)


def run_arrays(n: int, seed: int = 0, leak: float = 1e-3) -> dict[str, np.ndarray]:
    """n steps whose components close to rounding while the bus creates energy."""
    rng = np.random.default_rng(seed)
    u, y, h = rng.normal(size=(n, 4)), rng.normal(size=(n, 4)), 0.01
    energy = h * u * y
    energy[:, 0] = -(energy[:, 1] + energy[:, 2]) + leak * rng.normal(size=n)
    supplied = np.stack([energy[:, 0], energy[:, 1] + energy[:, 2] + energy[:, 3]], axis=1)
    dissipated = 0.01 * rng.random((n, 2))
    dH = supplied - dissipated
    H = 10.0 + np.cumsum(dH, axis=0)
    steps = np.arange(n)
    return {
        "step": steps,
        "t0": 1.0 + h * steps,
        "h": np.full(n, h),
        "H": H,
        "dH": dH,
        "dissipated": dissipated,
        "supplied": supplied,
        "port_energy": energy,
    }


def book(ledger: Ledger, booking: Booking, *, step, t0, h, H, dH, H0=None, **columns) -> None:
    """Steps of a ledger; what a run does not have is zero."""
    H = np.array(H, float)
    none = np.zeros_like(H)
    pairs = columns.pop("port_energy", np.zeros((len(H), len(booking.ports))))
    columns = {"dissipated": none, "supplied": none} | columns
    steps = Steps(H, np.asarray(dH), pairs=np.asarray(pairs), **{k: np.asarray(v) for k, v in columns.items()})
    ledger.add(booking, step, t0, h, steps, H0)


def add_blocks(ledger: Ledger, a: dict[str, np.ndarray], size: int) -> None:
    for start in range(0, len(a["step"]), size):
        book(ledger, BOOKING, **{name: x[start : start + size] for name, x in a.items()})


def write_run(path: Path, n: int = 50, size: int = 7, leak: float = 1e-3) -> Path:
    with AuditWriter(path) as sink:
        add_blocks(Ledger(sink), run_arrays(n, leak=leak), size)
    return path
