"""How coupled members land together: those with plain state events, or, with ideal switches, as one composed declaration."""

from __future__ import annotations

from typing import TYPE_CHECKING

from phfmu.network.couplings.coupling import AllSteps, Coupling
from phfmu.network.couplings.node_newton import NodeNewton
from phfmu.network.interface.exchange import Exchange
from phfmu.network.interface.joined import Joined
from phfmu.network.members.engine_member import EngineMember
from phfmu.network.members.relation import RelationInstance

if TYPE_CHECKING:
    from phfmu.network.couplings.landing.switching import Switching
    from phfmu.network.couplings.landing.together import Together


def landings(
    joined: Joined, coupling: Coupling, steps: AllSteps
) -> tuple[Exchange | None, Together | Switching | None, Switching | None]:
    """The exchange of members at nodes, how they land together, and the same as one with switches; None for what they do not.

    ValueError for a member that has no steps of its own.
    """
    exchange = coupling.exchange if isinstance(coupling, NodeNewton) else None
    for m in joined.members:
        if isinstance(m, EngineMember) and not isinstance(m.instance, RelationInstance) and m.between_inputs:
            raise ValueError(m.between_inputs + ("" if exchange else ", or take --coupling newton"))
    if exchange is None:
        return None, None, None
    if exchange.whole:
        from phfmu.network.couplings.landing.switching import Switching

        assert isinstance(coupling, NodeNewton)
        found = Switching(exchange, steps, coupling.join)
        return exchange, found, found
    if not (members := exchange.landing()):
        return exchange, None, None
    from phfmu.network.couplings.landing.together import Together

    return exchange, Together(joined, exchange.shared, members, steps.solve, steps.save, steps.restore), None
