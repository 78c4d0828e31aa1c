"""Members with state events side by side, as one model whose guards all end their steps on; it takes no step itself."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import replace

from phfmu.discretise.model import Model, build_model
from phfmu.events.event_plan import EventPlan
from phfmu.network.network import Network
from phfmu.schemes.collocated import Collocated


def side_by_side(models: Mapping[str, Model]) -> Model:
    """States, parameters and events of members (name -> model) one after the other, joined by nothing; one alone is itself."""
    if len(models) == 1:
        return next(iter(models.values()))
    net = Network("landing")
    for name, m in models.items():
        net.add(name, m.declaration)
    return build_model(net.compose(), Collocated(max(m.step.k for m in models.values())))


def without_inputs(model: Model) -> EventPlan:
    """The events of a model without rates of guards that read inputs: others give them, and here they are not known."""
    plan = model.events
    assert plan is not None
    reading = [i for g in plan.rates if g.yi.shape[1] for i in g.oi.ravel().tolist()]
    rated = plan.rated.copy()
    rated[reading] = 0
    return replace(plan, rated=rated, rates=tuple(g for g in plan.rates if not g.yi.shape[1]))
