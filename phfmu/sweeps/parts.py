"""Outcomes on disk while a sweep goes on, so that one which ends early is taken up again."""

from __future__ import annotations

import hashlib
import io
import shutil
import sys
from collections.abc import Iterator
from pathlib import Path

import numpy as np

from phfmu.files import beside
from phfmu.sweeps.design import Design
from phfmu.sweeps.outcome import RunOutcomes

ENDING = ".part"


def digest(words: str, design: Design) -> str:
    """Hash of all that the outcomes depend on: the design and the words of the task."""
    text = "\n".join((words, *design.names))
    return hashlib.sha256(text.encode() + design.rows.astype("<f8").tobytes()).hexdigest()


class Parts:
    """Folder FILE.parts: outcomes of blocks of runs, by the number of the first one.

    A part is a checksum and the arrays of the outcome with the number of its first run.  The checksum is that of the arrays and
    of all that the sweep depends on, so that a part which was damaged, renamed or taken from another sweep is none: its runs
    are taken again.
    """

    def __init__(self, file: Path, key: str, *, resume: bool):
        self._folder, self._key = file.with_name(file.name + ".parts"), f"{key}\n"
        #: number of runs on disk
        self.runs = 0
        stamp = self._folder / "sweep"
        if self._folder.exists() and resume:
            if not stamp.is_file() or stamp.read_bytes() != self._key.encode():
                raise ValueError(
                    f"{self._folder} holds another sweep: other values, measures, steps, or another version; "
                    "take the same command, or leave out --resume to start anew"
                )
            return
        if resume:
            raise ValueError(f"--resume: there is no {self._folder} of a sweep that ended early; leave out --resume")
        shutil.rmtree(self._folder, ignore_errors=True)
        self._folder.mkdir(parents=True)
        stamp.write_text(self._key)

    def keep(self, first: int, outcome: RunOutcomes) -> None:
        """Write the runs from `first` on, whole or not at all; OSError that names the file."""
        arrays = io.BytesIO()
        np.savez(
            arrays, first=first, values=outcome.values, steps=outcome.steps, ledger=outcome.ledger,
            errors=np.array(outcome.errors, dtype=np.str_),
        )  # fmt: skip
        path = self._folder / f"{first:09d}{ENDING}"
        written = beside(path)
        try:
            written.write_bytes(self._checksum(arrays.getvalue()) + arrays.getvalue())
            written.replace(path)
        except OSError as error:
            written.unlink(missing_ok=True)
            raise OSError(error.errno, error.strerror, str(path)) from error
        self.runs += len(outcome.errors)

    def kept(self) -> Iterator[tuple[int, RunOutcomes]]:
        """(number of the first run, outcome) of all blocks; one that is none is said on stderr, and removed."""
        for path in sorted(self._folder.glob(f"*{ENDING}")):
            found = self._read(path)
            if found is None:
                print(f"phfmu: {path} is damaged or no part of this sweep; its runs are taken again", file=sys.stderr)
                path.unlink()
                continue
            self.runs += len(found.errors)
            yield int(path.stem), found

    def told(self, runs: int) -> str:
        """The rest of so many runs, in words."""
        return f"{self.runs} of {runs} runs are in {self._folder}; the same command with --resume takes the others"

    def remove(self) -> None:
        """All of it: the table is written."""
        shutil.rmtree(self._folder)

    def _checksum(self, arrays: bytes) -> bytes:
        return hashlib.sha256(self._key.encode() + arrays).digest()

    def _read(self, path: Path) -> RunOutcomes | None:
        data = path.read_bytes()
        size = hashlib.sha256().digest_size
        if data[:size] != self._checksum(data[size:]):
            return None
        with np.load(io.BytesIO(data[size:])) as f:
            if path.stem != f"{int(f['first']):09d}":
                return None
            return RunOutcomes(f["values"], f["steps"], f["ledger"], tuple(map(str, f["errors"])))
