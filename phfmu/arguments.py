"""Arguments of the function that a target names, as in `chain(n=20)` or `coil.py:coil(R=2)`: read, and told by `phfmu info`."""

from __future__ import annotations

import ast
import inspect
import re
from collections.abc import Callable, Mapping
from dataclasses import dataclass, field
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from phfmu.declare.phdae import PHDAE
    from phfmu.declare.variable import Variable


class TargetError(ValueError):
    """The target cannot be found or built."""


@dataclass(frozen=True)
class TargetCall:
    """The function that is called, by its name, and values by place and by name."""

    name: str
    places: tuple[Any, ...] = ()
    names: Mapping[str, Any] = field(default_factory=dict[str, Any])

    def of(self, function: Callable[..., Any], target: str) -> dict[str, Any]:
        """The values by name; TargetError for those that the function does not take."""
        if not (self.places or self.names):
            return {}
        signature = inspect.signature(function)
        try:
            return dict(signature.bind_partial(*self.places, **self.names).arguments)
        except TypeError as error:
            plain = signature.replace(
                parameters=[p.replace(annotation=p.empty) for p in signature.parameters.values()],
                return_annotation=inspect.Signature.empty,
            )
            raise TargetError(f"{target}: {error}; it is {self.name}{plain} (phfmu info {self.name})") from None


def parsed(text: str, target: str) -> TargetCall:
    """`chain(n=20, dim=2)` as a call with numbers, texts, True, False, None, and lists of these; TargetError for all else."""
    name, bracket, _ = text.partition("(")
    if not bracket:
        return TargetCall(name)
    try:
        made = ast.parse(text.strip(), mode="eval").body
        if not isinstance(made, ast.Call) or not isinstance(made.func, ast.Name):
            raise ValueError
        named = {k.arg: ast.literal_eval(k.value) for k in made.keywords if k.arg}
        return TargetCall(made.func.id, tuple(map(ast.literal_eval, made.args)), named)
    except (ValueError, SyntaxError):
        remedy = (
            "write NAME(argument=value, ..) in quotes, values being numbers, texts, True, False, None or lists of these"
        )
        raise TargetError(f"{target}: its arguments cannot be read; {remedy}, e.g. 'chain(n=20)'") from None


@dataclass(frozen=True)
class Argument:
    """One argument: its unit ("" where nothing tells it), its value here as text, what it is."""

    name: str
    unit: str
    value: str
    about: str


def arguments(function: Callable[..., Any], build: Callable[..., Any], given: Mapping[str, Any]) -> list[Argument]:
    """Arguments of a function that builds a model, with the values that are `given`, else their defaults.

    `build(**values)` calls it, with example values for what has no default.
    Units and words are those of the variable of the same name, which what is optional has where it is given; else the
    docstring's: `frequency [Hz]`.
    """
    found = list(inspect.signature(function).parameters.values())
    optional = {p.name: 1.0 for p in found if p.default is None and "float" in str(p.annotation)}
    known = _variables(build, optional) | _variables(build, {})
    return [_argument(p, known.get(p.name), function.__doc__ or "", given) for p in found]


def _argument(p: inspect.Parameter, v: Variable | None, text: str, given: Mapping[str, Any]) -> Argument:
    number = any(word in str(p.annotation) for word in ("float", "Sequence", "Phases", "tuple", "Any"))
    unit = v.unit if v is not None else _unit(p.name, text) if number else ""
    about = [v.description] if v is not None and v.description else []
    if p.default is None:
        about.append("optional, absent unless given")
    if p.default is p.empty:
        about.append("must be given in Python")
    elif p.name in given and given[p.name] != p.default:
        about.append(f"{p.default!r} by default")
    value = given.get(p.name, "" if p.default is p.empty else p.default)
    return Argument(p.name, unit, "" if value is p.empty else repr(value), "; ".join(about))


def _unit(name: str, text: str) -> str:
    """The unit that a docstring gives a name, in the same clause: `R [ohm]`, "`i`: start currents [A]", "k1, k2 [N/m]"."""
    found = re.search(rf"(?<![\w.\[(])`?{name}`?(?!\w)(?:[^\[\]();=`\n]|`, `)*\[([\w./]+)\]", text)
    return found[1] if found else ""


def _variables(build: Callable[..., Any], values: Mapping[str, Any]) -> dict[str, Variable]:
    """Variables of the declaration that is built, by name; {} for a network, or if it cannot be built with these values."""
    from phfmu.declare.phdae import PHDAE

    try:
        made = build(**values)
    except (ValueError, TypeError, KeyError):
        return {}
    model: PHDAE | None = made if isinstance(made, PHDAE) else None
    return {} if model is None else {v.name: v for v in (*model.states, *model.algebraics, *model.parameters)}
