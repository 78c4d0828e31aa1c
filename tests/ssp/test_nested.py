"""Packages in packages, descriptions in packages, parameter files inside units, connectors that are arrays."""

from __future__ import annotations

import io
import zipfile
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from phfmu.cli import main
from phfmu.ssp.loading import load
from phfmu.ssp.names import DEFINITION, PACKAGE
from phfmu.ssp.structure import SSPError
from tests.fmu import foreign
from tests.ssp.documents import (
    AFTER,
    MASS,
    PLAIN,
    SPRING,
    UNITS,
    binding,
    component,
    connection,
    connectors,
    expected,
    linear,
    package,
    parameters,
    ran,
    system,
)
from tests.ssp.packages import document, pack

OUTSIDE = ("speed", "output", "m/s"), ("push", "input", "N")
#: a system around the mass, with connectors of its own
AXLE = system(
    component("cart", "mass", MASS),
    connections=(connection("cart:flange.velocity", ":speed"), connection(":push", "cart:flange.force")),
    more=connectors(OUTSIDE),
)
JOINED = (connection("axle:speed", "coil:a.velocity"), connection("coil:a.force", "axle:push", linear(-1)))


def packed(files: dict[str, bytes | str]) -> bytes:
    stream = io.BytesIO()
    with zipfile.ZipFile(stream, "w") as out:
        for name, data in files.items():
            out.writestr(name, data)
    return stream.getvalue()


def nested(kind: str, source: str, of=OUTSIDE, more: str = "") -> str:
    return f'<ssd:Component name="axle" type="{kind}" source="{source}">{connectors(of)}{more}</ssd:Component>'


def around(element: str) -> str:
    return system(element, component("coil", "spring", SPRING), connections=JOINED)


def whole(
    folder: Path, units: dict[str, bytes], element: str, files: dict[str, bytes | str], after: str = AFTER
) -> Path:
    content = document(around(element), after=after)
    return pack(
        folder / "pair.ssp",
        {"resources/spring.fmu": units["resources/spring.fmu"], **files, "SystemStructure.ssd": content},
    )


def kinds(
    units: dict[str, bytes], axle: str = AXLE, after: str = AFTER
) -> dict[str, tuple[str, str, dict[str, bytes | str]]]:
    """Name -> type and source of the component, and the files."""
    inner, fmu = document(axle, after=after), {"resources/mass.fmu": units["resources/mass.fmu"]}
    return {
        "package": (PACKAGE, "parts/axle.ssp", {"parts/axle.ssp": packed({"SystemStructure.ssd": inner, **fmu})}),
        "variant": (PACKAGE, "parts/axle.ssp#light.ssd", {
            "parts/axle.ssp": packed({"SystemStructure.ssd": "<nonsense/>", "light.ssd": inner, **fmu})}),
        "definition": (DEFINITION, "parts/axle.ssd", {
            "parts/axle.ssd": inner, "parts/resources/mass.fmu": units["resources/mass.fmu"]}),
    }  # fmt: skip


@pytest.mark.parametrize("kind", ["package", "variant", "definition"])
def test_a_package_in_a_package_runs_as_a_nested_system(units: dict[str, bytes], tmp_path: Path, kind: str) -> None:
    type_, source, files = kinds(units)[kind]
    rows = ran(whole(tmp_path, units, nested(type_, source), files))
    flat = f'<ssd:System name="axle">{AXLE}</ssd:System>'
    same = ran(package(tmp_path, units, around(flat)))
    np.testing.assert_array_equal(rows["axle_cart.v"], same["axle_cart.v"])
    assert np.abs(rows["axle_cart.v"] - expected(rows["time"])).max() <= 1e-3


def test_values_bound_outside_count_more_than_those_inside(units: dict[str, bytes], tmp_path: Path) -> None:
    inside = binding(
        inside=f"<ssd:ParameterValues>{parameters(('cart.m', 5.0, ''), ('cart.q', 0.0, ''))}</ssd:ParameterValues>"
    )
    type_, source, files = kinds(units, connectors(OUTSIDE) + inside + AXLE.removeprefix(connectors(OUTSIDE)))[
        "package"
    ]
    rows = ran(whole(tmp_path, units, nested(type_, source), files))
    assert np.abs(rows["axle_cart.v"] - expected(rows["time"], m=5.0)).max() <= 1e-3
    outside = inside.replace('value="5.0"', 'value="3.0"')
    rows = ran(whole(tmp_path, units, nested(type_, source, more=outside), files))
    assert np.abs(rows["axle_cart.v"] - expected(rows["time"], m=3.0)).max() <= 1e-3


