"""Claims about the machine: memory does not grow with steps, nothing is left behind, and what goes outward is told."""

from __future__ import annotations

import ctypes
import os
import sys
import tempfile
from contextlib import suppress
from functools import cache
from pathlib import Path
from typing import Any

from phfmu.fmu.importer.refusal import UnitCallError
from phfmu.vet.finding import ClaimFinding, false, holds, untested
from phfmu.vet.subject import Subject
from phfmu.words import counted, first_few

#: steps, those between looks at memory, and bytes a step beyond which it grows
LONG, APART, GROWTH = 10_000, 100, 8.0
PAGE = 4096
#: functions by which a library reaches other machines or programs
OUTWARD = ("socket", "connect", "getaddrinfo", "fork", "execve", "execvp", "posix_spawn", "system", "popen",
           "CreateProcessA", "CreateProcessW", "WSAStartup")  # fmt: skip


def memory(subject: Subject) -> ClaimFinding:
    """1e4 steps under start inputs: bytes that the C library has handed out, in the second and the last third of them."""
    if sys.platform != "linux":
        return untested("memory is looked at on Linux only")
    marks, ended = list[int](), ""
    with subject.trial() as trial:
        if subject.inputs:
            trial.give(subject.starts)
        for k in range(LONG):
            if k % APART == 0:
                marks.append(_in_use())
            try:
                trial.advance(subject.t0 + k * subject.h, subject.h)
            except UnitCallError:
                ended = "it goes no further than"
            if ended or trial.ended or subject.left() < 0:
                break
        marks.append(_in_use())
    third = (len(marks) - 1) // 3
    if third < 2:
        return untested(f"{ended or 'there was time for'} {counted(k + 1, 'step')}")
    grown = [(marks[-1 - i * third] - marks[-1 - (i + 1) * third]) / (third * APART) for i in range(2)]
    if min(grown) > GROWTH:
        return false(f"{min(grown):.0f} bytes more in each step, over {k + 1} steps")
    return holds(f"{k + 1} steps; {max(0.0, *grown):.2g} bytes a step at most ({marks[-1] / 1e6:.3g} MB in use)")


class _InUse(ctypes.Structure):
    """mallinfo2 of glibc."""

    _fields_ = [
        (name, ctypes.c_size_t)
        for name in "arena ordblks smblks hblks hblkhd usmblks fsmblks uordblks fordblks keepcost".split()
    ]


def _in_use() -> int:
    """Bytes handed out by malloc; of another C library, pages that are resident."""
    told = _told_by_malloc()
    if told is None:
        return int(Path("/proc/self/statm").read_text().split()[1]) * PAGE
    found = told()
    return int(found.uordblks + found.hblkhd)


@cache
def _told_by_malloc() -> Any:
    """mallinfo2, None where the C library has none."""
    function = getattr(ctypes.CDLL(None), "mallinfo2", None)
    if function is not None:
        function.restype = _InUse
    return function


def files(subject: Subject) -> ClaimFinding:
    """A run from instantiation to the free instance, in an empty folder: files there and in that of the unit, open handles."""
    here, named = Path.cwd(), os.environ.get("TMPDIR")
    own, handles = _files(subject.archive.folder), _handles()
    with tempfile.TemporaryDirectory() as folder:
        try:
            os.chdir(folder)
            os.environ["TMPDIR"] = folder
            with subject.trial() as trial:
                trial.run(0, subject.n)
        finally:
            os.chdir(here)
            os.environ.pop("TMPDIR") if named is None else os.environ.update(TMPDIR=named)
        left = sorted(_files(Path(folder)) | (_files(subject.archive.folder) - own))
    opened = sorted(_handles() - handles)
    if left:
        return false(f"{counted(len(left), 'file')} left behind: {first_few(left)}")
    if opened:
        return false(f"{counted(len(opened), 'handle')} left open: {first_few(opened)}")
    return holds("no file is left in its folder, the working or the temporary folder, and no handle open")


def _files(folder: Path) -> set[str]:
    return {
        str(Path(where) / name) for where, _, names in os.walk(folder) for name in names if "__pycache__" not in where
    }


def _handles() -> set[str]:
    """Open files and sockets, by number and what they are."""
    found = set[str]()
    for entry in _listed("/proc/self/fd"):
        with suppress(OSError):
            found.add(f"{entry} -> {os.readlink(f'/proc/self/fd/{entry}')}")
    return {f for f in found if "/proc/" not in f}


def _listed(folder: str) -> list[str]:
    try:
        return os.listdir(folder)
    except OSError:
        return []


def outward(subject: Subject) -> ClaimFinding:
    """Sockets and processes while it runs, and functions for these that its library names: told, not judged."""
    data = (subject.archive.folder / subject.archive.library).read_bytes()
    named = [n for n in OUTWARD if b"\0" + n.encode() + b"\0" in data]
    before, children = _handles(), _children()
    with subject.trial() as trial:
        trial.run(0, subject.n)
        sockets = [h for h in _handles() - before if "socket:" in h]
        started = _children() - children
    seen = [f"{counted(len(sockets), 'socket')} open"] if sockets else []
    seen += [f"{counted(len(started), 'process')} started"] if started else []
    seen += [f"its library names {', '.join(named)}"] if named else []
    if seen:
        return untested(f"told, not judged: {'; '.join(seen)}")
    return holds("no socket, no process, and no function for these in its library")


def _children() -> set[str]:
    found = set[str]()
    for task in _listed("/proc/self/task"):
        with suppress(OSError):
            found |= set(Path(f"/proc/self/task/{task}/children").read_text().split())
    return found
