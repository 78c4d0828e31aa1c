"""Where a run came from: its options, its files, the software and the machine, kept in the metadata of its audit."""

from __future__ import annotations

import argparse
import hashlib
import platform
import sys
from collections.abc import Mapping
from importlib.metadata import PackageNotFoundError, version
from pathlib import Path
from typing import Any

#: key of the metadata
KEY = "phfmu.origin"
#: options of what is written and shown, which do not change the run
SHOWN = ("call", "verb", "output", "plot", "view", "audit", "quiet", "units_row", "every", "signals", "accuracy")
#: packages that compute
PACKAGES = ("phfmu", "numpy", "scipy", "casadi")


def origin(args: argparse.Namespace) -> dict[str, Any]:
    """Options, SHA-256 of files that they name, versions and machine of a run, as JSON can hold them."""
    options = {name: value for name, value in vars(args).items() if name not in SHOWN}
    return {"options": options, "files": _digests(options), "software": _software(), "machine": machine()}


def changed(was: Mapping[str, Any], args: argparse.Namespace) -> list[str]:
    """What is not as it was, one line each: units and other files, libraries, machine."""
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
    """What may change the bits of a computation: processor, system, C library."""
    return {
        "processor": f"{platform.machine()} {_model()}".strip(), "system": platform.system(),
        "C library": " ".join(platform.libc_ver()).strip(),
    }  # fmt: skip


def _model() -> str:
    """The name of the processor, where the system tells it."""
    try:
        lines = Path("/proc/cpuinfo").read_text().splitlines()
    except OSError:
        return platform.processor()
    return next((line.partition(":")[2].strip() for line in lines if line.startswith("model name")), "")


def _software() -> dict[str, str]:
    found = {"python": sys.version.split()[0]}
    for package in PACKAGES:
        try:
            found[package] = version(package)
        except PackageNotFoundError:
            continue
    return found


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
