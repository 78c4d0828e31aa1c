"""Structure descriptions and packages written by hand."""

from __future__ import annotations

from pathlib import Path

import numpy as np

from phfmu.cli import main
from tests.ssp.packages import SPACES, document, pack

MASS = ("flange.force", "input", "N"), ("flange.velocity", "output", "m/s"), ("m", "parameter", "kg")
SPRING = ("a.velocity", "input", "m/s"), ("a.force", "output", "N"), ("k", "parameter", "N/m")
UNITS = """<ssd:Units>
<ssc:Unit name="N"><ssc:BaseUnit kg="1" m="1" s="-2"/></ssc:Unit>
<ssc:Unit name="kN"><ssc:BaseUnit kg="1" m="1" s="-2" factor="1000"/></ssc:Unit>
<ssc:Unit name="m/s"><ssc:BaseUnit m="1" s="-1"/></ssc:Unit>
<ssc:Unit name="kg"><ssc:BaseUnit kg="1"/></ssc:Unit>
<ssc:Unit name="t"><ssc:BaseUnit kg="1" factor="1000"/></ssc:Unit>
<ssc:Unit name="N/m"><ssc:BaseUnit kg="1" s="-2"/></ssc:Unit>
</ssd:Units>
"""
AFTER = UNITS + '<ssd:DefaultExperiment stopTime="0.2"/>'


def connectors(of: tuple[tuple[str, str, str], ...]) -> str:
    listed = "".join(f'<ssd:Connector name="{n}" kind="{k}"><ssc:Real unit="{u}"/></ssd:Connector>' for n, k, u in of)
    return f"<ssd:Connectors>{listed}</ssd:Connectors>"


def component(name: str, unit: str, of: tuple[tuple[str, str, str], ...], more: str = "") -> str:
    return f'<ssd:Component name="{name}" source="resources/{unit}.fmu">{connectors(of)}{more}</ssd:Component>'


def connection(start: str, end: str, inside: str = "", more: str = "") -> str:
    """`element:connector`; without an element a connector of the system."""
    sides = ""
    for side, text in (("start", start), ("end", end)):
        element, _, name = text.rpartition(":")
        sides += (f' {side}Element="{element}"' if element else "") + f' {side}Connector="{name}"'
    return f"<ssd:Connection{sides}{more}>{inside}</ssd:Connection>"


def linear(factor: float, offset: float = 0.0) -> str:
    return f'<ssc:LinearTransformation factor="{factor}" offset="{offset}"/>'


def system(*elements: str, connections: tuple[str, ...] = (), more: str = "") -> str:
    listed = f"<ssd:Connections>{''.join(connections)}</ssd:Connections>" if connections else ""
    return f"{more}<ssd:Elements>{''.join(elements)}</ssd:Elements>{listed}"


BOTH = component("cart", "mass", MASS), component("coil", "spring", SPRING)
PLAIN = (
    connection("cart:flange.velocity", "coil:a.velocity"),
    connection("coil:a.force", "cart:flange.force", linear(-1)),
)


def package(folder: Path, units: dict[str, bytes], content: str, after: str = AFTER, **files: str) -> Path:
    extra = {name.replace("_", "."): data for name, data in files.items()}
    return pack(folder / "pair.ssp", units | {"SystemStructure.ssd": document(content, after=after)} | extra)


def ran(path: Path, *options: str) -> np.ndarray:
    table = path.with_suffix(".csv")
    assert main(["run", str(path), "-o", str(table), "--quiet", *options]) == 0
    return np.genfromtxt(table, delimiter=",", names=True, deletechars="")


def expected(times: np.ndarray, m: float = 2.0, k: float = 40.0, v: float = 1.0) -> np.ndarray:
    """Velocity of a mass that hits a spring, exact."""
    return v * np.cos(np.sqrt(k / m) * times)


def parameters(*values: tuple[str, float, str], units: str = "") -> str:
    listed = "".join(
        f'<ssv:Parameter name="{n}"><ssv:Real value="{v}"' + (f' unit="{u}"' if u else "") + "/></ssv:Parameter>"
        for n, v, u in values
    )
    listed = f"<ssv:Parameters>{listed}</ssv:Parameters>{units}"
    return f'<ssv:ParameterSet {SPACES} version="1.0" name="p">{listed}</ssv:ParameterSet>'


def binding(source: str = "", inside: str = "", prefix: str = "") -> str:
    attributes = (f' source="{source}"' if source else "") + (f' prefix="{prefix}"' if prefix else "")
    return f"<ssd:ParameterBindings><ssd:ParameterBinding{attributes}>{inside}</ssd:ParameterBinding></ssd:ParameterBindings>"


def cart(of: tuple[tuple[str, str, str], ...] = MASS, unit: str = "mass") -> str:
    return system(component("cart", unit, of))
