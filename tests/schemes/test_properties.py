"""What a scheme is, it says itself: nobody looks at its class."""

from __future__ import annotations

import ast
from pathlib import Path

import phfmu
from phfmu.schemes.collocated import Collocated
from phfmu.schemes.dirac_dissipative import DiracDissipative
from phfmu.schemes.gradient_pair import GradientPair
from phfmu.schemes.midpoint import Midpoint
from phfmu.schemes.radau import Radau
from phfmu.schemes.scheme import Scheme
from phfmu.schemes.semi_explicit import SemiExplicit
from phfmu.schemes.two_level import TwoLevel
from tests.sources import nodes

ROOT = Path(phfmu.__file__).parent
SCHEMES = (Collocated(1), DiracDissipative(), GradientPair(), Midpoint(), Radau(), SemiExplicit(), TwoLevel(1))
PROBES = {"type", "isinstance", "issubclass", "getattr", "hasattr", "vars"}


def probes(path: Path) -> list[tuple[str, int]]:
    """Calls that look at the class or the attributes of what is called a scheme."""
    names = {"scheme", *(type(s).__name__ for s in SCHEMES), "Scheme"}
    found, text = [], path.read_text(encoding="utf-8")
    for node in nodes(path) if any(name in text for name in names) else ():
        if isinstance(node, ast.Call) and isinstance(node.func, ast.Name) and node.func.id in PROBES:
            inside = {n.id for a in node.args for n in ast.walk(a) if isinstance(n, ast.Name)}
            inside |= {n.attr for a in node.args for n in ast.walk(a) if isinstance(n, ast.Attribute)}
            found += [(path.name, node.lineno)] if inside & names else []
    return sorted(found)


def test_every_scheme_states_every_property() -> None:
    stated = [n for n, v in vars(Scheme).items() if isinstance(v, property)]
    assert "node_values" in stated and len(stated) == 9
    assert [(s.name, n) for s in SCHEMES for n in stated if not hasattr(s, n)] == []


def test_schemes_of_collocation_take_values_at_nodes() -> None:
    assert [s.name for s in SCHEMES if s.node_values] == ["collocated", "radau", "two-level"]


def test_no_scheme_is_probed() -> None:
    assert [found for p in ROOT.rglob("*.py") for found in probes(p)] == []


def test_a_probe_is_seen(tmp_path: Path) -> None:
    text = (
        "type(scheme) is Collocated\nisinstance(model.scheme, TwoLevel)\ngetattr(scheme, 'k', 1)\nisinstance(x, int)\n"
    )
    (tmp_path / "a.py").write_text(text)
    assert probes(tmp_path / "a.py") == [("a.py", 1), ("a.py", 2), ("a.py", 3)]
