"""How what takes the runs of a sweep is made, here and in other processes."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace
from pathlib import Path
from typing import TYPE_CHECKING, TypeAlias, Union

from phfmu.sweeps.task import Task

if TYPE_CHECKING:
    from phfmu.declare.phdae import PHDAE
    from phfmu.network.scene import Scene
    from phfmu.runs.options import Options
    from phfmu.schemes.scheme import Scheme
    from phfmu.sweeps.crew import Runs

Target: TypeAlias = Union["Scene", "PHDAE"]


@dataclass(frozen=True)
class Recipe:
    """A target, or what gives it, and what is done with it; `keep`: folder for the whole result of each run."""

    target: Target | Callable[[], Target]
    names: tuple[str, ...]
    measures: tuple[str, ...]
    options: Options | None
    scheme: Scheme | None
    engine: str
    keep: Path | None = None

    def task(self) -> Task:
        """Declared, discretised and checked; KeyError, ValueError, DeclarationError."""
        from phfmu.declare.phdae import require_declaration
        from phfmu.discretise.model import build_model
        from phfmu.network.scene import Scene
        from phfmu.runs.options import Options
        from phfmu.signals import quantities
        from phfmu.sweeps.measures import measures
        from phfmu.sweeps.places import Places

        if self.engine not in ("native", "python"):
            raise ValueError(f"engine '{self.engine}': a sweep takes native or python")
        target = self.target() if callable(self.target) else self.target
        scene = target if isinstance(target, Scene) else None
        declaration = target.declaration() if isinstance(target, Scene) else require_declaration(target, "sweep")
        options = self.options
        if options is None:
            if scene is None:
                raise ValueError(f"{declaration.name} is no scene: options=Options(stop=.., step=..) say how it is run")
            options = Options(stop=scene.stop, step=scene.step, restart=scene.restart)
        if scene is not None and not options.events:
            options = replace(options, events=scene.events)
        model = build_model(declaration, self.scheme)
        Places(model).require_free(self.names, options.events, options.t0)
        known = [
            q.name
            for q in quantities(model)
            if q.block not in ("parameter", "tunable", "input") and not q.block.startswith("row_")
        ]
        return Task(model, self.names, measures(self.measures, known), options)

    def runs(self, task: Task | None = None) -> Runs:
        """A runner, which takes runs one after the other; another thread needs another one."""
        from phfmu.sweeps.general_runs import GeneralRuns
        from phfmu.sweeps.native_runs import NativeRuns, fits

        task = task or self.task()
        if self.engine == "native" and fits(task) and self.keep is None:
            return NativeRuns(task)
        from phfmu.engine.model import require_no_landing
        from phfmu.engine.native.native import NativeInstance
        from phfmu.engine.reference.python import PythonInstance

        if self.engine != "native":
            require_no_landing(task.model)
        return GeneralRuns(task, NativeInstance if self.engine == "native" else PythonInstance, self.keep)
