"""The reference, made from the source while the site is built: signatures with docstrings, the library, the command line.

    .. reference:: declare checks     public names of phfmu that these rooms define
    .. reference:: phfmu.audit        what a module lists in `__all__`
    .. library:: component            the library's components, or its scenes
    .. verbs::                        what `phfmu VERB --help` prints

Above all stands a table of the names, a line each; with each name stands the line that imports it.

Docstrings are plain text with aligned lists of equations, units and arguments: prose is set as text, the rest as it stands.
"""

from __future__ import annotations

import inspect
import re
from collections.abc import Iterator, Mapping, Sequence
from importlib import import_module
from typing import Any, get_origin

from docutils import nodes
from sphinx.util.docutils import SphinxDirective

import phfmu
from phfmu.listed_names import listed

#: what tells a list with aligned columns from prose: an indented line, or two blanks that do not end a sentence
ALIGNED = re.compile(r"^\s|(?<![.?!]) {2,}\S")


def rendered(lines: Sequence[str]) -> Iterator[str]:
    """A docstring as reStructuredText, a paragraph after the other."""
    paragraphs = re.split(r"\n\s*\n", inspect.cleandoc("\n".join(lines)))
    for paragraph in paragraphs:
        text = paragraph.splitlines()
        if any(ALIGNED.search(line) for line in text):
            yield from (".. code-block:: text", "", *("    " + line for line in text), "")
        else:
            yield from (*map(escaped, text), "")


def escaped(line: str) -> str:
    """`code` becomes literal, all other marks of reStructuredText stay what they are."""
    parts = line.split("`")
    parts = parts if len(parts) % 2 else [line]  # marks come in pairs
    marks = re.compile(r"([\\*`|_])")
    words = (f"\\ ``{p}``\\ " if i % 2 and p.strip() else marks.sub(r"\\\1", p) for i, p in enumerate(parts))
    return "".join(words)


#: full name of what a page describes -> the module that users import it from
SHOWN: dict[str, str] = {}


def set_docstring(app: Any, what: str, name: str, thing: Any, options: Any, lines: list[str]) -> None:
    lines[:] = rendered(lines)
    if name in SHOWN:
        lines[:0] = [".. code-block:: python", "", f"    from {SHOWN[name]} import {name.rpartition('.')[2]}", ""]


def page(names: Mapping[str, str], public: Mapping[str, str]) -> list[str]:
    """A table of names and their directives; names: name -> module that defines it, public: name -> module to import it from."""
    text = [".. list-table::", "   :widths: 25 75", ""]
    for name in sorted(names, key=str.lower):
        full, thing = f"{names[name]}.{name}", getattr(import_module(names[name]), name)
        SHOWN[full] = public[name]
        text += [f"   * - :py:obj:`{name} <{full}>`", f"     - {escaped(summary(thing))}"]
    text.append("")
    for name in sorted(names, key=str.lower):
        text += described(f"{names[name]}.{name}", getattr(import_module(names[name]), name))
    return text


def summary(thing: Any) -> str:
    """The first sentence of what it says of itself; of a constant its type and, where it has one, its name."""
    if not (inspect.isclass(thing) or inspect.isroutine(thing)):
        if get_origin(thing) is not None:
            return str(thing).replace("typing.", "")
        return " ".join(
            (type(thing).__name__, *([thing.name] if isinstance(getattr(thing, "name", None), str) else []))
        )
    first = (inspect.getdoc(thing) or "").partition("\n\n")[0].replace("\n", " ")
    return re.split(r"(?<=\w[.;])\s{1,2}(?=[A-Z`])|\s{2,}", first)[0].rstrip(":;")


def described(name: str, thing: Any) -> list[str]:
    """The directive of autodoc for one name."""
    if inspect.isclass(thing):
        inherited = [] if issubclass(thing, Exception) else ["   :inherited-members:"]
        return [f".. autoclass:: {name}", "   :members:", *inherited, ""]
    return [f".. {'autofunction' if inspect.isfunction(thing) else 'autodata'}:: {name}", ""]


class Reference(SphinxDirective):
    """Public names with their docstrings."""

    required_arguments = 1
    final_argument_whitespace = True

    def run(self) -> list[nodes.Node]:
        names, public = dict[str, str](), dict[str, str]()
        for where in self.arguments[0].split():
            found = self.of_module(where) if "." in where else self.of_room(where)
            if not found:
                raise self.error(f"no public name is defined in {where}")
            names |= found
            public |= dict.fromkeys(found, where if "." in where else "phfmu")
        return self.parse_text_to_nodes("\n".join(page(names, public)))

    @staticmethod
    def of_room(room: str) -> dict[str, str]:
        owners = listed(f"{phfmu.__file__}i")
        return {name: owners[name] for name in owners if owners[name].split(".")[1] == room}

    @staticmethod
    def of_module(module: str) -> dict[str, str]:
        return dict.fromkeys(import_module(module).__all__, module)


class Library(SphinxDirective):
    """The functions that build the library's components or scenes."""

    required_arguments = 1

    def run(self) -> list[nodes.Node]:
        from phfmu.components.library import LIBRARY

        names = {name: module for name, (kind, module, _) in LIBRARY.items() if kind == self.arguments[0]}
        if not names:
            raise self.error(f"the library has no {self.arguments[0]}")
        families = {name: module.rpartition(".")[0] for name, module in names.items()}
        return self.parse_text_to_nodes("\n".join(page(names, families)))


class Verbs(SphinxDirective):
    """What the command line says of itself."""

    def run(self) -> list[nodes.Node]:
        from argparse import _SubParsersAction

        from phfmu.cli import _parser

        actions = _parser()._actions
        verbs = next(action.choices for action in actions if isinstance(action, _SubParsersAction))
        return [node for verb, parser in verbs.items() for node in self.verb(verb, parser.format_help())]

    def verb(self, name: str, text: str) -> list[nodes.Node]:
        section = nodes.section(ids=[f"phfmu-{name}"], names=[f"phfmu {name}"])
        section += nodes.title(text=f"phfmu {name}")
        section += nodes.literal_block(text, text, language="text")
        return [section]


def setup(app: Any) -> dict[str, Any]:
    app.connect("autodoc-process-docstring", set_docstring)
    app.add_directive("reference", Reference)
    app.add_directive("library", Library)
    app.add_directive("verbs", Verbs)
    return {"parallel_read_safe": True}
