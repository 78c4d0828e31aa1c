"""The states of a model within its steps."""

from __future__ import annotations

from weakref import WeakKeyDictionary

from phfmu.discretise.model import Model
from phfmu.discretise.onestep import step_layout
from phfmu.events.polynomial import Polynomial
from phfmu.terms.extraction.extract import extract

#: polynomials of models without state events, as long as these are in use
_FOUND: WeakKeyDictionary[Model, Polynomial] = WeakKeyDictionary()


def polynomial_of(model: Model) -> Polynomial:
    """The states within a step of a model; its terms are extracted once."""
    if model.events is not None:
        return model.events.polynomial
    if model not in _FOUND:
        scheme = model.scheme
        layout = step_layout(extract(model.declaration, joint=scheme.joint), scheme)
        _FOUND[model] = Polynomial(layout, scheme.nodes, scheme.maps(layout))
    return _FOUND[model]
