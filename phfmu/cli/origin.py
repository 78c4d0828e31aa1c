"""The origin of a run: its options, its files, the software and the machine, kept in the metadata of its audit."""

from __future__ import annotations

import argparse
import hashlib
import platform
from collections.abc import Mapping
from pathlib import Path
from typing import Any

#: key of the metadata
KEY = "phfmu.origin"
#: options of what is written and shown, which do not change the run, and their values in a run that shows nothing
SHOWN: dict[str, Any] = {
    "output": None, "plot": None, "view": None, "audit": "none", "quiet": True, "units_row": False, "every": None, "signals": [],
    "accuracy": False, "checkpoint": None, "resume": None,
}  # fmt: skip
#: packages that compute
PACKAGES = ("phfmu", "numpy", "scipy", "casadi")


def origin(args: argparse.Namespace) -> dict[str, Any]:
    """Options, SHA-256 of files that they name, versions and machine of a run, as JSON can hold them."""
    options = {name: value for name, value in vars(args).items() if name not in (*SHOWN, "call", "verb")}
    return {"options": options, "files": _digests(options), "software": _software(), "machine": machine()}


def changed(was: Mapping[str, Any], args: argparse.Namespace) -> list[str]:
    """Units and other files, libraries and properties of the machine that are not as they were, one line each."""
    now, lines = origin(args), list[str]()
    words = {"files": "file", "software": "library", "machine": "machine"}
    for part, word in words.items():
        for name in dict.fromkeys((*was[part], *now[part])):
            before, after = was[part].get(name, "absent"), now[part].get(name, "absent")
            if before != after:
                texts = (f"{text[:12]}.." if part == "files" and text != "absent" else text for text in (before, after))
                lines.append("{} {}: was {}, is {}".format(word, name, *texts))
    return lines


def machine() -> dict[str, str]:
    """Properties of the machine that may change the bits of a computation: processor, system, C library."""
    from phfmu.studies.bench.machine import processor_name

    return {
        "processor": f"{platform.machine()} {processor_name()}", "system": platform.system(),
        "C library": " ".join(platform.libc_ver()).strip(),
    }  # fmt: skip


def _software() -> dict[str, str]:
    from phfmu.studies.bench.machine import installed

    return {"python": platform.python_version(), **installed(PACKAGES)}


def _digests(options: Mapping[str, Any]) -> dict[str, str]:
    """SHA-256 of each file that is the value of an option, or stands in it before a colon, or after an @."""
    found = dict[str, str]()
    for value in options.values():
        for word in value if isinstance(value, list | tuple) else [value]:
            if not isinstance(word, str):
                continue
            for name in (word, word.partition(":")[0], word.rpartition("@")[2]):
                if name and name not in found and Path(name).is_file():
                    found[name] = hashlib.sha256(Path(name).read_bytes()).hexdigest()
    return found
