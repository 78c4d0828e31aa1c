"""Units of another tool, made by hand: descriptions in XML, and a library in C that misbehaves on request."""

from __future__ import annotations

import tempfile
import zipfile
from collections.abc import Mapping, Sequence
from pathlib import Path

import fmpy

from phfmu.engine.build.compile import compile
from phfmu.fmu.export import sources

CODE = Path(__file__).parent / "foreign_unit.c"


#: what doStep does from t = 0.25 on: ask to end the simulation (2.0: before the step, 3.0: after it)
TERMINATE = 6
#: die, never answer, print and exit with code 7, print, abort; ask to end within the step over 0.33 s
CRASH, HANG, LAST_WORDS, PRINT, ABORT, END_WITHIN = range(10, 16)
#: end the process by _exit(0), exhaust its stack, divide by zero where that is a fault, let later divisions by zero be faults
LEAVE_AT_ONCE, DEEP, TRAP, TRAPS_ON = range(16, 20)
#: what stays with the process: round upward, ignore, block and take signals, make a copy of it that comes back too
ROUND, IGNORE, FORK = range(40, 43)

#: a mass on a spring, which may forget on restore and misbehave by `mode`; {unit}: of the force
MASS = {
    "2.0": """
<ScalarVariable name="F" valueReference="20" causality="input"><Real start="0" unit="{unit}"/></ScalarVariable>
<ScalarVariable name="v" valueReference="21" causality="output"><Real unit="m/s"/></ScalarVariable>
<ScalarVariable name="q" valueReference="22" causality="output" initial="exact"><Real start="0" unit="m"/></ScalarVariable>
<ScalarVariable name="m" valueReference="23" causality="parameter"><Real start="1" unit="kg"/></ScalarVariable>
<ScalarVariable name="k" valueReference="24" causality="parameter"><Real start="0" unit="N/m"/></ScalarVariable>
<ScalarVariable name="H" valueReference="25" causality="local"><Real unit="J"/></ScalarVariable>
<ScalarVariable name="mode" valueReference="3" causality="parameter" variability="fixed"><Integer start="0"/></ScalarVariable>
<ScalarVariable name="forgets" valueReference="27" causality="parameter" variability="fixed"><Integer start="0"/></ScalarVariable>
<ScalarVariable name="keeps" valueReference="29" causality="parameter" variability="fixed"><Integer start="0"/></ScalarVariable>
<ScalarVariable name="label" valueReference="9" causality="local"><String start="a"/></ScalarVariable>
""",
    "3.0": """
<Float64 name="F" valueReference="20" causality="input" start="0" unit="{unit}"/>
<Float64 name="v" valueReference="21" causality="output" unit="m/s"/>
<Float64 name="q" valueReference="22" causality="output" initial="exact" start="0" unit="m"/>
<Float64 name="m" valueReference="23" causality="parameter" variability="fixed" start="1" unit="kg"/>
<Float64 name="k" valueReference="24" causality="parameter" variability="fixed" start="0" unit="N/m"/>
<Float64 name="H" valueReference="25" causality="local" unit="J"/>
<Int32 name="mode" valueReference="3" causality="parameter" variability="fixed" start="0"/>
<Int32 name="forgets" valueReference="27" causality="parameter" variability="fixed" start="0"/>
<Int32 name="keeps" valueReference="29" causality="parameter" variability="fixed" start="0"/>
<String name="label" valueReference="9" causality="local"/>
""",
}


#: a system of first order with feedthrough, of FMI 2.0: x' = a x + b r, s = c x + d r
FIRST_ORDER = """
<ScalarVariable name="r" valueReference="40" causality="input"><Real start="0"/></ScalarVariable>
<ScalarVariable name="s" valueReference="41" causality="output"><Real/></ScalarVariable>
<ScalarVariable name="x" valueReference="42" causality="output" initial="exact"><Real start="0"/></ScalarVariable>
<ScalarVariable name="a" valueReference="43" causality="parameter"><Real start="0"/></ScalarVariable>
<ScalarVariable name="b" valueReference="44" causality="parameter"><Real start="0"/></ScalarVariable>
<ScalarVariable name="c" valueReference="45" causality="parameter"><Real start="0"/></ScalarVariable>
<ScalarVariable name="d" valueReference="46" causality="parameter"><Real start="0"/></ScalarVariable>
<ScalarVariable name="forgets" valueReference="27" causality="parameter" variability="fixed"><Integer start="0"/></ScalarVariable>
"""


