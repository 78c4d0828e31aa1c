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


def whole(args: argparse.Namespace, s: Scene, declaration: PHDAE, why: list[str]) -> Job:
    scheme, engine = scheme_of(args, declaration), engine_of(args.engine)

    def build() -> Stepper:
        from phfmu.discretise.model import build_model
        from phfmu.network.couplings.monolithic import Monolithic

        if engine == "fmu":
            from phfmu.network.couplings.unit import FMUStepper

            return FMUStepper(as_fmu(declaration, scheme, args.fmi, s.step if args.step is None else args.step))
        model = build_model(declaration, scheme)
        return Monolithic(model, instance_of(model, engine))

    return Job(s, label([scheme], f"{engine} engine", MONOLITHIC.name), engine != "fmu", build, why)
