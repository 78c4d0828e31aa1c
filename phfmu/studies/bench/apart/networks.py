"""A network composed, and its members stepped apart: what benches compare."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import replace
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from phfmu.discretise.model import Model
    from phfmu.network.couplings.coupled import Coupled
    from phfmu.network.couplings.coupling import Coupling
    from phfmu.network.couplings.stepper import Stepper
    from phfmu.network.members.engine_member import EngineMember
    from phfmu.network.network import Network


def planned(network: Network, k: int) -> dict[str, Model]:
    """Members under `Collocated(k)`; those that are alike share plans."""
    from phfmu.discretise.model import build_model
    from phfmu.schemes.collocated import Collocated

    return {name: build_model(replace(d, name=name), Collocated(k)) for name, d in network.declared.items()}


def coupled(network: Network, k: int, threads: int = 1) -> Stepper:
    """Members under `Collocated(k)` in native engines."""
    return joined(network, instances(planned(network, k)), threads)


def instances(models: Mapping[str, Model]) -> list[EngineMember]:
    from phfmu.engine.native.native import NativeInstance
    from phfmu.network.members.engine_member import EngineMember

    return [EngineMember(name, model, NativeInstance(model, kernels="compiled")) for name, model in models.items()]


def joined(
    network: Network,
    members: list[EngineMember],
    threads: int = 1,
    coupling: Coupling | None = None,
) -> Coupled:
    """The members joined by a coupling, by default by Newton's method on what they exchange at nodes."""
    from phfmu.network.couplings.coupled import Coupled
    from phfmu.network.couplings.newton import newton

    return Coupled(network, [*members], coupling or newton, threads=threads)


def composed(network: Network, k: int) -> Stepper:
    from phfmu.discretise.model import build_model
    from phfmu.engine.native.native import NativeInstance
    from phfmu.network.couplings.monolithic import Monolithic
    from phfmu.schemes.collocated import Collocated

    model = build_model(network.compose(), Collocated(k))
    return Monolithic(model, NativeInstance(model, kernels="compiled"))
