"""Recipes by which the runner of a sweep is made, here and in other processes."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace
from pathlib import Path
from typing import TYPE_CHECKING, TypeAlias, Union

from phfmu.sweeps.task import ModelTask, Task

if TYPE_CHECKING:
    from phfmu.declare.phdae import PHDAE
    from phfmu.discretise.model import Model
    from phfmu.network.scene import Scene
    from phfmu.runs.options import Options
    from phfmu.schemes.scheme import Scheme
    from phfmu.sweeps.general_runs import Make
    from phfmu.sweeps.worker_pool import Runs

Target: TypeAlias = Union["Scene", "PHDAE"]


def words_of(model: Model) -> tuple[str, ...]:
    """A model by its scheme, its numbers and its equations."""
    equations = sorted({g.kernel.function.serialize() for plan in (model.step, model.instant) for g in plan.groups})
    numbers = [v.tolist() for v in (model.p0, model.x0, model.u0, model.a0)]
    return model.name, str(model.scheme), str(numbers), *equations


@dataclass(frozen=True)
class Recipe:
    """The recipe of runs of one composed model: a target or a function that gives it, and what is varied and measured.

    keep: folder for the whole result of each run;  lanes: whether runs may be stepped side by side
    """

    target: Target | Callable[[], Target]
    names: tuple[str, ...]
    measures: tuple[str, ...]
    options: Options | None
    scheme: Scheme | None
    engine: str
    keep: Path | None = None
    lanes: bool = True

    @property
    def at_once(self) -> int:
        """Runs that are taken side by side at most."""
        from phfmu.sweeps.lanes import LANES

        return LANES if self.lanes and self.engine == "native" and self.keep is None else 1

    def task(self) -> ModelTask:
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
        words = self.engine, str(options), *words_of(model)
        return ModelTask(self.names, measures(self.measures, known), words, model, options)

    def runs(self, task: ModelTask | None = None) -> Runs:
        """A runner, which takes runs one after the other; another thread needs another one."""
        from phfmu.sweeps.general_runs import GeneralRuns, of_model
        from phfmu.sweeps.native_runs import NativeRuns, fits

        task = task or self.task()
        if self.engine == "native" and fits(task) and self.keep is None:
            return NativeRuns(task, self.lanes)
        from phfmu.engine.model import require_no_landing
        from phfmu.engine.native.native import NativeInstance
        from phfmu.engine.reference.python import PythonInstance

        if self.engine != "native":
            require_no_landing(task.model)
        engine = NativeInstance if self.engine == "native" else PythonInstance
        return GeneralRuns(task, of_model(task, engine), self.keep)


@dataclass(frozen=True)
class Steppers:
    """A target that is stepped otherwise than as one composed model: members apart, units.

    make:  values -> the stepper of a run that begins with them, and its options; each thread calls it for each of its runs
    words: all that outcomes depend on besides the values, by which a sweep that is gone on with is known
    """

    make: Make
    words: tuple[str, ...]


@dataclass(frozen=True)
class StepperRecipe:
    """The recipe of runs by steppers, as `Recipe` is of those of one composed model."""

    target: Steppers
    names: tuple[str, ...]
    measures: tuple[str, ...]
    keep: Path | None = None
    at_once: int = 1

    def task(self) -> Task:
        """The measures of the signals of a run with the declared values."""
        from phfmu.runs.rows import RunColumns
        from phfmu.sweeps.measures import measures

        stepper, options = self.target.make({})
        known = RunColumns(stepper, (), options.step).names
        return Task(self.names, measures(self.measures, known), self.target.words)

    def runs(self, task: Task | None = None) -> Runs:
        """A runner, which takes runs one after the other; another thread needs another one."""
        from phfmu.sweeps.general_runs import GeneralRuns

        return GeneralRuns(task or self.task(), self.target.make, self.keep)
