"""Words of others, made fit to be printed: short, on one line, without control characters; and as text of C."""

from __future__ import annotations

#: characters of a description that are kept
TEXT = 1000


def plain(text: str, longest: int = TEXT) -> str:
    """The text with what a terminal would obey written out, cut to `longest` characters."""
    kept = text[:longest]
    if not kept.isprintable():
        kept = "".join(c if c.isprintable() else _written_out(c) for c in kept)
    return kept if len(text) <= longest else f"{kept}... ({len(text) - longest} more characters)"


def _written_out(character: str) -> str:
    return " " if character.isspace() else character.encode("unicode_escape").decode()


def c_string(text: str) -> str:
    """The text as a string of C; question marks are escaped because of trigraphs."""
    for character in '\\"?':
        text = text.replace(character, f"\\{character}")
    return '"' + "".join(c if c.isprintable() else "".join(f"\\{b:03o}" for b in c.encode()) for c in text) + '"'


def c_comment(text: str) -> str:
    """The text for the inside of a comment of C, which it neither opens nor ends."""
    return plain(text).replace("*/", "* /").replace("/*", "/ *")
