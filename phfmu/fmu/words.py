"""Words of foreign units, made fit to be printed: short, on one line, without control characters."""

from __future__ import annotations

from phfmu.fmu import limits


def plain(text: str, longest: int = limits.TEXT) -> str:
    """The text with what a terminal would obey written out, cut to `longest` characters."""
    kept = text[:longest]
    if not kept.isprintable():
        kept = "".join(c if c.isprintable() else _written_out(c) for c in kept)
    return kept if len(text) <= longest else f"{kept}... ({len(text) - longest} more characters)"


def _written_out(character: str) -> str:
    return " " if character in "\t\r\n" else character.encode("unicode_escape").decode()
