"""Content of a description that no run needs, carried through to be written again: words, geometry, enumerations, meta data,
annotations of other tools.

Only the outermost system and its own components carry it; what lies deeper is taken apart when it is read, and told.  Signatures
of what is written anew would be wrong; those of units and of meta data stay.
"""

from __future__ import annotations

from collections import Counter
from collections.abc import Mapping, Sequence
from copy import deepcopy
from dataclasses import dataclass, field, replace
from urllib.parse import unquote

from phfmu.fmu.export.variables import FMUError
from phfmu.fmu.xml import Element
from phfmu.ssp.flat import identifier
from phfmu.ssp.names import PORTS, tag
from phfmu.ssp.parameters import Source
from phfmu.ssp.structure import SSPError
from phfmu.words import counted

#: attributes of elements, and those of the root besides
WORDS = ("id", "description")
ABOUT = (*WORDS, "author", "fileversion", "copyright", "license")
#: children in the order of the schema, without those that are written from the network
ROOT = ("Enumerations", "Units", "Annotations")
SYSTEM = ("ElementGeometry", "SystemGeometry", "GraphicalElements", "Annotations")
ELEMENT = ("ElementGeometry", "Annotations")
CONNECTOR = ("ConnectorGeometry", "Annotations")
CONNECTION = ("ConnectionGeometry", "Annotations")

#: where meta data stand among children
META = "MetaData"
#: elements that are written as they were read, to the last space
VERBATIM = (tag("ssc", META), tag("ssc", "Signature"))

Ends = tuple[str, str, str, str]


@dataclass(frozen=True)
class Part:
    """The kept part of one element: its attributes and children; `enumeration`: that a connector is of."""

    words: Mapping[str, str] = field(default_factory=dict)
    children: Mapping[str, Element] = field(default_factory=dict)
    enumeration: str = ""
    #: MetaData and Signature of SSP 2.0
    meta: tuple[Element, ...] = ()

    def onto(self, element: Element, *names: str) -> None:
        """Set the attributes that are not there, and add the children `names`, in this order."""
        for name, text in self.words.items():
            if name not in element.attrib:
                element.set(name, text)
        for name in names:
            if name == META:
                element.extend([deepcopy(m) for m in self.meta])
            elif name in self.children:
                element.append(deepcopy(self.children[name]))


NOTHING = Part()


@dataclass(frozen=True)
class RoundTripContent:
    """Parts of a description that no run needs: components by member; connectors by member and name; connections by both ends."""

    root: Part = NOTHING
    system: Part = NOTHING
    components: Mapping[str, Part] = field(default_factory=dict)
    connectors: Mapping[tuple[str, str], Part] = field(default_factory=dict)
    connections: Mapping[Ends, Part] = field(default_factory=dict)
    #: files of the package that meta data name
    files: Mapping[str, bytes] = field(default_factory=dict)
    #: lines about what is not
    lost: tuple[str, ...] = ()

    def of_version(self, version: str) -> RoundTripContent:
        """The content that SSP `version` can hold: without meta data, and with a line about them, where it has none."""
        parts = [self.root, self.system, *self.components.values()]
        n = sum(len(p.meta) for p in parts)
        if version != "1.0" or not n:
            return self
        components = {name: replace(p, meta=()) for name, p in self.components.items()}
        line = f"{counted(n, 'element')} of meta data left out: SSP 1.0 has none, --ssp 2.0 keeps them"
        ours = replace(self.root, meta=()), replace(self.system, meta=())
        return RoundTripContent(*ours, components, self.connectors, self.connections, {}, (*self.lost, line))

    def component(self, member: str) -> Part:
        return self.components.get(member, NOTHING)

    def connection(self, ends: Ends) -> Part:
        return self.connections.get(ends, NOTHING)

    def more_units(self, listed: Element | None) -> list[Element]:
        """Definitions of units that are not listed."""
        names = set() if listed is None else {u.get("name") for u in listed}
        return [deepcopy(u) for u in self.root.children.get("Units", ()) if u.get("name") not in names]

    def annotations(self) -> list[Element]:
        """Annotations of other tools at the system."""
        return [deepcopy(a) for a in self.system.children.get("Annotations", ())]

    def connector(self, member: str, name: str) -> Part:
        return self.connectors.get((member, name), NOTHING)


