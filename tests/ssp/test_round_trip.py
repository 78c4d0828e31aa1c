"""What runs do not need of a description of another tool is in it again when it is written again."""

from __future__ import annotations

import zipfile
from pathlib import Path

import pytest

from phfmu.cli import main
from phfmu.fmu.xml import etree
from phfmu.ssp.schema import require_valid
from tests.ssp.documents import UNITS, connection, linear
from tests.ssp.packages import SPACES, pack

ALL = (
    '<ssd:Annotations><ssc:Annotation type="org.openmodelica"><oms:SimulationInformation xmlns:oms="http://oms" tool="4"/>'
    "</ssc:Annotation></ssd:Annotations>"
)


def port(name: str, kind: str, unit: str, x: float, more: str = "") -> str:
    return (
        f'<ssd:Connector name="{name}" kind="{kind}"{more}><ssc:Real unit="{unit}"/>'
        f'<ssd:ConnectorGeometry x="{x}" y="0.5"/></ssd:Connector>'
    )


def points(x: str, y: str) -> str:
    return f'<ssd:ConnectionGeometry pointsX="{x}" pointsY="{y}"/>'


#: as OMSimulator writes them: geometry everywhere, annotations of its own
PAIR = f"""<ssd:SystemStructureDescription {SPACES} version="1.0" name="pair" author="A. Noether" license="CC0" fileversion="7"
 copyright="none" description="two parts" id="root">
<ssd:System name="pair" description="a cart on a coil" id="top">
<ssd:ElementGeometry x1="0" y1="0" x2="9" y2="9"/>
<ssd:Elements>
<ssd:Component name="cart" source="resources/mass.fmu" description="the red cart" id="c1"><ssd:Connectors>
{port("flange.force", "input", "N", 0.0, ' description="push here"')}{port("flange.velocity", "output", "m/s", 1.0)}
</ssd:Connectors><ssd:ElementGeometry x1="1" y1="1" x2="3" y2="2" iconSource="resources/cart.png"/>{ALL}</ssd:Component>
<ssd:Component name="coil" source="resources/spring.fmu"><ssd:Connectors>
{port("a.velocity", "input", "m/s", 0.0)}{port("a.force", "output", "N", 1.0)}
</ssd:Connectors></ssd:Component>
</ssd:Elements>
<ssd:Connections>
{connection("cart:flange.velocity", "coil:a.velocity", points("4 5", "1 1"), ' description="one"')}
{connection("coil:a.force", "cart:flange.force", linear(-1) + points("6", "2"))}
</ssd:Connections>
<ssd:SystemGeometry x1="0" y1="0" x2="10" y2="10"/>
<ssd:GraphicalElements><ssd:Note x1="0" y1="0" x2="1" y2="1" text="mind the gap"/></ssd:GraphicalElements>
{ALL}
</ssd:System>
<ssd:Enumerations><ssc:Enumeration name="Gear"><ssc:Item name="low" value="1"/><ssc:Item name="high" value="2"/></ssc:Enumeration>
</ssd:Enumerations>{UNITS}<ssd:DefaultExperiment stopTime="0.2"/>{ALL}</ssd:SystemStructureDescription>"""
WORDS = (
    b'author="A. Noether"', b'license="CC0"', b'fileversion="7"', b'copyright="none"', b'description="two parts"', b'id="top"',
    b'description="a cart on a coil"', b'description="the red cart"', b'id="c1"', b'description="push here"',
    b'description="one"',
    b'iconSource="resources/cart.png"', b'text="mind the gap"', b'name="Gear"', b'name="high" value="2"', b'name="kN"',
)  # fmt: skip


def again(path: Path, folder: Path) -> tuple[Path, bytes]:
    assert main(["export", str(path), "--ssp", "-o", str(folder)]) == 0
    (written,) = folder.glob("*.ssp")
    with zipfile.ZipFile(written) as archive:
        return written, archive.read("SystemStructure.ssd")


