"""Table and picture of docs/results/gradient-peers.md: one gradient beside CasADi's CVODES with its adjoint, and diffrax."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass, field
from functools import cache
from importlib.util import find_spec
from itertools import count
from pathlib import Path
from statistics import median
from time import process_time
from typing import Any

import casadi as ca
import numpy as np
from pages import DOCS, Array, PageBlock, table

from phfmu import Collocated, Event, NativeInstance, Options, RunFunction, build_model
from phfmu.components.electrical import synchronous_machine
from phfmu.studies.bench.machine import machine_line, versions
from phfmu.studies.bench.precision.reduced import ReducedSystem, live_values, reduced
from phfmu.studies.figures import pyplot, save

TURNS, STOP = 5, 0.2
NAMES = ("J", "d", "ra", "xl", "xd", "xd1", "Td10", "xd2", "Td20", "xq", "xq2", "Tq20", "M_f")
SHORT = {f"terminal.v[{i}]": 0.0 for i in (1, 2, 3)}
#: steps of our runs by order; tolerances of the others
STEPS = {2: (500, 2000), 4: (200, 500, 1000), 6: (100, 250, 500)}
TOLERANCES = (1e-6, 1e-9, 1e-12)
OPERATIONS = {
    ca.OP_ADD: "{} + {}", ca.OP_SUB: "{} - {}", ca.OP_MUL: "{} * {}", ca.OP_DIV: "{} / {}", ca.OP_NEG: "-{}",
    ca.OP_SQ: "{0} * {0}", ca.OP_TWICE: "2.0 * {}", ca.OP_INV: "1.0 / {}", ca.OP_SIN: "jnp.sin({})", ca.OP_COS: "jnp.cos({})",
    ca.OP_SQRT: "jnp.sqrt({})", ca.OP_ASSIGN: "{}",
}  # fmt: skip

Found = tuple[float, Array]


@dataclass
class GradientEntry:
    """A method with one setting: the value and its gradient, and the value alone; CPU times of turns in s."""

    method: str
    setting: str
    solve: Callable[[], Found]
    alone: Callable[[], Any]
    spent: list[tuple[float, float]] = field(default_factory=list)
    error: float = np.nan

    def turn(self, wanted: Array, sizes: Array) -> None:
        times = [process_time()]
        self.alone()
        times.append(process_time())
        found = self.solve()[1]
        times.append(process_time())
        self.spent.append((times[1] - times[0], times[2] - times[1]))
        self.error = float(np.max(np.abs(found - wanted) * sizes) / np.max(np.abs(wanted) * sizes))


def declared() -> Any:
    return synchronous_machine("kundur555_1q", parameters="operational")


@cache
def system() -> tuple[ReducedSystem, Array]:
    """The machine as x' = f(t, x, p), and the values of its live names with the terminal short-circuited."""
    found = reduced(declared(), live=(*NAMES, "terminal.v"))
    return found, live_values(found, found.live_start, SHORT)


