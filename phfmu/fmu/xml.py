"""XML: one way to write a document, and two ways to read a foreign one without harm: tag by tag, or held as a tree."""

from __future__ import annotations

import re
from typing import IO, Any, Protocol

from lxml import etree as _etree  # pyright: ignore[reportAttributeAccessIssue]

from phfmu.fmu import limits
from phfmu.fmu.export.variables import FMUError

#: lxml has no type information
etree: Any = _etree
Element = Any

#: no entities, no network, no document type, the library's own limits on
SAFE = {"resolve_entities": False, "no_network": True, "load_dtd": False, "huge_tree": False, "remove_comments": True,
        "remove_pis": True}  # fmt: skip
CHUNK = 2**16
#: encodings in which markup is ASCII, so that it cannot hide
ENCODINGS = (b"utf-8", b"us-ascii", b"ascii", b"iso-8859-1", b"iso-8859-15", b"windows-1252")
_ENCODING = re.compile(rb"""<\?xml[^>]*?encoding\s*=\s*["']([^"']*)["']""")


def number(value: float) -> str:
    """Shortest text that reads back to the same value."""
    return repr(float(value))


def text_of(element: Element, *verbatim: str) -> bytes:
    """The document, indented, UTF-8; elements with the tags `verbatim` are as they are inside."""
    as_they_are = [e for e in element.iter(*verbatim) if e.getparent().tag not in verbatim] if verbatim else []
    places = [etree.Element("place") for _ in as_they_are]
    for place, e in zip(places, as_they_are, strict=True):
        e.getparent().replace(e, place)
    etree.indent(element)
    for place, e in zip(places, as_they_are, strict=True):
        e.tail = place.tail
        place.getparent().replace(place, e)
    return etree.tostring(element, xml_declaration=True, encoding="UTF-8") + b"\n"


class Tags(Protocol):
    """The tags of a document that is read tag by tag."""

    def start(self, tag: str, attributes: Any) -> None: ...

    def end(self, tag: str) -> None: ...


class _Target:
    """lxml's view of `Tags`: text is passed by, document types and deep nesting are refused."""

    def __init__(self, tags: Tags, name: str):
        self.tags, self.name, self.depth, self.seen, self.tags_seen = tags, name, 0, 0, 0

    def start(self, tag: str, attributes: Any) -> None:
        self.depth += 1
        self.seen += 1
        self.tags_seen += 1
        if self.depth > limits.DEPTH or self.tags_seen > limits.TAGS:  # most tags need no second look
            limits.within(self.name, self.depth, limits.DEPTH, "tags within each other")
            limits.within(self.name, self.tags_seen, limits.TAGS, "tags")
        self.tags.start(tag, attributes)

    def end(self, tag: str) -> None:
        self.depth -= 1
        self.seen += 1
        self.tags.end(tag)

    def data(self, text: str) -> None:
        self.seen += 1

    def doctype(self, *_: object) -> None:
        raise _doctype(self.name)

    def close(self) -> None: ...


def read(stream: IO[bytes], name: str, tags: Tags) -> None:
    """The document, in memory for one tag at a time; FMUError says what is wrong."""
    target = _Target(tags, name)
    parser = etree.XMLParser(target=target, **SAFE)
    size = silent = 0
    try:
        while chunk := stream.read(CHUNK):
            if not size:
                _check_encoding(chunk, name)
            before = target.seen
            parser.feed(chunk)
            size += len(chunk)
            silent = 0 if target.seen > before else silent + len(chunk)
            limits.within(name, size, limits.DESCRIPTION, "bytes of XML")
            limits.within(name, silent, limits.TAG, "bytes in one tag, comment or text")
        parser.close()
    except etree.XMLSyntaxError as error:
        raise FMUError(f"{name}: the XML is not well formed: {error}") from None


def parse(data: bytes, name: str) -> Element:
    """The root of a short document; FMUError says what is wrong."""
    limits.within(name, len(data), limits.DOCUMENT, "bytes of XML")
    _check_encoding(data, name)
    if b"<!DOCTYPE" in data or b"<!ENTITY" in data:
        raise _doctype(name)
    try:
        return etree.fromstring(data, etree.XMLParser(**SAFE))
    except etree.XMLSyntaxError as error:
        raise FMUError(f"{name}: the XML is not well formed: {error}") from None


def _doctype(name: str) -> FMUError:
    return FMUError(f"{name}: the XML has a document type definition, which may read other files; refused")


def _check_encoding(head: bytes, name: str) -> None:
    found = _ENCODING.match(head.removeprefix(b"\xef\xbb\xbf"))
    if b"\0" in head[:4] or head[:2] in (b"\xff\xfe", b"\xfe\xff") or (found and found[1].lower() not in ENCODINGS):
        raise FMUError(f"{name}: the XML is not in UTF-8, which the standard asks for")