def description(
    version: str, variables: str, name: str = "foreign", saves: bool = False, before: str = "", abilities: str = ""
) -> str:
    """modelDescription.xml for Co-Simulation around `variables`; `before`: units and types; `abilities`: more attributes."""
    token, states = (
        ("guid", "canGetAndSetFMUstate") if version == "2.0" else ("instantiationToken", "canGetAndSetFMUState")
    )
    return (
        f'<?xml version="1.0" encoding="UTF-8"?>\n<fmiModelDescription fmiVersion="{version}" modelName="{name}" '
        f'{token}="1"><CoSimulation modelIdentifier="foreign" {states}="{str(saves).lower()}" {abilities}/>{before}'
        f'<DefaultExperiment stopTime="1" stepSize="0.1"/>'
        f"<ModelVariables>{variables}</ModelVariables><ModelStructure/></fmiModelDescription>"
    )


def archive(path: Path, files: Mapping[str, bytes | str]) -> Path:
    with zipfile.ZipFile(path, "w", zipfile.ZIP_DEFLATED) as out:
        for name, data in files.items():
            out.writestr(name, data)
    return path


def library(lacks: Sequence[str] = ()) -> bytes:
    """The library of foreign_unit.c, for both versions; functions that it `lacks` have other names."""
    if not lacks:
        return compile({CODE.name: CODE, **sources.headers()}).path.read_bytes()
    with tempfile.TemporaryDirectory() as folder:
        code = Path(folder) / CODE.name
        code.write_text("".join(f"#define {name} other_{name}\n" for name in lacks) + CODE.read_text())
        return compile({CODE.name: code, **sources.headers()}).path.read_bytes()


#: the terminal of the mass, whose force is of the kind {kind}
TERMINALS = """<fmiTerminalsAndIcons fmiVersion="3.0"><Terminals><Terminal name="rod.flange" matchingRule="plug">
<TerminalMemberVariable variableName="v" memberName="v" variableKind="signal"/>
<TerminalMemberVariable variableName="F" memberName="F" variableKind="{kind}"/></Terminal>
<Terminal name="bus" matchingRule="bus"><TerminalMemberVariable variableName="q" memberName="q" variableKind="signal"/></Terminal>
</Terminals></fmiTerminalsAndIcons>"""


def mass(
    path: Path,
    version: str,
    saves: bool = True,
    unit_of_force: str = "N",
    before: str = "",
    terminals: str = "",
    abilities: str = "",
    lacks: Sequence[str] = (),
) -> Path:
    """A mass on a spring as a unit of another tool; `terminals`: the kind of its force in a terminal."""
    more = {"terminalsAndIcons/terminalsAndIcons.xml": TERMINALS.format(kind=terminals)} if terminals else {}
    return unit(path, version, MASS[version].format(unit=unit_of_force), saves, before, more, abilities, lacks)


def unit(
    path: Path,
    version: str,
    variables: str,
    saves: bool = False,
    before: str = "",
    more: Mapping[str, str] | None = None,
    abilities: str = "",
    lacks: Sequence[str] = (),
) -> Path:
    """A unit with that library for this machine, and `more` files."""
    folder = fmpy.platform if version == "2.0" else fmpy.platform_tuple
    name = f"binaries/{folder}/foreign{fmpy.sharedLibraryExtension}"
    about = description(version, variables, saves=saves, before=before, abilities=abilities)
    return archive(path, {"modelDescription.xml": about, name: library(lacks), **(more or {})})
