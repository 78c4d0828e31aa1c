"""XML: one way to write a document, and one way to read a foreign one without harm."""

from __future__ import annotations

from typing import Any

from lxml import etree as _etree  # pyright: ignore[reportAttributeAccessIssue]

from phfmu.fmu.variables import FMUError

#: lxml has no type information
etree: Any = _etree
Element = Any

#: more XML than this is refused, bytes
LARGEST = 512 * 2**20


def number(value: float) -> str:
    """Shortest text that reads back to the same value."""
    return repr(float(value))


def text_of(element: Element) -> bytes:
    """The document, indented, UTF-8."""
    etree.indent(element)
    return etree.tostring(element, xml_declaration=True, encoding="UTF-8") + b"\n"


def parse(data: bytes, name: str) -> Element:
    """The root of a document without document type, entities and network; FMUError says what is wrong."""
    if len(data) > LARGEST:
        raise FMUError(f"{name}: {len(data)} bytes of XML, more than {LARGEST}; refused")
    if b"\0" in data[:4] or data[:2] in (b"\xff\xfe", b"\xfe\xff"):
        raise FMUError(f"{name}: the XML is not in UTF-8, which the standard asks for")
    if b"<!DOCTYPE" in data or b"<!ENTITY" in data:
        raise FMUError(f"{name}: the XML has a document type definition, which may read other files; refused")
    parser = etree.XMLParser(resolve_entities=False, no_network=True, load_dtd=False, huge_tree=False)
    try:
        return etree.fromstring(data, parser)
    except etree.XMLSyntaxError as error:
        raise FMUError(f"{name}: the XML is not well formed: {error}") from None
