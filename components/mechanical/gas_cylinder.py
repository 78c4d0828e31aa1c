"""A cylinder of ideal gas with a piston, heated where it is small and cooled where it is large."""

from __future__ import annotations

from math import pi

import casadi as ca

from phfmu import PHDAE, TRANSLATIONAL, Domain, Port, energy, observable, parameter, state

#: heat: temperature and the flow of entropy, whose product is a power
THERMAL = Domain("thermal", "temperature", "K", "entropy_flow", "W/K", "effort")
#: exponents of the walls' conductances in the height of the gas: fire acts at the top, exhaust at the bottom of the stroke
FIRE, EXHAUST = 4, 8


def gas_cylinder(
    *,
    bore: float = 0.12,
    stroke: float = 0.14,
    ratio: float = 9.0,
    height: float | None = None,
    pressure: float = 1e5,
    temperature: float = 300.0,
    kappa: float = 1.4,
    fire: float = 600.0,
    exhaust: float = 280.0,
    T_fire: float = 2200.0,
    T_exhaust: float = 300.0,
) -> PHDAE:
    """Gas of the entropy S above a piston, at the height h of its column: an engine without valves or flames of its own.

        h' = -v,   S' = sum_i g_i(h) (T_i - T)/T,   T = dH/dS = U/C,   p A h = R T
        g_fire = fire (h_0/h)^4,   g_exhaust = exhaust (h/h_1)^8,   h_0 = stroke/(ratio - 1) and h_1 = h_0 + stroke its ends

    H:  U(S, h) + p_0 A h,   U = C T_0 (h_1/h)^(R/C) exp(S/C): convex; with S kept it is the adiabatic p V^kappa = const with
        kappa = 1 + R/C.  p_0: pressure of the air behind the piston, at which the gas begins
    J, R:  0.  Heat is a power at a port and no loss: a reservoir of temperature T_i gives the entropy g_i (T_i - T)/T_i, the gas
        receives g_i (T_i - T)/T, which is not less, and T_i times what is given is the heat, so that the ledger has it exactly
    states:      h [m]; S [J/K], 0 of the gas at p_0 and T_0 in h_1
    ports:       piston: velocity towards the gas given, force on the gas out;  hot, cold: walls, fed with T_fire and T_exhaust
                 from inside, entropy flow from the reservoir out; what they supply is heat
    parameters:  bore_area [m2], p_0 [Pa], T_0 [K], R (amount times gas constant), C (heat capacity at constant volume) [J/K],
                 h_0, h_1 [m], fire, exhaust [W/K], T_fire, T_exhaust [K]
    observables: p [Pa], T [K], V [m3], heat [W] of both walls

    bore, stroke [m];  ratio [1]: of the largest and the smallest volume;  height [m]: h at the start, default h_1
    kappa [1]: ratio of the heat capacities;  pressure [Pa], temperature [K]: p_0 and T_0
    Raises ValueError for values that no cylinder can have.
    The heat goes by the place of the piston and not by a clock, so the cycle runs at any speed and in both directions: the gas is
    hotter on its way out than on its way in, since heat takes time.
    Source: Callen, Thermodynamics (1985), chapter 3.4, for U; the walls are a simple model of a two-stroke cycle.
    """
    lengths = {"bore": bore, "stroke": stroke, "pressure": pressure, "temperature": temperature}
    wrong = [f"{name} = {value:g}" for name, value in lengths.items() if not value > 0]
    wrong += [f"{name} = {value:g}, at most 1" for name, value in (("ratio", ratio), ("kappa", kappa)) if not value > 1]
    start = stroke * ratio / (ratio - 1.0) if height is None and not wrong else height
    if wrong or start is None or not start > 0:
        raise ValueError(f"gas_cylinder: {'; '.join(wrong) or f'height = {height} m'}: lengths, pressure and temperature are "
                         "positive, ratio and kappa above 1")  # fmt: skip
    low, high = stroke / (ratio - 1.0), stroke * ratio / (ratio - 1.0)
    amount = pressure * pi * bore**2 / 4 * high / temperature
    size = amount / (kappa - 1.0)
    h = state("h", unit="m", start=start, nominal=high, description="height of the gas")
    S = state("S", unit="J/K", start=0.0, nominal=size, description="entropy of the gas")
    A = parameter("bore_area", pi * bore**2 / 4, unit="m2", positive=True, description="area of the piston")
    p0 = parameter("p_0", pressure, unit="Pa", positive=True, description="pressure behind the piston")
    T0 = parameter("T_0", temperature, unit="K", positive=True, description="temperature of the gas at h_1, S = 0")
    R = parameter("R", amount, unit="J/K", positive=True, description="amount of gas times the gas constant")
    C = parameter("C", size, unit="J/K", positive=True, description="heat capacity of the gas at constant volume")
    h0 = parameter("h_0", low, unit="m", positive=True, description="height at the top of the stroke")
    h1 = parameter("h_1", high, unit="m", positive=True, description="height at the bottom of the stroke")
    gh = parameter("fire", fire, unit="W/K", min=0.0, description="conductance of the hot wall at h_0")
    gc = parameter("exhaust", exhaust, unit="W/K", min=0.0, description="conductance of the cold wall at h_1")
    Th = parameter("T_fire", T_fire, unit="K", positive=True, description="temperature of the hot wall")
    Tc = parameter("T_exhaust", T_exhaust, unit="K", positive=True, description="temperature of the cold wall")
    U: ca.SX = C * T0 * (h1 / h.sx) ** (R / C) * ca.exp(S.sx / C)
    T = S.z
    conductances = {"hot": (gh * (h0 / h.sx) ** FIRE, Th), "cold": (gc * (h.sx / h1) ** EXHAUST, Tc)}
    walls = tuple(
        Port(
            name,
            THERMAL,
            "effort",
            {S: g * (Ti - T) / (T * Ti)},
            source=Ti.sx,
            nominal=1000.0,
            description=f"{name} wall",
        )
        for name, (g, Ti) in conductances.items()
    )
    heat = sum(g * (Ti - T) for g, Ti in conductances.values())
    return PHDAE(
        "gas_cylinder",
        states=(h, S),
        parameters=(A, p0, T0, R, C, h0, h1, gh, gc, Th, Tc),
        energies=(energy(U), energy(p0 * A * h.sx)),
        ports=(Port("piston", TRANSLATIONAL, "flow", {h: -1.0}, description="piston; towards the gas"), *walls),
        observables=(
            observable("p", R / C * U / (A * h.sx), unit="Pa", description="pressure"),
            observable("T", U / C, unit="K", description="temperature"),
            observable("V", A * h.sx, unit="m3", description="volume"),
            observable("heat", heat, unit="W", description="from both walls"),
        ),
        description="ideal gas above a piston, with a hot and a cold wall",
    )
