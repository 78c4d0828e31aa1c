"""Packages made by hand: nested systems, units, transformations, parameter sets; and what is refused, in one clear line."""

from __future__ import annotations

import zipfile
from pathlib import Path

import numpy as np
import pytest

from phfmu.cli import main
from phfmu.fmu.export.variables import FMUError
from phfmu.ssp.loading import load
from phfmu.ssp.structure import SSPError
from tests.ssp.documents import (
    AFTER,
    BOTH,
    MASS,
    PLAIN,
    SPRING,
    binding,
    cart,
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
from tests.ssp.packages import SPACES, document, pack, unpacked


def test_plain_connections_run(units: dict[str, bytes], tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    """No annotation; against the exact swing of a mass on a spring.  A bare .ssd beside its units does too."""
    path = package(tmp_path, units, system(*BOTH, connections=PLAIN))
    rows = ran(path)
    assert rows["time"][-1] == pytest.approx(0.2) and len(rows) == 21  # stop of the package, step of the units
    np.testing.assert_allclose(rows["cart.v"], expected(rows["time"]), atol=2e-4)
    with zipfile.ZipFile(path) as archive:
        archive.extractall(tmp_path / "bare")
    bare = ran(tmp_path / "bare" / "SystemStructure.ssd")
    for name in rows.dtype.names or ():
        np.testing.assert_array_equal(bare[name], rows[name])
    assert main(["run", str(path)]) == 0
    said = capsys.readouterr().out
    assert "cart_flange_coil_a" in said and "closed" in said and "violated" not in said


def test_settings_inputs_and_explicit_couplings_work_on_packages(units: dict[str, bytes], tmp_path: Path) -> None:
    path = package(tmp_path, units, system(*BOTH, connections=PLAIN))
    heavy = ran(path, "--set", "cart.m=8")
    np.testing.assert_allclose(heavy["cart.v"], expected(heavy["time"], m=8.0), atol=2e-4)
    explicit = ran(path, "--coupling", "jacobi", "--step", "1e-3")
    np.testing.assert_allclose(explicit["cart.v"], expected(explicit["time"]), atol=1e-2)
    assert np.abs(explicit["cart.v"] - expected(explicit["time"])).max() > 1e-4  # of order 1


def test_nested_systems_units_and_transformations(units: dict[str, bytes], tmp_path: Path) -> None:
    """The force leaves a subsystem in kN, the velocity comes in against the direction of its connection."""
    outside = ("v", "input", "m/s"), ("F", "output", "kN")
    inner = system(
        component("coil", "spring", SPRING), more=connectors(outside),
        connections=(connection("coil:a.velocity", "v"), connection("coil:a.force", "F")),
    )  # fmt: skip
    content = system(
        component("cart", "mass", MASS), f'<ssd:System name="front axle">{inner}</ssd:System>',
        connections=(
            connection("cart:flange.velocity", "front axle:v"),
            connection("front axle:F", "cart:flange.force", linear(-1)),
        ),
    )  # fmt: skip
    rows = ran(package(tmp_path, units, content))
    np.testing.assert_allclose(rows["cart.v"], expected(rows["time"]), atol=2e-4)
    assert "front_axle_coil.e" in (rows.dtype.names or ())
    # 1000 instead of the conversion
    other = connection("coil:a.force", "F", linear(1e-3), ' suppressUnitConversion="true"')
    same = content.replace(connection("coil:a.force", "F"), other)
    assert same != content
    np.testing.assert_array_equal(ran(package(tmp_path, units, same))["cart.v"], rows["cart.v"])


def test_parameter_sets_prefixes_mappings_and_what_counts_most(units: dict[str, bytes], tmp_path: Path) -> None:
    """Inline below, files above: outer systems count more, tonnes become kilograms, a mapping renames."""
    own = binding(inside=f"<ssd:ParameterValues>{parameters(('m', 7.0, ''))}</ssd:ParameterValues>")
    content = system(
        component("cart", "mass", MASS, own), component("coil", "spring", SPRING), connections=PLAIN,
        more=binding("heavy.ssv", prefix="cart."),
    )  # fmt: skip
    mass_unit = '<ssv:Units><ssc:Unit name="t"><ssc:BaseUnit kg="1" factor="1000"/></ssc:Unit></ssv:Units>'
    heavy = parameters(("m", 0.005, "t"), ("nobody", 1.0, ""), units=mass_unit)
    path = package(tmp_path, units, content, heavy_ssv=heavy)
    scene = load(path)
    assert scene.system.members["cart"].starts == {"m": 5.0}
    assert scene.notes == ("cart has no variable 'nobody'; its value 1 is ignored",)
    rows = ran(path)
    np.testing.assert_allclose(rows["cart.v"], expected(rows["time"], m=5.0), atol=2e-4)

    mapped = (
        f'<ssm:ParameterMapping {SPACES} version="1.0"><ssm:MappingEntry source="weight" target="cart.m">'
        '<ssc:LinearTransformation factor="0.1" offset="1"/></ssm:MappingEntry></ssm:ParameterMapping>'
    )
    bound = binding("set.ssv", '<ssd:ParameterMapping source="names.ssm"/>')
    content = system(*BOTH, connections=PLAIN, more=bound)
    values = parameters(("weight", 60.0, ""), ("cart.m", 9.0, ""))
    path = package(tmp_path, units, content, set_ssv=values, names_ssm=mapped)
    assert load(path).system.members["cart"].starts == {"m": 7.0}


def test_values_at_connectors_of_systems_are_handed_on(units: dict[str, bytes], tmp_path: Path) -> None:
    inner = system(
        component("coil", "spring", SPRING),
        more=connectors((("v", "input", "m/s"), ("F", "output", "N"), ("stiffness", "parameter", "N/m"))),
        connections=(
            connection("v", "coil:a.velocity"),
            connection("coil:a.force", "F"),
            connection("stiffness", "coil:k", linear(2.0)),
        ),
    )
    values = binding(inside=f"<ssd:ParameterValues>{parameters(('axle.stiffness', 45.0, ''))}</ssd:ParameterValues>")
    content = system(
        component("cart", "mass", MASS), f'<ssd:System name="axle">{inner}</ssd:System>', more=values,
        connections=(connection("cart:flange.velocity", "axle:v"), connection("axle:F", "cart:flange.force", linear(-1))),
    )  # fmt: skip
    path = package(tmp_path, units, content)
    assert load(path).system.members["axle_coil"].starts == {"k": 90.0}


# -- refused ----------------------------------------------------------------------------------------------------------


def joined(*connections: str) -> str:
    return system(*BOTH, connections=connections)


def elsewhere(attributes: str) -> str:
    return system(f'<ssd:Component name="cart" {attributes}/>')


def bound(name: str) -> str:
    values = f"<ssd:ParameterValues>{parameters((name, 1.0, ''))}</ssd:ParameterValues>"
    return system(*BOTH, more=binding(inside=values))


ROUND = system(
    component("coil", "spring", SPRING),
    f'<ssd:System name="axle">{connectors((("i", "input", "m/s"), ("o", "output", "m/s")))}'
    f"<ssd:Connections>{connection('i', 'o')}</ssd:Connections></ssd:System>",
    connections=(connection("axle:o", "axle:i"), connection("axle:o", "coil:a.velocity")),
)
INSIDE = '<ssd:ParameterBindings><ssd:ParameterBinding source="a.ssv" sourceBase="component"/></ssd:ParameterBindings>'
FORCE, SPEED = "coil:a.force", "cart:flange.velocity"
MAP = (
    '<ssc:BooleanMappingTransformation><ssc:MapEntry source="true" target="false"/></ssc:BooleanMappingTransformation>'
)
#: content of the root system, words of the error
BAD = {
    "missing unit": (cart(unit="mess"), "'resources/mess.fmu', which is not in it; did you mean resources/mass.fmu"),
    "outside": (elsewhere('source="../secret.fmu"'), "'../secret.fmu' leaves the archive"),
    "url": (elsewhere('source="http://x.org/a.fmu"'), "'http://x.org/a.fmu' is not the relative path"),
    "connector": (joined(connection("cart:flange.velocty", "coil:a.velocity")),
                  "'cart' has no connector 'flange.velocty'; did you mean flange.velocity"),
    "element": (joined(connection("card:flange.velocity", "coil:a.velocity")), "names the element 'card'; did you mean cart"),
    "variable": (cart((*MASS, ("flange.velocty", "output", "m/s"))),
                 "connector 'flange.velocty': resources/mass.fmu has no such variable; did you mean flange.velocity"),
    "kind": (cart((("m", "input", "kg"),)), "is of the kind input, the variable of resources/mass.fmu is parameter"),
    "direction": (joined(connection("coil:k", "cart:flange.force")),
                  "connection coil.k - cart.flange.force: both take a value"),
    "dimension": (joined(connection(FORCE, "coil:a.velocity")), "unit mismatch: 'N' (kg.m.s-2) cannot become 'm/s' (m.s-1)"),
    "scale": (cart((("flange.force", "input", "kN"),)),
              "unit mismatch: it is in 'kN', the variable of resources/mass.fmu in 'N'"),
    "undefined": (cart((("flange.force", "input", "lbf"),)), "is in 'lbf', which Units does not define"),
    "twice": (joined(*PLAIN, connection(FORCE, "cart:flange.force")),
              "cart.flange.force is fed twice: by coil.a.force and by coil.a.force"),
    "power": (joined(PLAIN[0], connection(FORCE, "cart:flange.force")),
              "create power: the flow of cart.flange counts into it, that of coil.a into it. "
              "a.force -> flange.force needs the factor -1"),
    "ratio": (joined(PLAIN[0], connection(FORCE, "cart:flange.force", linear(-2))),
              "ports are joined with the factors 1 and -1"),
    "one way": (joined(PLAIN[0]), "a.velocity belongs to the power port coil.a. Connect a.force back to a port of cart too"),
    "mapping": (joined(connection(SPEED, "coil:a.velocity", MAP)), "BooleanMappingTransformation, which is not read"),
    "names": (system(component("a b", "mass", MASS), component("a_b", "mass", MASS)), "would both be called 'a_b'"),
    "same": (system(*BOTH[:1], *BOTH[:1]), "two elements of the system 'pair' are called 'cart'"),
    "empty": ("", "the system has no components"),
    "schema": (system("<ssd:Part/>"), "not what SSP 1.0 allows: Element 'ssd:Part'"),
    "model exchange": (elsewhere('source="resources/mass.fmu" implementation="ModelExchange"'),
                       "component 'cart' is ModelExchange; this reads FMUs for Co-Simulation"),
    "package in a package": (elsewhere('source="other.ssp" type="application/x-ssp-package"'), "'other.ssp', which is not in it"),
    "another type": (elsewhere('source="other.jar" type="application/java"'),
                     "component 'cart' is application/java; this reads FMUs"),
    "binding": (system(*BOTH, more=binding("nothing.ssv")), "'nothing.ssv', which is not in it"),
    "circle": (ROUND, "connections go round in a circle at axle."),
    "inside": (system(*BOTH, more=INSIDE), "'a.ssv' is to be inside a unit, but a system binds it"),
    "calculated": (bound("cart.energy.stored"), "cart.energy.stored is calculated"),
}  # fmt: skip


@pytest.mark.parametrize("case", BAD)
def test_bad_structures_are_refused_in_one_line(
    units: dict[str, bytes], tmp_path: Path, case: str, capsys: pytest.CaptureFixture[str]
) -> None:
    content, words = BAD[case]
    path = package(tmp_path, units, content)
    assert main(["run", str(path)]) == 2
    said = capsys.readouterr().err
    assert words in said
    (line,) = said.splitlines()
    assert line.startswith(f"phfmu: {path}")
    with pytest.raises((SSPError, FMUError)):
        load(path)


def test_units_of_measurement_that_are_not_defined_may_be_left_open(
    units: dict[str, bytes], tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    """As connectors and parameters of some tools have them; values are taken as they are, which a line says."""
    odd = tuple((n, k, "[N]" if u == "N" else u) for n, k, u in MASS)
    values = binding(inside=f"<ssd:ParameterValues>{parameters(('cart.m', 2.0, '[kg]'))}</ssd:ParameterValues>")
    (tmp_path / "odd").mkdir(), (tmp_path / "plain").mkdir()
    path = package(
        tmp_path / "odd", units, system(component("cart", "mass", odd), BOTH[1], connections=PLAIN, more=values)
    )
    lines = (
        "connector 'flange.force' is in '[N]', which Units does not define",
        "'cart.m' is in '[kg]', which Units does not define",
    )
    for verb in ("run", "info"):
        assert main([verb, str(path)]) == 2
        said = capsys.readouterr().err
        assert lines[1] in said and "--lenient goes on" in said
        assert main([verb, str(path), "--lenient"]) == 0
        said = capsys.readouterr().out
        assert all(said.count(line) == 1 for line in lines)
    plain = binding(inside=f"<ssd:ParameterValues>{parameters(('cart.m', 2.0, ''))}</ssd:ParameterValues>")
    same = package(tmp_path / "plain", units, system(*BOTH, connections=PLAIN, more=plain))
    rows = ran(same), ran(path, "--lenient")
    np.testing.assert_array_equal(rows[1]["cart.v"], rows[0]["cart.v"])
    for verb in ("run", "info"):
        assert main([verb, "oscillator", "--lenient"]) == 2
        assert "--lenient is for packages of SSP" in capsys.readouterr().err


def test_hostile_documents_and_archives_are_refused(units: dict[str, bytes], tmp_path: Path) -> None:
    good = document(system(*BOTH, connections=PLAIN), after=AFTER)
    entity = '<!DOCTYPE x [<!ENTITY e SYSTEM "file:///etc/passwd">]>' + good.replace("pair", "&e;")
    for name, files, words in (
        ("entity", {"SystemStructure.ssd": entity}, "document type definition"),
        ("traversal", {"SystemStructure.ssd": good, "../evil.fmu": b""}, "which leaves its folder"),
        ("nothing", {"other.ssd": good}, "has no SystemStructure.ssd"),
        ("torn", {"SystemStructure.ssd": good[:-20]}, "not well formed"),
        ("other", {"SystemStructure.ssd": "<html/>"}, "the root is 'html'"),
        ("future", {"SystemStructure.ssd": good.replace('version="1.0"', 'version="7.0"')}, "SSP version '7.0'"),
    ):
        with pytest.raises((SSPError, FMUError), match=words):
            load(pack(tmp_path / f"{name}.ssp", units | files))
    assert not (tmp_path.parent / "evil.fmu").exists()
    (tmp_path / "text.ssp").write_text("no archive")
    with pytest.raises(FMUError, match="not a readable archive"):
        load(tmp_path / "text.ssp")
    with pytest.raises(SSPError, match="no such file"):
        load(tmp_path / "nowhere.ssp")


def test_an_annotation_that_the_connections_contradict_is_refused(written: dict[str, Path], tmp_path: Path) -> None:
    """Another tool has changed the connections and kept what it does not know."""
    files = unpacked(written["1.0"])
    text = files["SystemStructure.ssd"].decode()
    for old, new, words in (
        ('endConnector="b.velocity"', 'endConnector="a.velocity"', "fed twice"),
        ('kind="1">', 'kind="0">', "joins mass1.flange, spring12.a at 'left' .kind 0., the connections do not"),
        ('element="mass1"', 'element="mass9"', "names the unit 'mass9'; did you mean"),
        ('port="a"', 'port="q"', "names the port spring12.q; there are: a, b"),
    ):
        changed = text.replace(old, new, 1)
        assert changed != text
        with pytest.raises(SSPError, match=words):
            load(pack(tmp_path / "x.ssp", files | {"SystemStructure.ssd": changed}))
