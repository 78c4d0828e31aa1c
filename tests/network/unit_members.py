"""Members stepped apart of which some are units, written when they are asked for."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from contextlib import ExitStack, contextmanager
from dataclasses import replace
from itertools import cycle
from pathlib import Path
from typing import Any

import numpy as np

from phfmu import Collocated, Coupled, EngineMember, FMUInstance, NativeInstance, PythonInstance, build_model, export
from phfmu.cli import main
from phfmu.network.members.fmu_member import FMUMember

UNITS = {"fmi2": "2.0", "fmi3": "3.0"}
MIXED = "fmi3 native fmi2"


@contextmanager
def unit_members(tmp_path: Path) -> Iterator[Callable[..., Coupled]]:
    """(network, kinds in turn, k, step) -> members stepped apart; `written`: more for `export`."""
    with ExitStack() as stack:
        paths: dict[Any, Path] = {}

        def make(net: Any, kinds: str, k: int, h: float, isolate: float | None = None, **how: Any) -> Coupled:
            members, written = list[Any](), how.pop("written", {})
            for (name, d), kind in zip(net.separate().items(), cycle(kinds.split()), strict=False):
                model = build_model(replace(d, name=name), Collocated(k))
                if kind not in UNITS:
                    members.append(EngineMember(name, model, NativeInstance(model)))
                    continue
                if (name, kind) not in paths or written:
                    kicked = model.events is None and any(p.kind != "none" for p in PythonInstance(model).impulse_ports)
                    folder, version = tmp_path / f"{name}{k}", (UNITS[kind],)
                    told = {"node_inputs": k > 1, "impulses": kicked} | written
                    (paths[name, kind],) = export(model, folder, version, step=h, **told)
                unit = stack.enter_context(FMUInstance(paths[name, kind], start=0.0, name=name, isolate=isolate))
                members.append(FMUMember(name, unit))
            return Coupled(net, members, **how)

        yield make


#: of the unit of another tool that `tests.fmu.foreign` makes: its port
SIDECAR = '[flange]\neffort = "F"\nflow = "v"\nsign = 1\n'


def pump_folder(folder: Path, scene: str, text: str) -> Path:
    """The folder with the file of a scene, and the ports of the unit `pump.fmu` that it names."""
    (folder / scene).write_text(text)
    (folder / "pump.ports.toml").write_text(SIDECAR)
    return folder


def table(folder: Path, target: str, *options: str) -> np.ndarray:
    """The rows of a run by command, by name."""
    out = folder / "out.csv"
    assert main(["run", f"{folder}/{target}", "-o", str(out), *options]) == 0
    return np.genfromtxt(out, delimiter=",", names=True, deletechars="")
