"""Members stepped apart with derivatives beside their differences."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from typing import Any

import numpy as np

from phfmu import NativeInstance, Options, build_model, default_scheme, run
from phfmu.cli.settings import with_settings
from phfmu.derivatives.apart.sensitive_members import SensitiveMembers
from phfmu.network.couplings.coupled import Coupled
from phfmu.network.members.engine_member import EngineMember
from phfmu.network.members.member import Member
from phfmu.network.network import Network
from phfmu.signals import derivative_name
from tests.derivatives.differences import largest, richardson


def members(
    network: Network, order: int = 2, engine: Any = NativeInstance, orders: dict[str, int] | None = None
) -> list[Member]:
    """Members with schemes of these orders."""
    found = list[Member]()
    for name, d in network.separate(set()).items():
        model = build_model(d, default_scheme(d, (orders or {}).get(name, order)))
        found.append(EngineMember(name, model, engine(model)))
    return found


def rounding(column: str) -> bool:
    return "constraint." in column or column.endswith((".residual", ".gap"))


def differ(
    network: Network, by: Sequence[str], options: Options, made: Callable[[Network], list[Member]], coupling: Any
) -> dict[tuple[str, str], float]:
    """Errors of columns against extrapolated differences of coupled runs, the start left out: there junctions have the limit of
    ever shorter steps, to 1e-6."""
    stepper = SensitiveMembers(Coupled(network, made(network), coupling), by)
    found, plain = run(stepper, options), run(Coupled(network, made(network), coupling), options)
    d = network.compose()
    known = {n: x for v in (*d.parameters, *d.states) for n, x in zip(v.names(), v.start, strict=True)}
    size, errors = largest(plain), {}
    for n in by:

        def values(x: float, n: str = n) -> np.ndarray:
            other = with_settings(network, {n: x}) if n in known else network
            coupled = Coupled(other, made(other), coupling)
            if n not in known:
                coupled.set_value(n, x)
            return run(coupled, options).values

        base = known.get(n, 0.0) or 1.0
        slopes = richardson(values, known.get(n, 0.0), 1e-3 * abs(base))
        for q in (q for q in stepper.derived_names if not rounding(q)):
            i = plain.names.index(q)
            least = 1e-4 * size[plain.units[i]] / abs(base)
            own = np.abs(found.column(derivative_name(q, n)) - slopes[:, i])[1:].max()
            errors[q, n] = float(own / max(np.abs(slopes[:, i]).max(), least, 1e-12))
    return errors
