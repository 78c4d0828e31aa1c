"""A run of one composed model."""

from __future__ import annotations

import argparse
from typing import TYPE_CHECKING

from phfmu.cli.engines import as_fmu, engine_of, instance_of
from phfmu.cli.job import Job, label
from phfmu.cli.options import scheme_of
from phfmu.network.couplings.coupling_table import MONOLITHIC

if TYPE_CHECKING:
    from phfmu.declare.phdae import PHDAE
    from phfmu.network.couplings.stepper import Stepper
    from phfmu.network.scene import Scene
    from phfmu.schemes.scheme import Scheme


def whole(args: argparse.Namespace, s: Scene, declaration: PHDAE, why: list[str]) -> Job:
    scheme, engine = scheme_of(args, declaration), engine_of(args.engine)
    if getattr(args, "audit_detail", False):
        declaration = _by_term(declaration, scheme, engine)

    def build() -> Stepper:
        from phfmu.discretise.model import build_model
        from phfmu.network.couplings.monolithic import Monolithic

        if engine == "fmu":
            from phfmu.network.couplings.unit import FMUStepper

            return FMUStepper(as_fmu(declaration, scheme, args.fmi, s.step if args.step is None else args.step))
        model = build_model(declaration, scheme)
        return Monolithic(model, instance_of(model, engine))

    return Job(s, label([scheme], f"{engine} engine", MONOLITHIC.name), engine != "fmu", build, why, scheme.order)


def _by_term(declaration: PHDAE, scheme: Scheme, engine: str) -> PHDAE:
    """The declaration with an account for each energy and resistor; ValueError where these are not told apart."""
    from phfmu.discretise.accounts import by_term

    if engine == "fmu":
        raise ValueError("--audit-detail: an FMU tells the sums of its energies only; take --engine native or python")
    if scheme.joint:
        raise ValueError("--audit-detail: a joint gradient makes one term of all energies; leave out one of the two")
    return by_term(declaration)
