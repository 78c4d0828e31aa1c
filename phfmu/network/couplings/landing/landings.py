"""Landers of coupled members: of those with plain state events or, with ideal switches, of one composed declaration."""

from __future__ import annotations

from collections.abc import Callable
from typing import TYPE_CHECKING

from phfmu.network.couplings.coupling import AllSteps, Coupling
from phfmu.network.couplings.newton import Newton
from phfmu.network.interface.coupled_members import CoupledMembers
from phfmu.network.interface.unknowns import InterfaceUnknowns
from phfmu.network.members.engine_member import EngineMember
from phfmu.network.members.relation import RelationInstance

if TYPE_CHECKING:
    from phfmu.network.couplings.landing.composed_lander import ComposedLander
    from phfmu.network.couplings.landing.coupled_lander import CoupledLander


def landings(
    joined: CoupledMembers, coupling: Coupling, steps: AllSteps, joined_anew: Callable[[], None]
) -> tuple[InterfaceUnknowns | None, CoupledLander | ComposedLander | None, ComposedLander | None]:
    """Unknowns of the exchange at nodes, the lander of the members, and the same if it has switches; None where there is none.

    joined_anew: is called after C of the exchange has changed
    Raises ValueError for a member that has no steps of its own.
    """
    exchange = coupling.exchange if isinstance(coupling, Newton) else None
    for m in joined.members:
        if isinstance(m, EngineMember) and not isinstance(m.instance, RelationInstance) and m.between_inputs:
            raise ValueError(m.between_inputs + ("" if exchange else ", or take --coupling newton"))
    if exchange is None:
        return None, None, None
    if exchange.whole:
        from phfmu.network.couplings.landing.composed_lander import ComposedLander

        found = ComposedLander(exchange, steps, joined_anew)
        return exchange, found, found
    if not (members := exchange.landing()):
        return exchange, None, None
    from phfmu.network.couplings.landing.coupled_lander import CoupledLander

    return exchange, CoupledLander(joined, exchange.shared, members, steps), None