def own_entry(order: int, n: int) -> GradientEntry:
    model, events = build_model(declared(), Collocated(order // 2)), [Event(0.0, k, v) for k, v in SHORT.items()]
    options, at = Options(stop=STOP, step=STOP / n, events=events), system()[1][chosen()[0]]
    f, turns = RunFunction(model, NativeInstance(model), options, ["last(p)"], list(NAMES)), count(1)

    def theta() -> Array:
        """The values, moved by as little as makes another run of it."""
        return at * (1.0 + 1e-14 * next(turns))

    def solve() -> Found:
        here = theta()
        slopes = np.asarray(f.jacobian(here)[0], np.float64)
        return float(f(here)[0]), slopes

    def alone() -> None:
        f(theta())

    return GradientEntry(f"phfmu, order {order}", f"{n} steps", solve, alone)


def chosen() -> tuple[list[int], int, Array, Array]:
    """Places of NAMES among the live values, of p among the states, states and their sizes."""
    found, d = system()[0], declared()
    states = [n for v in d.states for n in v.names()]
    sizes = np.array([x for v in d.states for x in v.nominal], float)
    return [found.live_names.index(n) for n in NAMES], states.index("p"), found.x0, sizes


def casadi_entry(rtol: float) -> GradientEntry:
    (found, live), (places, p, x0, sizes) = system(), chosen()
    s, theta, values = ca.SX.sym("s", len(x0)), ca.SX.sym("theta", len(places)), ca.SX(ca.DM(live))
    values[places] = theta
    rate = found.ode(0.0, s * sizes, values) / sizes
    options = {"reltol": rtol, "abstol": rtol, "max_num_steps": 100_000}
    F = ca.integrator("F", "cvodes", {"x": s, "p": theta, "ode": rate}, 0.0, STOP, options)
    begin, at = ca.DM(x0 / sizes), ca.DM(live[places])
    symbol = ca.MX.sym("theta", len(places))
    value = F(x0=begin, p=symbol)["xf"][p] * float(sizes[p])
    f = ca.Function("f", [symbol], [value])
    back = ca.Function("back", [symbol], [value, ca.jtimes(value, symbol, 1.0, True)])

    def solve() -> Found:
        value, slopes = back(at)
        return float(value), np.array(slopes).ravel()

    return GradientEntry("CasADi, CVODES and its adjoint", f"{rtol:g}", solve, lambda: f(at))


def in_jax(f: ca.Function) -> Callable[..., Any]:
    """A function of CasADi in operations of JAX."""
    import jax.numpy as jnp

    lines = []
    for k in range(f.n_instructions()):
        kind, i, o = f.instruction_id(k), f.instruction_input(k), f.instruction_output(k)
        if kind == ca.OP_INPUT:
            lines.append(f"w{o[0]} = a{i[0]}[{i[1]}]")
        elif kind == ca.OP_OUTPUT:
            lines.append(f"r[{o[1]}] = w{i[0]}")
        elif kind == ca.OP_CONST:
            lines.append(f"w{o[0]} = {f.instruction_constant(k)!r}")
        else:
            lines.append(f"w{o[0]} = " + OPERATIONS[kind].format(*(f"w{j}" for j in i)))
    names = ", ".join(f"a{i}" for i in range(f.n_in()))
    body = "\n    ".join([f"r = [0.0] * {f.nnz_out(0)}", *lines, "return jnp.stack(r)"])
    space: dict[str, Any] = {"jnp": jnp}
    exec(f"def rate({names}):\n    {body}\n", space)
    return space["rate"]


def diffrax_entry(rtol: float, backwards: str) -> GradientEntry:
    import diffrax
    import jax
    import jax.numpy as jnp

    jax.config.update("jax_enable_x64", True)
    (found, live), (places, p, x0, sizes) = system(), chosen()
    rate = in_jax(ca.Function("rate", found.arguments, [ca.densify(found.ode(*found.arguments))]))
    where, at = jnp.array(places), jnp.array(live[places])
    term = diffrax.ODETerm(lambda t, s, values: rate(jnp.zeros(1), s * sizes, values) / sizes)
    how = getattr(diffrax, backwards)()
    steps = diffrax.PIDController(rtol=rtol, atol=rtol)

    def value(theta: Any) -> Any:
        values = jnp.array(live).at[where].set(theta)
        ends: Any = diffrax.diffeqsolve(
            term, diffrax.Dopri8(), 0.0, STOP, 1e-5, jnp.array(x0 / sizes), values,
            stepsize_controller=steps, adjoint=how, max_steps=4096, saveat=diffrax.SaveAt(t1=True),
        )  # fmt: skip
        return ends.ys[0, p] * sizes[p]

    alone, both = jax.jit(value), jax.jit(jax.value_and_grad(value))

    def solve() -> Found:
        value, slopes = both(at)
        return float(value), np.array(slopes)

    kinds = {"RecursiveCheckpointAdjoint": "of its steps", "BacksolveAdjoint": "backsolved"}
    return GradientEntry(f"diffrax Dopri8, adjoint {kinds[backwards]}", f"{rtol:g}", solve, lambda: float(alone(at)))


def exact() -> Any:
    """The gradient by the variational equations of the motion, DOP853."""
    from scipy.integrate import solve_ivp

    (found, live), (places, p, x0, sizes) = system(), chosen()
    f, n, m = found.ode(*found.arguments), len(x0), len(places)
    S = ca.SX.sym("S", n, m)
    along = ca.jacobian(f, found.x) @ S + ca.jacobian(f, found.live)[:, places]
    rates = ca.Function("rates", [found.x, S], [ca.substitute(r, found.live, ca.SX(ca.DM(live))) for r in (f, along)])
    scale = np.concatenate([sizes, np.outer(sizes, 1.0 / np.abs(live[places] + (live[places] == 0))).ravel()])

    def rate(t: float, y: Any) -> Any:
        y = y * scale
        a, b = rates(y[:n], y[n:].reshape(n, m))
        return np.concatenate([np.array(a).ravel(), np.array(b).ravel()]) / scale

    y0 = np.concatenate([x0, np.zeros(n * m)]) / scale
    y = solve_ivp(rate, (0.0, STOP), y0, method="DOP853", rtol=1e-12, atol=1e-13).y[:, -1] * scale
    return y[n:].reshape(n, m)[p]


def entries() -> Iterator[GradientEntry]:
    yield from (own_entry(order, n) for order, counts in STEPS.items() for n in counts)
    yield from (casadi_entry(rtol) for rtol in TOLERANCES)
    if find_spec("diffrax") is not None:
        for kind in ("RecursiveCheckpointAdjoint", "BacksolveAdjoint"):
            yield from (diffrax_entry(rtol, kind) for rtol in TOLERANCES)


@cache
def measured() -> list[GradientEntry]:
    """Turn by turn, so that what else the machine does falls on all alike."""
    live, (places, *_) = system()[1], chosen()
    wanted, found = exact(), list(entries())
    sizes = np.where(live[places] == 0, 1.0, np.abs(live[places]))
    for _ in range(TURNS + 1):  # the first one warms up
        for e in found:
            e.turn(wanted, sizes)
    for e in found:
        del e.spent[0]
    return found


def gradient_peers() -> PageBlock:
    """Largest error of a gradient, CPU time of the value alone and of the value with its gradient by 13 parameters."""
    rows = []
    for e in measured():
        alone, both = (median(t) for t in zip(*e.spent, strict=True))
        rows.append([e.method, e.setting, e.error, f"{1e3 * alone:.2f}", f"{1e3 * both:.2f}", f"{both / alone:.1f}"])
    about = f"{machine_line()}; CPU time of the process, median of {TURNS} turns taken in rotation"
    notes = (about, versions(("phfmu", "numpy", "scipy", "casadi", "jax", "diffrax")))
    head = ["method", "setting", "error of the gradient", "value, ms", "with gradient, ms", "with gradient/value"]
    return table(head, rows, ".1e", notes=notes, draw=_draw)


def _draw() -> Sequence[Path]:
    plt = pyplot()

    plt.rcParams.update({"font.size": 9.5, "axes.spines.top": False, "axes.spines.right": False})
    figure, ax = plt.subplots(figsize=(7.6, 4.4), layout="constrained")
    methods = dict.fromkeys(e.method for e in measured())
    for method, mark in zip(methods, "os^DvPX", strict=False):
        own = [e for e in measured() if e.method == method]
        times = [1e3 * median(both for _, both in e.spent) for e in own]
        ax.loglog(times, [e.error for e in own], f"{mark}-", lw=1.2, ms=5, label=method)
    ax.set(xlabel="CPU time of the value with its gradient, ms", ylabel="largest error of the gradient")
    ax.legend(frameon=False, fontsize=8.5)
    path = DOCS / "results" / "img" / "gradient_peers.png"
    save(figure, path)
    return (path,)
