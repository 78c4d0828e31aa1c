"""Checks of an archive before Arrow reads it, and what its footer says of the run it holds.

A Parquet file is rows, a footer, the length of that and PAR1.  Between rows and footer an archive has a mark with the CRC-32 of
all bytes before it, and of all after it.  Who reads the table and writes it again leaves it out, as any writer but phfmu does.
"""

from __future__ import annotations

import json
import math
import os
import re
import zlib
from collections.abc import Mapping
from pathlib import Path
from typing import Any, BinaryIO

#: key of what the archive holds, a JSON object: steps, end [s], and of one that was recovered: torn, damaged (blocks)
HOLDS_KEY = b"phfmu.audit.holds"

_MARK = re.compile(rb"phfmu\.seal ([0-9a-f]{8}) ([0-9a-f]{8})\n")
_SIZE = len(b"phfmu.seal 00000000 00000000\n")
_CHUNK = 1 << 22
#: length and magic word after the footer
_TAIL = 8
#: bytes at the end of a file among which the mark is looked for
_NEAR = 1 << 20


def seal(path: Path) -> None:
    """Put the mark into an archive; places in a Parquet file count from its start, so the footer stays right."""
    with open(path, "r+b") as file:
        start, footer = _footer(file)
        mark = b"phfmu.seal %08x %08x\n" % (_checked(file, start), zlib.crc32(footer))
        file.seek(start)
        file.write(mark + footer)
        file.flush()
        os.fsync(file.fileno())


def require_whole(path: Path) -> None:
    """Raise ValueError where the bytes are not those that were sealed; a file without a seal is of another writer."""
    with open(path, "rb") as file:
        start, footer = _footer(file)
        file.seek(max(0, start - _SIZE))
        mark = _MARK.fullmatch(file.read(min(_SIZE, start)))
        if mark is None:
            file.seek(max(0, file.seek(0, os.SEEK_END) - _NEAR))
            if _MARK.search(file.read()):
                raise ValueError(
                    f"{path} is damaged: its end does not say where its footer is; nothing of it can be read"
                )
            return
        if zlib.crc32(footer) != int(mark[2], 16):
            raise ValueError(f"{path} is damaged: its footer fails its check; nothing of it can be read")
        if _checked(file, start - _SIZE) != int(mark[1], 16):
            raise ValueError(
                f"{path} is damaged: its rows fail their check; other copies of the file, or a run made again, have them"
            )


def holds(metadata: Mapping[bytes, bytes] | None) -> dict[str, Any]:
    """The contents of an archive as its footer says; nothing of a file of another writer, or a stream."""
    try:
        found = json.loads((metadata or {}).get(HOLDS_KEY, b"{}"))
    except ValueError:
        return {}
    known = found if isinstance(found, dict) else {}
    return {k: v for k, v in known.items() if isinstance(v, int | float) and math.isfinite(v)}


def _footer(file: BinaryIO) -> tuple[int, bytes]:
    """The start of the footer, and its bytes with what follows; nothing where the end of the file is not one."""
    size = file.seek(0, os.SEEK_END)
    if size < _TAIL:
        return size, b""
    file.seek(size - _TAIL)
    tail = file.read()
    start = size - _TAIL - int.from_bytes(tail[:4], "little")
    if start < 0 or tail[4:] != b"PAR1":
        return size, b""
    file.seek(start)
    return start, file.read()


def _checked(file: BinaryIO, end: int) -> int:
    """CRC-32 of the bytes before `end`."""
    file.seek(0)
    found, left = 0, end
    while left and (part := file.read(min(_CHUNK, left))):
        found, left = zlib.crc32(part, found), left - len(part)
    return found