def round_trip_content(root: Element, source: Source) -> RoundTripContent:
    """The kept parts of a description that has been read."""
    system = root.find(tag("ssd", "System"))
    components, connectors = {}, {}
    for e in _within(system, "Elements"):
        if e.tag != tag("ssd", "Component"):
            continue
        member = identifier(e.get("name", ""))
        components[member] = _part(e, WORDS, ELEMENT)
        for c in _within(e, "Connectors"):
            listed = c.find(tag("ssc", "Enumeration"))
            connectors[member, c.get("name", "")] = _part(
                c, WORDS, CONNECTOR, "" if listed is None else listed.get("name", "")
            )
    connections = {_ends(c): _part(c, WORDS, CONNECTION) for c in _within(system, "Connections")}
    ours = _part(root, ABOUT, ROOT), _part(system, WORDS, SYSTEM)
    meta = [m for p in (*ours, *components.values()) for m in p.meta]
    files, missing = _files(meta, source)
    return RoundTripContent(
        *ours, components, connectors, connections, files, (*_lost(system), *_unkept(root, meta), *missing)
    )


def _files(meta: Sequence[Element], source: Source) -> tuple[dict[str, bytes], list[str]]:
    """Files of the package that meta data name, and lines about those that are not there."""
    files, lines = {}, []
    for m in (e for kept in meta for e in kept.iter(*VERBATIM)):
        uri = m.get("source", "")
        if not uri or m.get("sourceBase", "SSD") != "SSD":
            continue
        try:
            files[unquote(uri)] = source.package.read(uri)
        except (SSPError, FMUError) as error:
            lines.append(f"meta data without their file: {error}")
    return files, lines


def _unkept(root: Element, meta: Sequence[Element]) -> list[str]:
    """Meta data and signatures of parts that are taken apart or written anew."""
    n = sum(1 for _ in root.iter(*VERBATIM)) - sum(1 for m in meta for _ in m.iter(*VERBATIM))
    return [f"{counted(n, 'element')} of meta data or signatures inside what is written anew left out"] if n else []


def _lost(system: Element) -> list[str]:
    """Pictures of nested systems, and names that are no identifiers."""
    nested = [e for e in _within(system, "Elements") if e.tag != tag("ssd", "Component")]
    inner = Counter(e.tag.rpartition("}")[2] for n in nested for e in n.iter() if isinstance(e.tag, str))
    pictures = sum(inner[k] for k in ("ElementGeometry", "ConnectorGeometry", "ConnectionGeometry", "SystemGeometry"))
    lines = [f"geometry inside nested systems left out ({counted(pictures, 'element')})"] if pictures else []
    names = [
        e.get("name", "") for e in _within(system, "Elements") if identifier(e.get("name", "")) != e.get("name", "")
    ]
    return lines + [f"'{n}' is called {identifier(n)}" for n in names]


def _part(element: Element, words: Sequence[str], names: Sequence[str], enumeration: str = "") -> Part:
    children = {}
    for name in names:
        child = element.find(tag("ssd", name))
        if child is not None and (name != "Annotations" or (child := _of_others(child)) is not None):
            children[name] = deepcopy(child)
    stays = VERBATIM if element.tag == tag("ssd", "Component") else VERBATIM[:1]
    meta = tuple(deepcopy(e) for e in element if e.tag in stays)
    return Part({w: element.get(w) for w in words if element.get(w)}, children, enumeration, meta)


def _of_others(annotations: Element) -> Element | None:
    """Annotations without ours, which are written anew."""
    found = deepcopy(annotations)
    for a in [a for a in found if a.get("type") == PORTS]:
        found.remove(a)
    return found if len(found) else None


def _within(element: Element, name: str) -> list[Element]:
    found = element.find(tag("ssd", name))
    return [] if found is None else list(found)


def _ends(c: Element) -> Ends:
    a, b = identifier(c.get("startElement", "")), identifier(c.get("endElement", ""))
    return a, c.get("startConnector", ""), b, c.get("endConnector", "")
