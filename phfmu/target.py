"""Targets of commands: the name of a component or scene of the library, a function of a file, a package of SSP, a grid.

A name and a function may be called with arguments: `chain(n=20)`, `coil.py:coil(R=2.0)`.
"""

from __future__ import annotations

from collections.abc import Iterable, Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import TYPE_CHECKING, Any

from phfmu.arguments import TargetError, parsed
from phfmu.files import GRIDS

if TYPE_CHECKING:
    from phfmu.network.scene import Scene

__all__ = ["TargetError", "function_name", "functions", "is_fmu", "is_grid", "is_ssp", "load", "require_known", "scene"]


def is_fmu(target: str) -> bool:
    return target.lower().endswith(".fmu")


def is_ssp(target: str) -> bool:
    return target.lower().endswith((".ssp", ".ssd"))


def is_grid(target: str) -> bool:
    return target.lower().endswith(GRIDS)


def load(target: str, lenient: bool = False) -> Any:
    """The component (PHDAE), Network or Scene that `target` names; TargetError or KeyError with the remedy.

    `lenient`: of a package of SSP, units of measurement that it does not define count as not told; others have none.
    """
    if ".py:" in target or target.endswith(".py"):
        return _from_file(target)
    if is_fmu(target):
        raise TargetError(f"{target} is an FMU; this verb needs a declaration (a library name or file.py:function)")
    if is_ssp(target):
        from phfmu.ssp.loading import load as load_ssp

        return load_ssp(target, lenient)
    if is_grid(target):
        from phfmu.components.grids import grid_scene
        from phfmu.importers.grid import read_grid

        return grid_scene(read_grid(target))
    from phfmu.components.library import TABLE, build, builder

    call = parsed(target, target)
    if call.name in TABLE:
        return build(call.name, **call.of(builder(call.name), target))
    if target not in TABLE and (not target or Path(target).exists() or Path(target).suffix):
        raise TargetError(
            f"{target or repr(target)} is no target; that is a name of the library, file.py:function, X.fmu, X.ssp, X.ssd, "
            "X.raw or X.m"
        )
    file = Path(f"{target}.py")
    if target not in TABLE and file.is_file():
        raise TargetError(
            f"no component or scene '{target}' in the library; for the file beside you say {_choices(file)}"
        )
    return build(call.name)


def require_known(target: str, words: Iterable[str]) -> None:
    """Raise TargetError, with what was meant, for a word that is neither of the library nor one of a verb's own `words`."""
    from phfmu.components.library import TABLE
    from phfmu.words import meant

    own = list(words)
    if not target.replace("-", "_").isidentifier() or target in TABLE or target in own or Path(f"{target}.py").exists():
        return
    close = meant(target, [*own, *TABLE], f"beside what phfmu list tells there are: {', '.join(own)}")
    raise TargetError(f"no component or scene '{target}' in the library; {close}")


def scene(target: str, lenient: bool = False) -> Scene:
    """The target as a scene; a bare component or network runs 1 s at 1 ms unless the library says otherwise.

    `lenient`: as of `load`.
    """
    from phfmu.components.library import RUNS
    from phfmu.declare.phdae import PHDAE
    from phfmu.network.network import Network
    from phfmu.network.scene import Scene

    item = load(target, lenient)
    if isinstance(item, Scene):
        return item
    if isinstance(item, PHDAE | Network):
        stop, step = RUNS.get(target.partition("(")[0], (1.0, 1e-3))
        return Scene(item.name, item, stop, step)
    kind = type(item).__name__
    raise TargetError(
        f"{target} gives {'an' if kind[0] in 'aeiou' else 'a'} {kind}; expected a PHDAE, a Network or a Scene"
    )


def functions(path: Path) -> list[str]:
    """Functions of a file that can be called without arguments, found without running it."""
    import ast

    try:
        body = ast.parse(path.read_text(encoding="utf-8")).body
    except (SyntaxError, ValueError):
        body = []
    functions = [n for n in body if isinstance(n, ast.FunctionDef) and not n.name.startswith("_")]
    names = [f.name for f in functions if len(f.args.posonlyargs + f.args.args) == len(f.args.defaults)
             and all(f.args.kw_defaults)]  # fmt: skip
    return names


