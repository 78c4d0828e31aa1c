"""phfmu run --checkpoint and --resume: the file of a checkpoint, what it belongs to, and when it is written.

The file is one line of JSON (what the run is, and the SHA-256 of the rest) and the data of `runs/checkpoints.py`.  It is put in
its place when it is whole, so that a run that is killed leaves the last one.
"""

from __future__ import annotations

import argparse
import hashlib
import io
import json
import os
import pickle
from collections.abc import Callable, Mapping
from pathlib import Path
from time import monotonic
from typing import TYPE_CHECKING, Any

from phfmu.cli.origin import changed, origin
from phfmu.files import beside, require_writable

if TYPE_CHECKING:
    from phfmu.network.couplings.stepper import Stepper
    from phfmu.runs.options import Options

KEY = "phfmu.checkpoint"
#: what else than classes of phfmu is in the data
_PLAIN = {
    "numpy": ("ndarray", "dtype"),
    "numpy._core.multiarray": ("_reconstruct", "scalar"),
    "numpy._core.numeric": ("_frombuffer",),
    "collections": ("deque", "defaultdict", "OrderedDict"),
    "builtins": ("set", "frozenset", "slice", "range", "complex", "bytearray"),
}
#: options that a checkpoint has no place for
_WITHOUT = ("accuracy",)


class CheckpointFile:
    """The checkpoints of one run: reads that of --resume, writes one each --checkpoint seconds; nothing without both."""

    def __init__(self, args: argparse.Namespace):
        self._args, self._seconds, self._last = args, args.checkpoint, monotonic()
        self.found: Mapping[str, Any] | None = None
        self.asked = args.checkpoint is not None or args.resume is not None
        self._head: dict[str, Any] = {}
        if not self.asked:
            return
        self._require_fit()
        self.path = Path(args.resume or _path(args)).absolute()
        require_writable(self.path, f"--checkpoint {self.path}")
        self._head = {KEY: 1, "origin": origin(args)}
        if args.resume is not None:
            told, self.found = _read(self.path, args.resume)
            self._was = told
            self._seconds = told["seconds"] if self._seconds is None else self._seconds
            self._require_same(told["origin"])

    @property
    def outputs(self) -> Mapping[str, Any]:
        """Positions in the files of the run that goes on, {} for one that begins."""
        return {} if self.found is None else self.found["outputs"]

    def begin(self, stepper: Stepper, options: Options, marks: Callable[[], dict[str, Any]]) -> None:
        """The run is about to begin; `marks`: tells where its files are.  ValueError if that of --resume was of another model."""
        self._marks = marks
        self._head |= {"seconds": self._seconds, "model": _model(stepper, options)}
        if self.found is not None and self._was["model"] != self._head["model"]:
            differ = [n for n, digest in self._head["model"].items() if self._was["model"].get(n) != digest]
            raise ValueError(
                f"--resume {self._args.resume} is of another model: other {', '.join(differ)}; begin it anew"
            )
        self._last = monotonic()

    def between_blocks(self, now: Callable[[], dict[str, Any]]) -> None:
        """Writes a checkpoint if it is time for one."""
        if self._seconds is None or monotonic() - self._last < self._seconds:
            return
        marks = self._marks()
        body = pickle.dumps(now() | {"outputs": marks}, protocol=5)
        head = self._head | {"sha256": hashlib.sha256(body).hexdigest()}
        partial = beside(self.path)
        try:
            with open(partial, "wb") as file:
                file.write(json.dumps(head).encode() + b"\n" + body)
                file.flush()
                os.fsync(file.fileno())
            os.replace(partial, self.path)
        finally:
            partial.unlink(missing_ok=True)
        self._last = monotonic()

    @property
    def left(self) -> str | None:
        """The option that goes on with the run, if there is a checkpoint of it."""
        return f"--resume {self.path}" if self.asked and self.path.exists() else None

    def ended(self) -> None:
        """The run came to its end: its checkpoint is of no use any more."""
        if self.asked:
            self.path.unlink(missing_ok=True)

    def _require_fit(self) -> None:
        args = self._args
        if args.checkpoint is not None and not 0 <= args.checkpoint < float("inf"):
            raise ValueError(f"--checkpoint {args.checkpoint:g} s: expected a number from 0, e.g. 10")
        for name in _WITHOUT:
            if getattr(args, name):
                raise ValueError(
                    f"--{name} is not kept by a checkpoint; leave it out, or leave out --checkpoint and --resume"
                )
        if args.sensitivity:
            raise ValueError("--sensitivity is not kept by a checkpoint yet; leave one of the two out")

    def _require_same(self, was: Mapping[str, Any]) -> None:
        """Raise ValueError where options, files or libraries are not those of the run that is to go on."""
        now, resume = self._head["origin"], self._args.resume
        differ = [
            f"--{name.replace('_', '-')} was {was['options'].get(name)!r}, is {now['options'].get(name)!r}"
            for name in dict.fromkeys((*was["options"], *now["options"]))
            if was["options"].get(name) != now["options"].get(name)
        ]
        differ += changed(was, self._args)
        if differ:
            raise ValueError(
                f"--resume {resume} is of another run: {'; '.join(differ)}; begin it anew, or give back what it had"
            )


