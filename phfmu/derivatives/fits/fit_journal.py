"""The runs of a fit in a file, so that a fit that was killed goes on where it was.

The way of a least-squares solver follows from its residuals and Jacobians alone.  A fit that goes on begins anew and takes what
the file has by the bits of the values: it comes to the same iterate, radius and try as before it was killed, in no time, and
from there on runs are taken again.

The file begins with a line of JSON that says which fit it is of; each run appends its values (n), its columns (measurements x
1 + n: the run's values and their derivatives) and what is told beside them.  What a killed fit left half written is cut off.
"""

from __future__ import annotations

import hashlib
import io
import json
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from phfmu.files import require_writable

Array = NDArray[np.float64]
KEY = "phfmu fit"


@dataclass(frozen=True)
class JournalEntry:
    """The runs at one choice of values: columns (measurements x 1 + names) and what is told beside them, as JSON has it."""

    columns: Array
    told: Mapping[str, Any]


def digest(value: Any) -> str:
    """A SHA-256 digest of numbers, texts, arrays and sequences of them; it differs where a bit does."""
    hashed = hashlib.sha256()

    def take(part: Any) -> None:
        if isinstance(part, np.ndarray):
            hashed.update(repr(part.shape).encode() + np.ascontiguousarray(part).tobytes())
        elif isinstance(part, (list, tuple)):
            hashed.update(b"(")
            for own in part:
                take(own)
            hashed.update(b")")
        else:
            hashed.update(repr(part).encode() + b";")

    take(value)
    return hashed.hexdigest()


class Journal:
    """Runs that were taken before, and those that are appended.

    `about`: digests of what the fit is of, by what they are of.  ValueError for the file of another fit, or of none.
    """

    def __init__(self, path: str | Path, about: Mapping[str, str]):
        self.path = Path(path)
        self._kept: dict[bytes, JournalEntry] = {}
        require_writable(self.path, f"--resume {self.path}")
        head = json.dumps({KEY: 1, "about": dict(about)}).encode() + b"\n"
        content = self.path.read_bytes() if self.path.exists() else b""
        if not content:
            self.path.write_bytes(head)
            return
        self._require_same(content.partition(b"\n")[0], about)
        whole = self._read(content)
        if whole < len(content):
            with open(self.path, "r+b") as file:
                file.truncate(whole)

    @property
    def runs(self) -> int:
        """Choices of values whose runs are kept."""
        return len(self._kept)

    def at(self, theta: Array) -> JournalEntry | None:
        """The runs at these values, None where there are none."""
        return self._kept.get(theta.tobytes())

    def add(self, theta: Array, kept: JournalEntry) -> None:
        """Appends the runs at these values to the file."""
        self._kept[theta.tobytes()] = kept
        record = io.BytesIO()
        for part in (theta, kept.columns, np.frombuffer(json.dumps(kept.told).encode(), np.uint8)):
            np.save(record, part, allow_pickle=False)
        with open(self.path, "ab") as file:
            file.write(record.getvalue())

    def _require_same(self, line: bytes, about: Mapping[str, str]) -> None:
        try:
            was = json.loads(line)["about"]
        except (ValueError, KeyError, TypeError):
            raise ValueError(f"--resume {self.path} is not the file of a fit; name one that is not there yet") from None
        if differ := [name for name in about if was.get(name) != about[name]]:
            raise ValueError(
                f"--resume {self.path} is of another fit: other {', '.join(differ)}; begin it anew, or give back what it had"
            )

    def _read(self, content: bytes) -> int:
        """Takes the whole records; the place where they end."""
        file = io.BytesIO(content)
        file.readline()
        end = file.tell()
        while end < len(content):
            try:
                theta, columns, told = (np.load(file, allow_pickle=False) for _ in range(3))
                self._kept[theta.tobytes()] = JournalEntry(columns, json.loads(told.tobytes()))
            except (ValueError, EOFError, OSError):
                break
            end = file.tell()
        return end