def function_name(target: str) -> str:
    """The function that a target names, "" for a file without one: `chain` of `chain(n=20)`, `coil` of `coil.py:coil(R=2)`."""
    return _split(target)[2].partition("(")[0] if ".py" in target else target.partition("(")[0]


def _split(target: str) -> tuple[str, str, str]:
    """File, colon, function with its arguments, in which colons may stand."""
    file, mark, function = target.partition(".py:")
    return (f"{file}.py", ":", function) if mark else (target, "", "")


def _only(path: Path) -> str:
    """The function of a file that has one, "" where several could be meant; raises TargetError if there is none."""
    import ast

    try:
        ast.parse(path.read_text(encoding="utf-8"))
    except (SyntaxError, ValueError) as error:
        raise TargetError(f"{path}: {type(error).__name__}: {error}") from error
    found = functions(path)
    if not found:
        raise TargetError(
            f"{path} has no function that builds a model; write one that returns a component, network or scene, or begin "
            "with: phfmu new component NAME"
        )
    return found[0] if len(found) == 1 else ""


def _choices(path: Path) -> str:
    """The targets that a file may hold."""
    return " or ".join(f"{path}:{name}" for name in functions(path)) or f"{path}:function"


def _from_file(target: str) -> Any:
    import importlib.util
    import sys

    from phfmu.files import seen_from

    path_text, _, text = _split(target)
    call = parsed(text, target)
    path, function = Path(path_text), call.name
    if not path.is_file():
        raise TargetError(f"no file '{path_text}'")
    if not function:
        function = _only(path)
    if not function:
        raise TargetError(f"say which function of {path.name} builds the model: {_choices(path)}")
    # a name of its own: a file called json.py or numpy.py must not take the place of that module
    spec = importlib.util.spec_from_file_location(f"phfmu_target_{path.stem}", path)
    assert spec is not None and spec.loader is not None
    module = importlib.util.module_from_spec(spec)
    sys.modules[module.__name__] = module
    try:
        with seen_from(path.parent), modules_beside(path):
            spec.loader.exec_module(module)
    except (Exception, SystemExit) as error:
        raise TargetError(f"{_place(path, error)}: {_said(error)}") from error
    found = getattr(module, function, None)
    values = call.of(found, target) if callable(found) else {}
    if found is None:
        names = [n for n, v in vars(module).items() if callable(v) and getattr(v, "__module__", "") == module.__name__]
        raise TargetError(f"{path_text} has no function '{function}'; it has: {', '.join(names) or 'none'}")
    if not callable(found):
        return found
    try:
        with seen_from(path.parent), modules_beside(path):
            return found(**values)
    except (Exception, SystemExit) as error:
        raise TargetError(f"{_place(path, error)}, {function}: {_said(error)}") from error


@contextmanager
def modules_beside(file: Path) -> Iterator[None]:
    """Within the block modules in the folder of `file` can be imported, if no other has their name.

    They are forgotten at its end: targets of other folders may have modules of the same names, and files change.
    """
    import sys
    from importlib import invalidate_caches

    folder, before = file.absolute().parent, set(sys.modules)
    if any(Path(entry).absolute() == folder for entry in sys.path):
        yield
        return
    sys.path.append(str(folder))
    invalidate_caches()
    try:
        yield
    finally:
        sys.path.remove(str(folder))
        own = [name for name in set(sys.modules) - before if _lies_in(folder, name.partition(".")[0])]
        for name in own:
            del sys.modules[name]


def _lies_in(folder: Path, module: str) -> bool:
    """Whether a module or package was found in this folder, not below it."""
    import sys

    spec = getattr(sys.modules.get(module), "__spec__", None)
    places = [] if spec is None else [spec.origin or "", *(spec.submodule_search_locations or ())]
    return any(p in (str(folder / f"{module}.py"), str(folder / module)) for p in places)


def _place(path: Path, error: BaseException) -> str:
    """The file and the last of its lines that led to the error."""
    from traceback import extract_tb

    lines = [f.lineno for f in extract_tb(error.__traceback__) if Path(f.filename) == path.absolute()]
    return f"{path}, line {lines[-1]}" if lines else str(path)


def _said(error: BaseException) -> str:
    """Type and words of an error; the words alone where this package chose them."""
    text = error.args[0] if isinstance(error, KeyError) and error.args else error
    own = type(error).__module__.startswith("phfmu.")
    return str(text) if own else f"{type(error).__name__}: {text}"
