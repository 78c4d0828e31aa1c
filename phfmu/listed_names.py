"""Names of a package that are loaded when they are first used: the stub beside its `__init__.py` is the one list of them.

A stub has a line `from MODULE import NAME as NAME` for each name; type checkers and editors read the same lines.
"""

from __future__ import annotations

import sys
from importlib import import_module
from types import ModuleType
from typing import Any


class ListedNames(ModuleType):
    """A package whose names come from the modules that its stub lists; importing it imports none of them.

    A submodule that has the name of a function it defines does not hide that function: `package.name` is the function.
    """

    _owner: dict[str, str]

    def __getattr__(self, name: str) -> Any:
        if name not in self._owner:
            raise AttributeError(f"module '{self.__name__}' has no attribute '{name}'")
        return getattr(import_module(self._owner[name]), name)

    def __setattr__(self, name: str, value: Any) -> None:
        if not (isinstance(value, ModuleType) and name in self._owner):  # which importing a submodule sets
            super().__setattr__(name, value)

    def __dir__(self) -> list[str]:
        return sorted({*super().__dir__(), *self._owner})


def list_names(package: str) -> None:
    """Let `package`, which is being imported, have the names of its stub; its `__all__` are these, in alphabetical order."""
    module = sys.modules[package]
    owner = listed(f"{module.__file__}i")
    vars(module).update(_owner=owner, __all__=sorted(owner))
    module.__class__ = ListedNames


def listed(stub: str) -> dict[str, str]:
    """Name -> the module that defines it, as a stub lists them."""
    with open(stub, encoding="utf-8") as lines:
        words = [line.split() for line in lines if line.startswith("from ")]
    return {name: module for _, module, _, name, *_ in words}
