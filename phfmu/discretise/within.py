"""The states of a model within its steps."""

from __future__ import annotations

from phfmu.discretise.model import Model
from phfmu.discretise.onestep import step_layout
from phfmu.events.polynomial import Polynomial
from phfmu.terms.extract import extract


def polynomial_of(model: Model) -> Polynomial:
    """The states within a step of a model."""
    if model.events is not None:
        return model.events.polynomial
    scheme = model.scheme
    layout = step_layout(extract(model.declaration, joint=scheme.joint), scheme)
    return Polynomial(layout, scheme.nodes, scheme.maps(layout))
