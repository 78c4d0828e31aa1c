"""The rule on the name of a model."""

from __future__ import annotations

from phfmu.declare.error import Problem
from phfmu.declare.phdae import PHDAE

#: the longest name of a model: with what export adds it stays a file name everywhere
LONGEST = 200


def model_name(model: PHDAE) -> list[Problem]:
    """The model's own name: free text, but of use as the name of a file."""
    found = unwritable(model)
    bad = sorted({c for c in str(model.name) if not c.isprintable() or c in "/\\"})
    if bad and not found:
        found = [_model_name(model, f"its name has {', '.join(map(repr, bad))}")]
    return found


def unwritable(model: PHDAE) -> list[Problem]:
    """Names of which no file name can be made."""
    if not isinstance(model.name, str) or not model.name.strip():
        return [_model_name(model, f"its name is {model.name!r}")]
    length = len(model.name.encode())
    if length <= LONGEST:
        return []
    return [_model_name(model, f"its name is {length} bytes long, at most {LONGEST} fit into file names")]


def _model_name(model: PHDAE, text: str) -> Problem:
    return Problem("name", f"model {str(model.name)[:40]!r}", text, "give it a short name of letters, digits and _")
