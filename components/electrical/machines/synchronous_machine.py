"""The synchronous machine in dq-flux, abc-flux and current coordinates."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import replace
from typing import Any, Literal

import casadi as ca

from phfmu import (
    ELECTRICAL,
    PHDAE,
    ROTATIONAL,
    ClosedPair,
    Port,
    Variable,
    block,
    damping,
    energy,
    meant,
    observable,
    parameter,
    skew,
    state,
)
from phfmu.components.electrical.machines.machine_data import MachineData, MachineDataError, machine_set
from phfmu.components.electrical.machines.machine_init import OperatingPoint, operating_point, steady_state
from phfmu.components.electrical.machines.main_flux import Saturation
from phfmu.components.electrical.machines.operational import operational_windings
from phfmu.components.electrical.machines.park import (
    ROTATING,
    circuit_windings,
    magnetic_energy,
    park_matrix,
    phase_inductance,
    saturation_energy,
    sinc,
)
from phfmu.components.electrical.phases import PHASES

Coordinates = Literal["dq-flux", "abc-flux", "current"]
Parameters = Literal["circuit", "operational"]
#: what the windings of a machine are told by
WINDINGS = {"circuit": circuit_windings, "operational": operational_windings}


def synchronous_machine(
    machine: str | Mapping[str, Any] | MachineData = "kundur555_1q",
    *,
    coordinates: Coordinates = "dq-flux",
    parameters: Parameters = "circuit",
    start: OperatingPoint | None = None,
    saturation: Saturation | None = None,
) -> PHDAE:
    """Synchronous machine with field and damper windings, all stator transients, in motor sign.

    psi' = v - R I,  p' = tau - d omega + 1/2 I^T L'(theta) I,  theta' = omega = p/J,  psi = L(theta) I

    H:  1/2 psi^T L(theta)^-1 psi + p^2/(2 J); quadratic in "dq-flux": psi_dq = T psi, L = T^T Lhat T;
        with saturation also E(mu), the convex energy of the iron, see `Saturation`
    J:  J[theta, p] = 1 (skew); in "dq-flux" also J[psi_d, p] = psi_q, J[psi_q, p] = -psi_d (skew)
    R:  Ra on the stator, R_f, R_kd, .. on the rotor, d on p

    states:      psi [Wb] (d, q, 0, rotor in "dq-flux"; a, b, c, rotor in "abc-flux") or I [A] in "current";
                 p [kg.m2/s]; theta [rad], electrical angle of the d axis from phase a; grows for ever
    ports:       terminal: phase voltages given, currents INTO the machine out; field: voltage given, current
                 out; shaft: torque given, speed out; a positive torque accelerates: tau > 0 for a generator
    parameters:  J, d, Ra, R_f, R_kd, .., Ld, Lq, L0, M_f, .., L_ff, L_fkd, ..; with saturation Ll and those of the curve;
                 "operational": J, d, ra, xl, x0, xd, xd1 (xd'), Td10 (Td0'), xd2, Td20, xq, .. in per unit and s, and M_f, of
                 which the windings are functions
    observables: I[..], flux[..] (windings a, b, c, rotor), Te (electrical torque; negative for a generator)

    omega, J, d, tau are electrical (one pole pair) unless the set gives pole_pairs; then J, d, torque and
    speed of the shaft port are mechanical, theta and p stay electrical, p = J omega / pole_pairs^2.
    `start` (default: 0.8 and 0.2 of rated P, Q) also gives the start values of the inputs.
    "abc-flux" keeps the phase fluxes exact; "current" has E = [[L, 0, L'I], [0, 1, 0], [0, 0, 1]], order 2, no saturation.
    `saturation` (default: that of the set) of the main flux; the set must give Ll.  Where a quadratic curve begins its third
    derivative jumps, so that steps over that point have order 2 at most there.
    Source: Kinon, Morandin, Schulze, Appl. Numer. Math. 2026, Example 4, Appendix B; Kundur 1994, chapter 3.
    """
    data = _saturated(machine, saturation)
    return _build(data, coordinates, start or steady_state(data), None, parameters)


def machine_at_bus(
    machine: str | Mapping[str, Any] | MachineData = "kundur555_1q",
    R: float | None = None,
    L: float | None = None,
    *,
    coordinates: Coordinates = "dq-flux",
    start: OperatingPoint | None = None,
    saturation: Saturation | None = None,
) -> PHDAE:
    """`synchronous_machine` behind a series line, its terminal at the far end: there is no node in between.

    psi' = v - (Ra + R_line) I,   psi = (L(theta) + L_line) I on the stator; the rest as in `synchronous_machine`

    The line's inductance per phase is the same in abc and in the rotor frame, so it adds to Ld, Lq, L0: the node between
    machine and line, where only inductors meet (index 2), is gone, and all states have the order of the scheme.
    states, ports, observables: those of the machine; psi and flux include the line; terminal: the far end
    parameters:  those of the machine, R_line [ohm], L_line [H] per phase
    R [ohm], L [H]: of the line (default: 0.02 and 0.3 of the base impedance).  `saturation`: of the machine, whose main flux
    does not include the line.  `start`: of the machine at its own terminals, which the start value of the terminal voltage turns
    into the far end's for a balanced steady state.
    """
    data = _saturated(machine, saturation)
    base = data.Vn_rms_ll**2 / data.Sn
    R, L = 0.02 * base if R is None else R, 0.3 * base / data.omega if L is None else L
    if not L >= 0 or not R >= 0:
        raise ValueError(f"machine_at_bus: R = {R} ohm and L = {L} H of the line must not be negative")
    near = start or steady_state(data)
    leakage = {} if data.Ll is None else {"Ll": data.Ll + L}
    folded = machine_set(data, Ld=data.Ld + L, Lq=data.Lq + L, L0=data.L0 + L, **leakage)
    far = operating_point(
        folded, near.I, near.p, near.theta, v=_far_end(near, R, L, data.omega), Vf=near.Vf, tau=near.tau
    )
    model = _build(data, coordinates, far, (R, L))
    return replace(model, name="machine_at_bus", description=f"{model.description}, behind a line")


def _saturated(machine: str | Mapping[str, Any] | MachineData, saturation: Saturation | None) -> MachineData:
    """The set with this saturation, or its own."""
    return machine_set(machine) if saturation is None else machine_set(machine, saturation=saturation)


def _far_end(near: OperatingPoint, R: float, L: float, omega: float) -> list[float]:
    """Voltages v + R i + L i' with i' of balanced currents: i_a' = omega (i_c - i_b) / sqrt(3)."""
    i = near.I[:3]
    return [near.v[x] + R * i[x] + L * omega * (i[x - 1] - i[x - 2]) / 3.0**0.5 for x in range(3)]


def _build(
    data: MachineData,
    coordinates: Coordinates,
    start: OperatingPoint,
    line: tuple[float, float] | None,
    parameters: Parameters = "circuit",
) -> PHDAE:
    builders = {"dq-flux": _dq_flux, "abc-flux": _abc_flux, "current": _current}
    if coordinates not in builders:
        raise ValueError(f"coordinates '{coordinates}' unknown; {meant(coordinates, builders)}")
    if parameters not in WINDINGS:
        raise ValueError(f"parameters '{parameters}' unknown; {meant(parameters, WINDINGS)}")
    return builders[coordinates](_Common(data, start, line, parameters))


class _Common:
    """The common part of the three coordinate systems: parameters, p, theta, ports, friction, kinetic energy."""

    def __init__(
        self, data: MachineData, start: OperatingPoint, line: tuple[float, float] | None, parameters: Parameters
    ):
        self.data, self.start = data, start
        self.R_line = (
            None if line is None else parameter("R_line", line[0], unit="ohm", min=0.0, description="line, per phase")
        )
        L_line = (
            None if line is None else parameter("L_line", line[1], unit="H", min=0.0, description="line, per phase")
        )
        windings = WINDINGS[parameters](data, L_line)
        self.L, self.Ra, self.R, self.windings_of = windings.L, windings.Ra, windings.R, windings.parameters
        self.J = parameter("J", data.J, unit="kg.m2", description="inertia")
        self.d = parameter("d", data.d, unit="N.m.s/rad", description="friction torque per speed")
        self.J_el, self.d_el = self.J / data.pole_pairs**2, self.d / data.pole_pairs**2
        momentum = data.J_electrical * data.omega
        self.p = state(
            "p", unit="kg.m2/s", start=start.p, nominal=momentum, description="momentum J omega (electrical)"
        )
        self.theta = state("theta", unit="rad", start=start.theta, description="electrical angle of the d axis")
        self.kinetic: ca.SX = self.p**2 / (2 * self.J_el)

    @property
    def base_current(self) -> list[float]:
        """Rated peak current of a phase; for a rotor winding the current that magnetises to rated flux."""
        data = self.data
        phase = (2.0 / 3.0) ** 0.5 * data.Sn / data.Vn_rms_ll
        flux = (2.0 / 3.0) ** 0.5 * data.Vn_rms_ll / data.omega
        return [phase] * 3 + [flux / abs(m) if m else phase for m in data.M_stator_rotor]

    @property
    def base_flux(self) -> list[float]:
        """Rated flux of the stator, and L_jj base_current of the rotor windings."""
        data = self.data
        rotor = [data.L_rotor[j][j] * i for j, i in enumerate(self.base_current[3:])]
        return [data.Vn_rms_ll / data.omega] * 3 + rotor

    def windings(
        self, name: str, unit: str, values: tuple[float, ...], nominal: list[float], text: str, stator: tuple[str, ...]
    ) -> Variable:
        called = (*stator, *self.data.elements)
        return state(name, self.data.n, unit=unit, start=values, nominal=nominal, description=text, elements=called)

    def model(self, windings: Variable, stator: ca.SX, extra: dict[str, Any], observables: dict[str, ca.SX]) -> PHDAE:
        """The declaration; `stator` (3 x 3): terminal voltage -> rows of the first three windings."""
        data, start, n = self.data, self.start, self.data.n
        units = {
            "I": ("A", "winding currents, into the machine"),
            "flux": ("Wb", "winding fluxes"),
            "Te": ("N.m", "electrical torque on theta, accelerating"),
        }
        terminal = Port(
            "terminal",
            ELECTRICAL,
            "effort",
            {windings: ca.vertcat(stator, ca.SX(n - 3, 3))},
            size=3,
            start=start.v,
            nominal=(2.0 / 3.0) ** 0.5 * data.Vn_rms_ll,
            description="stator phases a, b, c; current into the machine",
            elements=PHASES,
        )
        called = (*PHASES, *data.elements)
        first = ca.SX(n, 1)
        first[3] = 1
        field = Port(
            "field",
            ELECTRICAL,
            "effort",
            {windings: first},
            start=start.Vf,
            nominal=data.R_rotor[0] * self.base_current[3] or 1.0,
            description="field winding",
        )
        shaft = Port(
            "shaft",
            ROTATIONAL,
            "effort",
            {self.p: 1.0 / data.pole_pairs},
            start=start.tau,
            nominal=data.pole_pairs * data.Sn / data.omega,
            description="a positive torque accelerates",
        )
        stator_R = self.Ra if self.R_line is None else self.Ra + self.R_line
        line = () if self.R_line is None else (self.R_line,)
        R = ca.diag(ca.vertcat(stator_R, stator_R, stator_R, *self.R))
        return PHDAE(
            "synchronous_machine",
            states=(windings, self.p, self.theta),
            parameters=(self.J, self.d, *self.windings_of, *line),
            structure=(skew(self.theta, self.p, 1), *extra.pop("structure", ())),
            dissipation=(block([windings], R), damping(self.p, self.d_el)),
            ports=(terminal, field, shaft),
            observables=tuple(
                observable(k, v, unit=units[k][0], description=units[k][1], elements=called if v.numel() > 1 else ())
                for k, v in observables.items()
            ),
            description=f"synchronous machine {data.name}, {data.Sn / 1e6:g} MVA {data.Vn_rms_ll / 1e3:g} kV",
            **extra,
        )


def _dq_flux(c: _Common) -> PHDAE:
    psi = c.windings("psi", "Wb", c.start.dq, c.base_flux, "fluxes d, q, 0, rotor (orthonormal Park)", ROTATING)
    n, T = c.data.n, park_matrix(c.theta.sx)
    turn = ca.SX(n + 1, n + 1)
    turn[0, n], turn[n, 0] = psi[1], -psi[1]
    turn[1, n], turn[n, 1] = -psi[0], psi[0]
    observables = {
        "I": ca.vertcat(ca.mtimes(T.T, psi.z[:3]), psi.z[3:]),
        "flux": ca.vertcat(ca.mtimes(T.T, psi[:3]), psi[3:]),
        "Te": psi[0] * psi.z[1] - psi[1] * psi.z[0],
    }
    iron = saturation_energy(psi.sx, c.L)
    energies = (energy(magnetic_energy(psi.sx, c.L)), *(() if iron is None else (energy(iron),)), energy(c.kinetic))
    return c.model(psi, T, {"energies": energies, "structure": (block([psi, c.p], turn),)}, observables)


def _abc_flux(c: _Common) -> PHDAE:
    psi = c.windings("psi", "Wb", c.start.psi, c.base_flux, "fluxes a, b, c, rotor", PHASES)
    dq = ca.vertcat(ca.mtimes(park_matrix(c.theta.sx), psi[:3]), psi[3:])
    observables = {"I": psi.z, "flux": psi.sx, "Te": -c.theta.z}
    iron = saturation_energy(dq, c.L)
    stored = magnetic_energy(dq, c.L) if iron is None else magnetic_energy(dq, c.L) + iron
    energies = (energy(stored, correct=(c.theta,)), energy(c.kinetic))
    return c.model(psi, ca.SX.eye(3), {"energies": energies}, observables)


def _current(c: _Common) -> PHDAE:
    if c.data.saturation is not None:
        text = "saturates, whose L(theta) is none of the currents"
        raise MachineDataError(f"machine '{c.data.name}'", text, "take coordinates 'dq-flux' or 'abc-flux'")
    I = c.windings("I", "A", c.start.I, c.base_current, "currents a, b, c, rotor", PHASES)
    n, theta = c.data.n, c.theta.sx
    constant, first, second = phase_inductance(theta, c.L)
    L = constant + first + second
    d1, d2 = (ca.reshape(ca.jacobian(ca.vec(part), theta), n, n) for part in (first, second))
    slope = d1 + d2
    half_torque = ca.mtimes(I.sx.T, ca.mtimes(slope, I.sx)) / 2

    def at(expr: ca.SX, angle: ca.SX) -> ca.SX:
        return ca.substitute(expr, theta, angle)

    def parts(x: ca.SX, dx: ca.SX) -> tuple[ca.SX, ca.SX, ca.SX, ca.SX]:
        """Both inductances and the two mean currents times D = (L(theta') - L(theta)) / (theta' - theta)."""
        angle, turn = x[n + 1], dx[n + 1]
        middle = angle + turn / 2
        D = sinc(turn / 2) * at(d1, middle) + sinc(turn) * at(d2, middle)
        return at(L, angle), at(L, angle + turn), D, x[:n] + dx[:n] / 2

    def ebar(x: ca.SX, dx: ca.SX) -> ca.SX:
        old, new, D, mean = parts(x, dx)
        return ca.vertcat(ca.mtimes((old + new) / 2, dx[:n]) + ca.mtimes(D, mean) * dx[n + 1], dx[n:])

    def zbar(x: ca.SX, dx: ca.SX) -> ca.SX:
        _, _, D, mean = parts(x, dx)
        force = ca.mtimes(x[:n].T, ca.mtimes(D, x[:n] + dx[:n])) / 2
        return ca.vertcat(mean, (x[n] + dx[n] / 2) / c.J_el, -force)

    E = ca.SX.eye(n + 2)
    E[:n, :n], E[:n, n + 1] = L, ca.mtimes(slope, I.sx)
    pair = ClosedPair(
        (I, c.p, c.theta),
        ca.mtimes(I.sx.T, ca.mtimes(L, I.sx)) / 2 + c.kinetic,
        E,
        ca.vertcat(I.sx, c.p / c.J_el, -half_torque),
        ebar,
        zbar,
    )
    observables = {"flux": ca.mtimes(L, I.sx), "Te": half_torque}
    return c.model(I, ca.SX.eye(3), {"closed": (pair,)}, observables)
