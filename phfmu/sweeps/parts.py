"""Outcomes on disk while a sweep goes on, so that one which ends early is taken up again."""

from __future__ import annotations

import hashlib
import shutil
from collections.abc import Iterator
from pathlib import Path

import numpy as np

from phfmu.sweeps.design import Design
from phfmu.sweeps.outcome import Outcome


def digest(words: str, design: Design) -> str:
    """Of all that the outcomes depend on: the design, and what is run."""
    text = "\n".join((words, *design.names))
    return hashlib.sha256(text.encode() + design.rows.astype("<f8").tobytes()).hexdigest()


class Parts:
    """Folder FILE.parts: outcomes of blocks of runs, by the number of the first one."""

    def __init__(self, file: Path, key: str, *, resume: bool):
        self._folder, self._key = file.with_name(file.name + ".parts"), f"{key}\n"
        stamp = self._folder / "sweep"
        if self._folder.exists() and resume:
            if not stamp.is_file() or stamp.read_text() != self._key:
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

    def keep(self, first: int, outcome: Outcome) -> None:
        """Write the runs from `first` on, whole or not at all."""
        path = self._folder / f"{first:09d}.npz"
        begun = path.with_suffix(".begun")
        with begun.open("wb") as f:
            np.savez(
                f, values=outcome.values, steps=outcome.steps, ledger=outcome.ledger, errors=np.array(outcome.errors)
            )
        begun.replace(path)

    def kept(self) -> Iterator[tuple[int, Outcome]]:
        """(number of the first run, outcome) of all blocks."""
        for path in sorted(self._folder.glob("*.npz")):
            with np.load(path) as f:
                yield int(path.stem), Outcome(f["values"], f["steps"], f["ledger"], tuple(map(str, f["errors"])))

    def remove(self) -> None:
        """All of it: the table is written."""
        shutil.rmtree(self._folder)
