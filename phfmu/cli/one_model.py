"""The one composed model whose derivatives a verb works with: its options, and how it is made of them."""

from __future__ import annotations

import argparse
from collections.abc import Callable
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from phfmu.discretise.model import Model
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


def one_model(args: argparse.Namespace) -> OneModel:
    """The model of the target; ValueError for values and events that `check` refuses, with --no-check for none."""
    from functools import partial

    from phfmu.cli.job import with_given
    from phfmu.cli.options import scene_of, scheme_of
    from phfmu.cli.sound import require_sound_scene
    from phfmu.cli.stepping import engine_of, instance_of
    from phfmu.discretise.model import build_model

    scene = with_given(args, scene_of(args))
    require_sound_scene(args, scene)
    if scene.events:
        require_sound_scene(args, scene, scene.events)
    declaration = scene.declaration()
    model = build_model(declaration, scheme_of(args, declaration))
    step = scene.step if args.step is None else args.step
    return OneModel(scene, model, step, partial(instance_of, model, engine_of(args.engine), "auto"))
