"""Blocks of an audit stream that can be found again and checked, whatever became of the bytes around them.

A block is what one batch adds to the Arrow stream: the schema (of the first one), dictionaries, rows.  The metadata of its batch
hold a mark

    phfmu.block NUMBER SIZE PLACE CHECK LENGTH NAMES

of fixed width but for the last: the number of the block, its bytes, where in these the mark is, the CRC-32 of all of them with
zeros for CHECK, and the length of the JSON object after it, {column: [first, names]}: what codes mean that are new in this block
or in the one before, so that one lost block takes no names with it.  Nothing is given to Arrow before its check holds.
"""

from __future__ import annotations

import json
import re
import zlib
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    import mmap

    import pyarrow as pa

#: the key of the mark in the metadata of a batch
BLOCK_KEY = "phfmu.audit.block"
#: ends an Arrow stream
END = b"\xff\xff\xff\xff\x00\x00\x00\x00"

_MARK = re.compile(rb"phfmu\.block (\d{10}) (\d{12}) (\d{10}) ([0-9a-f]{8}) (\d{8}) ")
_OPEN = b"phfmu.block " + b"0" * 10 + b" " + b"0" * 12 + b" " + b"0" * 10 + b" " + b"0" * 8 + b" "

#: column -> code of the first name, names
Names = Mapping[str, tuple[int, Sequence[str]]]


def opened(names: Names) -> bytes:
    """The mark of a block whose bytes are not known yet."""
    told = json.dumps(names).encode()
    return _OPEN + b"%08d " % len(told) + told


def sealed(block: bytearray, number: int) -> None:
    """Fill in the mark of a block."""
    place, told = block.index(_OPEN), b"phfmu.block %010d %012d " % (number, len(block))
    told += b"%010d " % place
    block[place : place + len(told)] = told
    check = place + len(told)
    block[check : check + 8] = b"%08x" % zlib.crc32(block)


@dataclass(frozen=True)
class LogBlock:
    """A block whose check holds: bytes [start, end) of the stream."""

    number: int
    start: int
    end: int
    names: Names


class StreamBlocks:
    """The blocks of a stream in order; what is between, before and after them.

    `torn`: an incomplete block ends the stream;  `damaged`: how many blocks are there, or must have been, that fail their check.
    """

    def __init__(self, data: mmap.mmap | bytes):
        self.blocks: list[LogBlock] = []
        failed: list[tuple[int, int]] = []
        for place, end, block in _marked(data):
            if block is None:
                failed.append((place, end))
            elif not self.blocks or block.start >= self.blocks[-1].end:
                self.blocks.append(block)
        numbers = [-1, *(b.number for b in self.blocks)]
        self.damaged = sum(b - a - 1 for a, b in zip(numbers[:-1], numbers[1:], strict=True))
        reached, size = self.blocks[-1].end if self.blocks else 0, len(data)
        ended = data[size - len(END) : size] == END
        self.torn = False
        if reached < size - len(END) * ended:  # something is after the last block
            beyond = sum(place >= reached and end <= size for place, end in failed)
            self.damaged += max(beyond, int(ended))
            self.torn = not (beyond or ended)


def _marked(data: mmap.mmap | bytes) -> Iterator[tuple[int, int, LogBlock | None]]:
    """Marks with where the block of each would end, and the block if its check holds."""
    for mark in _MARK.finditer(data):
        number, size, place, length = (int(mark[i]) for i in (1, 2, 3, 5))
        start, check = mark.start() - place, mark.start(4)
        end = start + size
        if start < 0 or end > len(data) or not check + 8 <= mark.end() + length <= end:
            yield mark.start(), end, None
            continue
        found = zlib.crc32(data[start:check])
        found = zlib.crc32(data[check + 8 : end], zlib.crc32(b"0" * 8, found))
        whole = found == int(mark[4], 16)
        names = json.loads(data[mark.end() : mark.end() + length]) if whole else {}
        yield mark.start(), end, LogBlock(number, start, end, names) if whole else None


class Decoder:
    """Rows of blocks, with the names that the marks tell instead of the dictionaries of the stream."""

    def __init__(self, schema: pa.Schema):
        import pyarrow as pa

        self.schema = schema
        codes = [pa.field(f.name, f.type.index_type if pa.types.is_dictionary(f.type) else f.type) for f in schema]
        self._codes, self._names = pa.schema(codes), dict[str, list[str]]()
        self._known: dict[str, pa.Array] = {}  # the names as Arrow has them

    def batch(self, data: bytes, names: Names) -> pa.RecordBatch | None:
        """The rows of a block; None where it has none."""
        import pyarrow as pa

        for column, (first, told) in names.items():
            known = self._names.setdefault(column, [])
            known += [f"name {i} is lost" for i in range(len(known), first)]
            known[first : first + len(told)] = told
            self._known.pop(column, None)
        for message in messages(data):
            if message.type == "record batch":
                found = pa.ipc.read_record_batch(message, self._codes)
                arrays = [self._named(f, a) for f, a in zip(self.schema, found.columns, strict=True)]
                return pa.RecordBatch.from_arrays(arrays, schema=self.schema)
        return None

    def _named(self, field: pa.Field, array: pa.Array) -> pa.Array:
        import pyarrow as pa

        if not pa.types.is_dictionary(field.type):
            return array
        names = self._names.setdefault(field.name, [])
        most = int(array.fill_null(-1).to_numpy(zero_copy_only=False).max(initial=-1))
        names += [f"name {i} is lost" for i in range(len(names), most + 1)]
        known = self._known.get(field.name)
        if known is None or len(known) < len(names):
            known = self._known[field.name] = pa.array(names, pa.string())
        return pa.DictionaryArray.from_arrays(array, known)


def messages(data: bytes) -> Iterator[Any]:
    """The Arrow messages of a block."""
    import pyarrow as pa

    reader = pa.ipc.MessageReader.open_stream(pa.py_buffer(data))
    while True:
        try:
            yield reader.read_next_message()
        except StopIteration:
            return