def test_words_geometry_enumerations_and_annotations_of_others_stay(
    units: dict[str, bytes], tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    first = pack(tmp_path / "pair.ssp", units | {"SystemStructure.ssd": PAIR})
    path, text = again(first, tmp_path / "out")
    assert not [w for w in WORDS if w not in text]
    root = etree.fromstring(text)
    require_valid(root, "ssd", "written")
    kinds = [e.tag.rpartition("}")[2] for e in root.iter() if isinstance(e.tag, str)]
    for kind, n in {"ConnectorGeometry": 4, "ConnectionGeometry": 2, "ElementGeometry": 2, "SystemGeometry": 1,
                    "SimulationInformation": 3, "Note": 1}.items():  # fmt: skip
        assert kinds.count(kind) == n, kind
    bends = sorted(e.get("pointsX") for e in root.iter() if str(e.tag).endswith("ConnectionGeometry"))
    assert bends == ["4 5", "6"]
    _, twice = again(path, tmp_path / "twice")
    assert twice == text
    capsys.readouterr()
    assert main(["run", str(path), "--audit", "none"]) == 0


def test_what_is_not_kept_is_told(units: dict[str, bytes], tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    inner = """<ssd:System name="front axle"><ssd:ElementGeometry x1="0" y1="0" x2="1" y2="1"/><ssd:Elements>
<ssd:Component name="cart" source="resources/mass.fmu"><ssd:ElementGeometry x1="0" y1="0" x2="1" y2="1"/></ssd:Component>
</ssd:Elements></ssd:System>"""
    text = (
        f'<ssd:SystemStructureDescription {SPACES} version="1.0" name="pair"><ssd:System name="pair"><ssd:Elements>{inner}'
        "</ssd:Elements></ssd:System></ssd:SystemStructureDescription>"
    )
    again(pack(tmp_path / "pair.ssp", units | {"SystemStructure.ssd": text}), tmp_path / "out")
    said = "".join(capsys.readouterr())
    assert "geometry inside nested systems left out (2 elements)" in said
    assert "'front axle' is called front_axle" in said


#: as a tool may write them: spaces and elements of its own, signed
META = """<ssc:MetaData kind="general" type="application/xml"><ssc:Content> two  spaces,
\tand <dc:title xmlns:dc="http://purl.org/dc/elements/1.1/"> a  title</dc:title></ssc:Content><ssc:Signature role="authenticity"
 type="text/plain"><ssc:Content>  0x17 </ssc:Content></ssc:Signature></ssc:MetaData>"""
TOLD = '<ssc:MetaData kind="quality" type="text/plain" source="extra/how%20made.txt"/>'
SIGNED = '<ssc:Signature role="suitability" type="text/plain"><ssc:Content>17</ssc:Content></ssc:Signature>'
#: of the unit, of the system, and of the whole
SECOND = (
    PAIR.replace('version="1.0"', 'version="2.0"')
    .replace(f"{ALL}</ssd:Component>", f"{META}{TOLD}{SIGNED}{ALL}</ssd:Component>")
    .replace('y2="9"/>', f'y2="9"/>{META}', 1)
    .replace('stopTime="0.2"/>', f'stopTime="0.2"/>{META}{SIGNED}')
)


def test_meta_data_of_ssp_2_stay_to_the_last_byte(
    units: dict[str, bytes], tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    """Also the files that they name; signatures of units and of meta data stay, those of what is written anew do not."""
    files = units | {"SystemStructure.ssd": SECOND, "extra/how made.txt": b"by \r\n hand"}
    first = pack(tmp_path / "pair.ssp", files)
    assert main(["export", str(first), "--ssp", "2.0", "-o", str(tmp_path / "out")]) == 0
    assert "1 element of meta data or signatures inside what is written anew left out" in "".join(capsys.readouterr())
    with zipfile.ZipFile(tmp_path / "out" / "pair.ssp") as archive:
        text = archive.read("SystemStructure.ssd")
        assert archive.read("extra/how made.txt") == files["extra/how made.txt"]
    one_line = META.replace('"authenticity"\n type', '"authenticity" type')  # a line between attributes is no content
    assert text.count(one_line.encode()) == 3 and text.count(TOLD.encode()) == 1 and text.count(SIGNED.encode()) == 1
    require_valid(etree.fromstring(text), "ssd", "written")
    assert main(["export", str(first), "--ssp", "1.0", "-o", str(tmp_path / "old")]) == 0
    assert "5 elements of meta data left out: SSP 1.0 has none, --ssp 2.0 keeps them" in "".join(capsys.readouterr())


def test_ssp_2_is_read_without_its_schemas(
    units: dict[str, bytes], tmp_path: Path, capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    """With one line that it was not checked; what cannot be read says so."""
    monkeypatch.setattr("phfmu.ssp.schema._schema", lambda major, kind: None)
    files = units | {"SystemStructure.ssd": SECOND, "extra/how made.txt": b""}
    assert main(["run", str(pack(tmp_path / "pair.ssp", files)), "--audit", "none"]) == 0
    line = "not checked against the schemas of SSP 2.0, which come with: pip install phfmu[ssp]"
    assert capsys.readouterr().out.count(line) == 1
    for torn in (SECOND.replace("<ssc:BaseUnit", "<ssc:Base"), SECOND.replace("ssd:Component", "ssd:Part")):
        assert torn != SECOND
        assert main(["run", str(pack(tmp_path / "torn.ssp", files | {"SystemStructure.ssd": torn}))]) == 2
        assert (
            "phfmu: " in (said := capsys.readouterr().err)
            and "internal error" not in said
            and "SystemStructure.ssd" in said
        )
