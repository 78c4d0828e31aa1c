"""Units with a planted defect: the description of a mass on a spring, and its library with a switch set when it is compiled."""

from __future__ import annotations

import re
import zipfile
from pathlib import Path

import fmpy

from phfmu.engine.build.compile import compile
from phfmu.fmu.export import sources

CODE = Path(__file__).parent / "planted.c"
#: names of defects in the library
DEFECTS = re.findall(r"^#define ([A-Z_]+) \d+ ", CODE.read_text(), re.MULTILINE)

_ABLE = 'canHandleVariableCommunicationStepSize="true" canGetAndSet{s}="true" canSerialize{s}="true"'
_UNITS = """<UnitDefinitions><Unit name="N"><BaseUnit kg="1" m="1" s="-2"/></Unit><Unit name="m"><BaseUnit m="1"/></Unit>
<Unit name="m/s"><BaseUnit m="1" s="-1"/></Unit><Unit name="s"><BaseUnit s="1"/></Unit></UnitDefinitions>"""
_PORTS = '[rod]\neffort = "F"\nflow = "v"\nsign = 1\n'
#: name, causality, variability, initial, start, unit
_VARIABLES = (
    ("F", "input", "continuous", "", "0", "N"),
    ("v", "output", "continuous", "exact", "0", "m/s"),
    ("q", "output", "continuous", "exact", "0", "m"),
    ("a", "output", "continuous", "calculated", "", ""),
    ("m", "parameter", "fixed", "exact", "1", ""),
    ("k", "parameter", "fixed", "exact", "40", ""),
    ("d", "parameter", "fixed", "exact", "{d}", ""),
    ("w", "output", "continuous", "exact", "0", ""),
)


def unit(folder: Path, version: str, defect: str = "NONE", units: str = _UNITS, abilities: str = "") -> Path:
    """The unit with its ports in a file beside it; `units`, `abilities`: of its description."""
    path = folder / f"planted_{version[0]}.fmu"
    code = folder / "planted.c"
    code.write_text(f"#define DEFECT {defect}\n{CODE.read_text()}")
    library = compile({code.name: code, **sources.headers()}).path.read_bytes()
    place = fmpy.platform if version == "2.0" else fmpy.platform_tuple
    with zipfile.ZipFile(path, "w", zipfile.ZIP_DEFLATED) as archive:
        archive.writestr("modelDescription.xml", _description(version, defect, units, abilities))
        archive.writestr(f"binaries/{place}/planted{fmpy.sharedLibraryExtension}", library)
    (folder / f"planted_{version[0]}.ports.toml").write_text(_PORTS)
    return path


def _description(version: str, defect: str, units: str, abilities: str) -> str:
    d = "-0.5" if defect == "NEGATIVE_DAMPER" else "0.5"
    listed = [_variable(version, i, *(t.format(d=d) for t in v)) for i, v in enumerate(_VARIABLES, 1)]
    if version == "2.0":
        head = f'guid="1"><CoSimulation modelIdentifier="planted" {_ABLE.format(s="FMUstate")} {abilities} '
        head += 'providesDirectionalDerivative="true"/>'
        unknowns = [f'<Unknown index="{i}" dependencies="{"1" if i == 4 else ""}"/>' for i in (2, 3, 4, 8)]
        structure = f'<Outputs>{"".join(unknowns)}</Outputs><InitialUnknowns><Unknown index="4"/></InitialUnknowns>'
    else:
        head = (
            f'instantiationToken="1"><CoSimulation modelIdentifier="planted" {_ABLE.format(s="FMUState")} {abilities} '
        )
        head += 'providesDirectionalDerivatives="true" providesAdjointDerivatives="true"/>'
        listed.append(
            '<Float64 name="time" valueReference="0" causality="independent" variability="continuous" unit="s"/>'
        )
        structure = "".join(
            f'<Output valueReference="{i}" dependencies="{"1" if i == 4 else ""}"/>' for i in (2, 3, 4, 8)
        )
        structure += '<InitialUnknown valueReference="4"/>'
    return (
        f'<?xml version="1.0" encoding="UTF-8"?>\n<fmiModelDescription fmiVersion="{version}" modelName="planted" {head}{units}'
        f'<DefaultExperiment startTime="0" stopTime="1" stepSize="0.01"/><ModelVariables>{"".join(listed)}</ModelVariables>'
        f"<ModelStructure>{structure}</ModelStructure></fmiModelDescription>"
    )


def _variable(
    version: str, i: int, name: str, causality: str, variability: str, initial: str, start: str, unit: str
) -> str:
    told = f'name="{name}" valueReference="{i}" causality="{causality}" variability="{variability}"'
    told += f' initial="{initial}"' if initial else ""
    own = (f' start="{start}"' if start else "") + (f' unit="{unit}"' if unit else "")
    return f"<ScalarVariable {told}><Real{own}/></ScalarVariable>" if version == "2.0" else f"<Float64 {told}{own}/>"
