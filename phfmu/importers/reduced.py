"""Models of pyMOR, which is not imported here."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

from phfmu.declare.error import DeclarationError
from phfmu.declare.phdae import PHDAE
from phfmu.declare.port import Port
from phfmu.declare.variable import Variable, state
from phfmu.importers.linear import Coordinate, matrices


def from_pymor(
    model: Any,
    *,
    mu: Any = None,
    name: str | None = None,
    states: Sequence[Variable] | None = None,
    ports: Sequence[Port] | None = None,
    coordinates: Coordinate = "auto",
    description: str = "",
) -> PHDAE:
    """The declaration of a `pymor.models.iosys.PHLTIModel`, full or reduced; see `matrices` for what the others mean.

    mu: values of the parameters of a parametric model.  The model's initial data are the starts of `x` unless `states` gives
    others.  DeclarationError: no such model, discrete in time, or parametric without `mu`; and as `matrices` says.
    """
    name = name or "".join(c if c.isalnum() else "_" for c in str(getattr(model, "name", "")) or "linear")
    if not all(hasattr(model, a) for a in ("J", "R", "G", "P", "S", "N", "E", "Q", "to_matrices")):
        raise DeclarationError(
            name, f"is a {type(model).__name__}, not a PHLTIModel",
            "a passive LTIModel has a port-Hamiltonian form: PHLTIModel.from_passive_LTIModel(model)", "type",
        )  # fmt: skip
    if model.sampling_time:
        raise DeclarationError(name, f"is discrete in time (sampling time {model.sampling_time:g} s)",
                               "give the model in continuous time", "type")  # fmt: skip
    if model.parametric:
        if mu is None:
            raise DeclarationError(name, f"depends on {', '.join(model.parameters)}", "give their values as mu", "type")
        mu = model.parameters.parse(mu)
    J, R, G, P, S, N, E, Q = model.to_matrices(mu=mu)
    if states is None and model.initial_data is not None:
        start = model.initial_data.as_range_array(mu).to_numpy().ravel()
        states = (state("x", len(start), start=start),)
    return matrices(
        J, R, G, P=P, S=S, N=N, E=E, Q=Q, name=name, states=states, ports=ports, coordinates=coordinates,
        description=description,
    )  # fmt: skip