def _path(args: argparse.Namespace) -> str:
    """Beside the result table, else the audit, else in this folder."""
    from phfmu.cli.options import audit_file
    from phfmu.target import function_name

    named = args.output or audit_file(args)
    if named:
        return str(Path(named).with_suffix(".checkpoint"))
    return f"{function_name(args.target) or Path(args.target.partition(':')[0]).stem}.checkpoint"


def _model(stepper: Stepper, options: Options) -> dict[str, str]:
    """Digests of what makes a run: columns, accounts, times and events."""
    about = {
        "columns": (stepper.names, sorted(stepper.units.items()), list(stepper.inputs())),
        "accounts": (tuple(stepper.booking.components), tuple(map(str, stepper.booking.ports))),
        "events": [(e.t, e.name, e.value) for e in options.events],
        "times": (options.t0, options.stop, options.step),
    }
    return {name: hashlib.sha256(repr(value).encode()).hexdigest() for name, value in about.items()}


def _read(path: Path, shown: str) -> tuple[dict[str, Any], Mapping[str, Any]]:
    """Head of a checkpoint, which tells its run, and its data; raises ValueError for another or damaged file."""
    if not path.is_file():
        raise ValueError(f"--resume {shown}: there is no such file; phfmu run --checkpoint SECONDS writes one")
    line, _, body = path.read_bytes().partition(b"\n")
    try:
        head = json.loads(line)
        known = head[KEY] == 1
    except (ValueError, KeyError, TypeError):
        known, head = False, {}
    if not known:
        raise ValueError(f"--resume {shown} is no checkpoint of phfmu run")
    if hashlib.sha256(body).hexdigest() != head["sha256"]:
        raise ValueError(f"--resume {shown} is damaged: its bytes are not those that were written; begin the run anew")
    return head, plain(body)


def plain(body: bytes) -> Mapping[str, Any]:
    """Data of a checkpoint; raises ValueError where it names anything but numbers and classes of phfmu."""
    return _PlainUnpickler(io.BytesIO(body)).load()


#: modules whose classes stand in checkpoints -> where these are now
_MOVED = {
    f"phfmu.runs.{name}": f"phfmu.runs.march.{name}"
    for name in ("adaptive", "march", "restart", "ringing", "stretches")
}
#: classes in checkpoints, by module and earlier name -> their name now
_RENAMED = {
    ("phfmu.audit.judge", "Account"): "ComponentBalance",
    ("phfmu.runs.march.adaptive", "Control"): "ControllerState",
    ("phfmu.runs.march.march", "Place"): "MarchPosition",
}


class _PlainUnpickler(pickle.Unpickler):
    """Reads classes of phfmu and numbers, and calls nothing else."""

    def find_class(self, module: str, name: str) -> Any:
        module = _MOVED.get(module, module)
        name = _RENAMED.get((module, name), name)
        if name in _PLAIN.get(module, ()):
            return super().find_class(module, name)
        found = super().find_class(module, name) if module.startswith("phfmu.") and "." not in name else None
        if isinstance(found, type) and found.__module__ == module:
            return found
        raise ValueError(f"the checkpoint names {module}.{name}, which has no place in one; begin the run anew")