def test_packages_that_do_not_fit_are_refused(units: dict[str, bytes], tmp_path: Path) -> None:
    type_, source, files = kinds(units)["package"]
    with pytest.raises(SSPError, match=r"'axle' has no connector 'sped'; did you mean speed"):
        load(whole(tmp_path, units, nested(type_, source, (("sped", "output", "m/s"),)), files))
    with pytest.raises(SSPError, match="which is not in it"):
        load(whole(tmp_path, units, nested(type_, "parts/other.ssp"), files))
    with pytest.raises(SSPError, match="leaves the archive"):
        load(whole(tmp_path, units, nested(type_, "../axle.ssp"), files))
    other = UNITS.replace('factor="1000"', 'factor="100"') + '<ssd:DefaultExperiment stopTime="0.2"/>'
    with pytest.raises(SSPError, match=r"define the unit 'kN' differently; rename one"):
        load(whole(tmp_path, units, nested(type_, source), kinds(units, after=other)["package"][2]))
    with pytest.raises(SSPError, match="of its own document; nest the system"):
        load(whole(tmp_path, units, nested(type_, "#axle"), files))


def test_packages_within_each_other_have_an_end(units: dict[str, bytes], tmp_path: Path) -> None:
    """A description that names itself."""
    endless = system(nested(DEFINITION, "SystemStructure.ssd"), more=connectors(OUTSIDE))
    with pytest.raises(SSPError, match="packages deep; at most 10 are read"):
        load(pack(tmp_path / "pair.ssp", {**units, "SystemStructure.ssd": document(endless, after=AFTER)}))


def test_parameter_files_inside_units(units: dict[str, bytes], tmp_path: Path) -> None:
    def with_file(name: str, data: str) -> bytes:
        stream = io.BytesIO(units["resources/mass.fmu"])
        with zipfile.ZipFile(stream, "a") as archive:
            archive.writestr(name, data)
        return stream.getvalue()

    own = {**units, "resources/mass.fmu": with_file("resources/heavy.ssv", parameters(("m", 4.0, "")))}
    bound = binding("resources/heavy.ssv").replace(
        "ParameterBinding source", 'ParameterBinding sourceBase="component" source'
    )
    content = system(component("cart", "mass", MASS, bound), component("coil", "spring", SPRING), connections=PLAIN)
    rows = ran(package(tmp_path, own, content))
    assert np.abs(rows["cart.v"] - expected(rows["time"], m=4.0)).max() <= 1e-3
    with pytest.raises(SSPError, match=r"mass\.fmu has no file 'resources/light\.ssv'"):
        load(package(tmp_path, own, content.replace("heavy", "light")))
    outer = content.replace(bound, "").replace("<ssd:Elements>", bound + "<ssd:Elements>", 1)
    with pytest.raises(SSPError, match="is to be inside a unit, but a system binds it"):
        load(package(tmp_path, own, outer))


ARRAYS = """
<Float64 name="wide" valueReference="6" causality="output"><Dimension start="2"/></Float64>
<Float64 name="x" valueReference="8" causality="input" start="3 4"><Dimension start="2"/></Float64>
"""


def array(name: str, kind: str, *sizes: int | None) -> str:
    told = "".join("<ssc:Dimension/>" if n is None else f'<ssc:Dimension size="{n}"/>' for n in sizes)
    return f'<ssd:Connector name="{name}" kind="{kind}"><ssc:Float64/>{told}</ssd:Connector>'


def arrays(folder: Path, *connections: str, size: int | None = 2) -> Path:
    """Two units of FMI 3.0 with an output and an input that are arrays, in SSP 2.0."""
    ends = array("wide", "output", size) + array("x", "input", 2)
    listed = f"<ssd:Connectors>{ends}</ssd:Connectors>"
    both = [f'<ssd:Component name="{n}" source="resources/two.fmu">{listed}</ssd:Component>' for n in ("one", "other")]
    content = system(*both, connections=connections)
    unit = foreign.unit(folder / "two.fmu", "3.0", ARRAYS, abilities='canHandleVariableCommunicationStepSize="true"')
    files = {"resources/two.fmu": unit.read_bytes(), "SystemStructure.ssd": document(content, "2.0")}
    return pack(folder / "arrays.ssp", files)


