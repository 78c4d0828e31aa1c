"""The one composed model whose derivatives a verb works with: its options, and how it is made of them."""

from __future__ import annotations

import argparse
from collections.abc import Callable
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from phfmu.discretise.model import Model
    from phfmu.network.members.member import Member
    from phfmu.network.network import Network
    from phfmu.network.scene import Scene


@dataclass(frozen=True)
class OneModel:
    """A scene with the values of --set, its model, and the step [s] that was asked for or is the scene's.

    instance(steps): what steps it, about so many times
    """

    scene: Scene
    model: Model
    step: float
    instance: Callable[[float], Any]

    def settable(self) -> list[str]:
        """Names that events and data may set."""
        return self.scene.declaration().settable_names()


@dataclass(frozen=True)
class MembersApart:
    """A scene with its network, whose members are stepped apart, and the step [s]; instance(steps): a `Coupled` of it."""

    scene: Scene
    model: Network
    step: float
    instance: Callable[[float], Any]

    def settable(self) -> list[str]:
        """Names that events and data may set."""
        if self.model.units:
            return self.instance(0.0).settable()
        return self.scene.declaration().settable_names()


def add_one_model(parser: argparse.ArgumentParser) -> None:
    """--step, scheme, engine, --set, --no-check, --lenient, options of grids, --project."""
    from phfmu.cli import options, stepping
    from phfmu.cli.settings import add_settings
    from phfmu.cli.sound import add_no_check

    parser.add_argument("--step", type=float, help="communication step in s (default: the scene's)")
    options.add_scheme(parser)
    stepping.add_engine(parser, stepping.ENGINES[:3])
    add_settings(parser)
    add_no_check(parser)
    options.add_lenient(parser)
    options.add_grid(parser)
    parser.add_argument("--project", action="store_true", help="move an inconsistent start onto its constraints")


def _sound_scene(args: argparse.Namespace) -> Scene:
    """The scene of the target with the values of --set, which `check` has nothing against, nor against its events."""
    from phfmu.cli.job import with_given
    from phfmu.cli.options import scene_of
    from phfmu.cli.sound import require_sound_scene

    scene = with_given(args, scene_of(args))
    require_sound_scene(args, scene)
    if scene.events:
        require_sound_scene(args, scene, scene.events)
    return scene


def members_apart(args: argparse.Namespace, coupling: str) -> MembersApart:
    """The network of the target with all members stepped apart, units among them; raises ValueError if it is no network."""
    from phfmu.cli.options import scheme_of
    from phfmu.cli.stepping import engine_of, instance_of
    from phfmu.discretise.model import build_model
    from phfmu.network.couplings.choice.coupling_choice import named_coupling
    from phfmu.network.couplings.coupled import Coupled
    from phfmu.network.members.engine_member import EngineMember
    from phfmu.network.members.unit_member import unit_member
    from phfmu.network.network import Network

    scene = _sound_scene(args)
    network = scene.system
    if not isinstance(network, Network):
        raise ValueError(f"{args.target}: --coupling {coupling} needs a network of members")
    step = scene.step if args.step is None else args.step
    models = {n: build_model(d, scheme_of(args, d, member=True)) for n, d in network.separate(set()).items()}
    made = named_coupling(coupling, network).make

    def instance(steps: float) -> Coupled:
        engine = engine_of(args.engine)

        def member(n: str) -> Member:
            if n in models:
                return EngineMember(n, models[n], instance_of(models[n], engine, "auto", steps))
            return unit_member(n, network.units[n], step)[0]

        return Coupled(network, [member(n) for n in network.members], made)

    return MembersApart(scene, network, step, instance)


def one_model(args: argparse.Namespace) -> OneModel:
    """The model of the target; ValueError for values and events that `check` refuses, with --no-check for none."""
    from functools import partial

    from phfmu.cli.options import scheme_of
    from phfmu.cli.stepping import engine_of, instance_of
    from phfmu.discretise.model import build_model

    scene = _sound_scene(args)
    declaration = scene.declaration()
    model = build_model(declaration, scheme_of(args, declaration))
    step = scene.step if args.step is None else args.step
    return OneModel(scene, model, step, partial(instance_of, model, engine_of(args.engine), "auto"))
