"""Diode bridges: single-phase and three-phase, ideal."""

from __future__ import annotations

import casadi as ca

from phfmu import ELECTRICAL, PHDAE, Port, Switch, algebraic, observable, parameter
from phfmu.components.electrical.phases import PHASES


def rectifier_bridge(*, i: float = 1.0, v: float = 1.0) -> PHDAE:
    """Bridge of four ideal diodes between a current `ac` and a current `dc`, both inductive.

        v_ac = u_1 - u_2,   v_dc = u_1 + u_2,   0 <= u_1, i_dc - i_ac,   0 <= u_2, i_dc + i_ac,   complementary

    u_j is the voltage that a pair of diodes blocks; the currents of a pair are equal.  All four conduct while |i_ac| < i_dc.

    H:  0;  algebraic: u (2) [V]
    ports:  ac: current INTO the bridge given, voltage out;  dc: current INTO the bridge given (-i_dc), voltage out
    modes:  blocks (2): 1 where a pair blocks
    `i`: typical current [A];  `v`: typical voltage [V].
    """
    u = algebraic("u", 2, unit="V", nominal=v, description="voltages that the two pairs block")
    blocks = parameter("blocks", 0.0, 2, min=0.0, max=1.0, description="pairs: 1 blocks, 0 conducts")
    ac = Port("ac", ELECTRICAL, "flow", {}, nominal=i, description="current into the bridge")
    dc = Port("dc", ELECTRICAL, "flow", {}, nominal=i, description="current into the bridge, minus the load's")
    switches = tuple(
        Switch(f"pair{j + 1}", u.part(j, 1), {ac: sign, dc: -1.0}, blocks.part(j, 1), nominal=i, unit="A")
        for j, sign in enumerate((-1.0, 1.0))
    )
    return PHDAE(
        "rectifier_bridge",
        algebraics=(u,),
        parameters=(blocks,),
        ports=(ac, dc),
        switches=switches,
        description="bridge of four ideal diodes",
    )


def six_pulse_bridge(*, i: float = 1.0, v: float = 1.0) -> PHDAE:
    """Three-phase bridge of six ideal diodes, from `ac` to `dc`.

        0 = i_1 + i_2 + i_3 - i_dc,   0 = i_dc - i_4 - i_5 - i_6,   0 <= i_j  complementary to the voltages that they block

    H:  0;  J: potentials against currents
    algebraic:   i (6) [A]: 1-3 from the phases to the positive rail, 4-6 from the negative one; rail (2) [V], their potentials
    ports:       ac: voltages (3) given, currents INTO the bridge out;  dc: current INTO the bridge given (-i_dc), voltage out
    modes:       conducts (6)
    observables: v, the DC voltage
    `i`: typical current [A];  `v`: typical voltage [V].
    """
    current = algebraic("i", 6, unit="A", nominal=i, description="currents of the diodes")
    rail = algebraic("rail", 2, unit="V", nominal=v, description="potentials of the rails, + and -")
    mode = parameter("conducts", 0.0, 6, min=0.0, max=1.0, description="diodes: 1 conducts, 0 blocks")
    ac = Port(
        "ac", ELECTRICAL, "effort", {}, size=3, nominal=v, description="currents into the bridge", elements=PHASES
    )
    dc = Port("dc", ELECTRICAL, "flow", {rail: ca.DM([1, -1])}, nominal=i, description="current into the bridge")
    plus, minus = rail.part(0, 1), rail.part(1, 1)
    switches = []
    for j in range(6):
        phase = ca.DM.zeros(3)
        phase[j % 3] = -1 if j < 3 else 1
        on = {plus: 1.0, ac: phase} if j < 3 else {minus: -1.0, ac: phase}
        switches.append(Switch(f"d{j + 1}", current.part(j, 1), on, mode.part(j, 1), nominal=v, unit="V"))
    return PHDAE(
        "six_pulse_bridge",
        algebraics=(current, rail),
        parameters=(mode,),
        ports=(ac, dc),
        switches=tuple(switches),
        observables=(observable("v", rail[0] - rail[1], unit="V", description="DC voltage"),),
        description="three-phase bridge of ideal diodes",
    )