def wires(path: Path) -> list[str]:
    net: Any = load(path).system
    return [f"{w.source}.{w.output} -> {w.target}.{w.input}" for w in net.wires]


@pytest.mark.usefixtures("compiler")
def test_arrays_are_connected_entry_by_entry(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    path = arrays(tmp_path, connection("one:wide", "other:x"))
    assert wires(path) == ["one.wide[1] -> other.x[1]", "one.wide[2] -> other.x[2]"]
    assert main(["run", str(path), "--coupling", "jacobi", "--step", "0.1"]) == 0
    chosen = connection("one:wide", "other:x", more=' startIndices="2" endIndices="1"')
    assert wires(arrays(tmp_path, chosen)) == ["one.wide[2] -> other.x[1]"]


@pytest.mark.usefixtures("compiler")
def test_arrays_that_do_not_fit_are_refused(tmp_path: Path) -> None:
    one = connection("one:wide", "other:x")
    with pytest.raises(SSPError, match=r"one.wide - other.x: joins an array of 3 and an array of 2; connect entries"):
        load(arrays(tmp_path, one, size=3))
    with pytest.raises(SSPError, match="'one.wide' is an array of unknown size; give each Dimension a size"):
        load(arrays(tmp_path, one, size=None))
    with pytest.raises(SSPError, match=r"'one' has no connector 'wide\[7\]'"):
        load(arrays(tmp_path, connection("one:wide", "other:x", more=' startIndices="7" endIndices="1"')))


BUS = ("speed", "inout", "m/s"), ("push", "inout", "N")


def dictionary(*names: str, called: str = "bus") -> str:
    listed = "".join(f'<ssb:DictionaryEntry name="{n}"><ssc:Real/></ssb:DictionaryEntry>' for n in names)
    inline = f'<ssb:SignalDictionary version="1.0">{listed}</ssb:SignalDictionary>'
    own = f'<ssd:SignalDictionary name="{called}">{inline}</ssd:SignalDictionary>'
    return f"<ssd:SignalDictionaries>{own}</ssd:SignalDictionaries>"


def reference(name: str, of=BUS, called: str = "bus") -> str:
    return f'<ssd:SignalDictionaryReference name="{name}" dictionary="{called}">{connectors(of)}</ssd:SignalDictionaryReference>'


def by_dictionary(coil: str = reference("there"), signals: str = dictionary("speed", "push")) -> str:
    """The mass in a system of its own puts its speed into a dictionary around it, and takes the force out."""
    inner = system(
        component("cart", "mass", MASS), reference("here"),
        connections=(connection("cart:flange.velocity", "here:speed"), connection("here:push", "cart:flange.force")),
    )  # fmt: skip
    ends = connection("there:speed", "coil:a.velocity"), connection("coil:a.force", "there:push", linear(-1))
    outer = system(
        f'<ssd:System name="axle">{inner}</ssd:System>', component("coil", "spring", SPRING), coil, connections=ends
    )
    return outer + signals


def test_signals_go_through_dictionaries(units: dict[str, bytes], tmp_path: Path) -> None:
    rows = ran(package(tmp_path, units, by_dictionary()))
    assert np.abs(rows["axle_cart.v"] - expected(rows["time"])).max() <= 1e-3
    same = ran(package(tmp_path, units, around(f'<ssd:System name="axle">{AXLE}</ssd:System>')))
    np.testing.assert_array_equal(rows["axle_cart.v"], same["axle_cart.v"])


def test_dictionaries_that_do_not_fit_are_refused(units: dict[str, bytes], tmp_path: Path) -> None:
    def refused(content: str, match: str) -> None:
        with pytest.raises(SSPError, match=match):
            load(package(tmp_path, units, content))

    refused(
        by_dictionary(reference("there", called="rail")),
        "'there' refers to the signal dictionary 'rail', which no system",
    )
    refused(
        by_dictionary(signals=dictionary("speed", "pull")),
        "'bus' has no entry 'push'; there are: speed, pull|did you mean",
    )
    twice = by_dictionary().replace(
        connection("there:speed", "coil:a.velocity"), connection("coil:a.force", "there:push")
    )
    refused(twice, "is fed twice")
    both = system(reference("one"), reference("two"), connections=(connection("one:speed", "two:push"),))
    refused(both + dictionary("speed", "push"), "both are entries of dictionaries")
    refused(by_dictionary(signals=""), "refers to the signal dictionary 'bus'")
