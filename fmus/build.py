"""Build the FMUs of recipes.toml into this folder; `--interfaces` only rewrites the golden interface descriptions.

A golden description is the FMI 3.0 modelDescription.xml without its token: names and value references are what others
compile against, so a change of it is a change of the interface and shows in review.
"""

from __future__ import annotations

import argparse
import re
import sys
import tomllib
from pathlib import Path

from phfmu import Model, Scene, build_model, export
from phfmu.components.library import build
from phfmu.fmu.export.description import ExportedUnit
from phfmu.fmu.version import FMI3
from phfmu.schemes.named import named_scheme

HERE = Path(__file__).parent


def recipes() -> dict[str, dict]:
    """Name -> target, step and options."""
    return tomllib.loads((HERE / "recipes.toml").read_text())


def model_of(recipe: dict) -> Model:
    """The model of a recipe."""
    found = build(recipe["target"])
    declaration = found.declaration() if isinstance(found, Scene) else found
    scheme = named_scheme(declaration, recipe.get("scheme", "auto"), recipe.get("order", 2))
    return build_model(declaration, scheme)


def unit_of(recipe: dict) -> ExportedUnit:
    """What a recipe exports, without a stop time."""
    return ExportedUnit(model_of(recipe), recipe["step"], None, recipe.get("node_inputs", False))


def interface(recipe: dict) -> str:
    """The golden description of a recipe."""
    text = FMI3.description(unit_of(recipe), "TOKEN").decode()
    text = re.sub(r'generationTool="[^"]*"', 'generationTool="phfmu"', text)
    # nine digits of start values: the rest depends on the mathematical library of the machine
    return re.sub(r'start="([^"]*)"', lambda m: f'start="{_rounded(m[1])}"', text)


def _rounded(number: str) -> str:
    value = float(number)
    return f"{0.0 if abs(value) < 1e-9 else value:.9g}"


def main() -> int:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--interfaces", action="store_true")
    args = parser.parse_args()
    for name, recipe in recipes().items():
        (HERE / f"{name}.xml").write_text(interface(recipe))
        if not args.interfaces:
            nodes = recipe.get("node_inputs", False)
            for path in export(model_of(recipe), HERE, step=recipe["step"], node_inputs=nodes):
                print(path)
    return 0


if __name__ == "__main__":
    sys.exit(main())
