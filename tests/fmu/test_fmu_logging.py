"""Messages: by category, and none where the importer wants none."""

from __future__ import annotations

import ctypes
from pathlib import Path
from typing import Any

import fmpy
import pytest
from fmpy.fmi1 import FMICallException
from fmpy.fmi2 import (
    FMU2Slave,
    fmi2CallbackAllocateMemoryTYPE,
    fmi2CallbackFreeMemoryTYPE,
    fmi2CallbackFunctions,
    fmi2CallbackLoggerTYPE,
)
from fmpy.fmi3 import FMU3Slave

from phfmu import build_model, export
from phfmu.components.mechanical.translational import mass
from phfmu.fmu.importer.archive import open_archive

ERRORS = "logStatusError"


@pytest.fixture(scope="module", params=["2.0", "3.0"])
def archive(request, tmp_path_factory: pytest.TempPathFactory):
    declaration = mass(1.0)
    folder: Path = tmp_path_factory.mktemp("mass")
    (path,) = export(build_model(declaration), folder, (request.param,), step=0.1)
    return open_archive(path)


def instance(archive, logging: bool) -> tuple[Any, list[str]]:
    """A unit and the categories of the messages it sends."""
    about, said = archive.interface, []
    common = {"guid": about.token, "modelIdentifier": about.identifier, "unzipDirectory": str(archive.folder)}
    if about.version == "2.0":
        unit: Any = FMU2Slave(libraryPath=str(archive.folder / archive.library), instanceName="u", **common)
        callbacks = fmi2CallbackFunctions()
        callbacks.logger = fmi2CallbackLoggerTYPE(lambda _e, _n, _s, category, _t: said.append(category.decode()))
        callbacks.allocateMemory = fmi2CallbackAllocateMemoryTYPE(fmpy.calloc)
        callbacks.freeMemory = fmi2CallbackFreeMemoryTYPE(fmpy.free)
        unit.instantiate(callbacks=callbacks, loggingOn=logging)
        unit.kept = callbacks
    else:
        unit = FMU3Slave(instanceName="u", **common)
        unit.instantiate(loggingOn=logging, logMessage=lambda _e, _s, category, _t: said.append(category.decode()))
    return unit, said


def refused(unit: Any, said: list[str]) -> list[str]:
    """The categories of what is said about a step that is not allowed yet."""
    said.clear()
    with pytest.raises(FMICallException):
        unit.doStep(0.0, 0.1)
    return list(said)


def log(unit: Any, on: bool, *names: bytes) -> None:
    set_logging = getattr(unit, "fmi2SetDebugLogging", None) or unit.fmi3SetDebugLogging
    set_logging(unit.component, on, len(names), (ctypes.c_char_p * max(len(names), 1))(*names))


def test_messages_follow_the_categories_asked_for(archive) -> None:
    unit, said = instance(archive, True)
    assert refused(unit, said) == [ERRORS]
    log(unit, False)
    assert refused(unit, said) == []
    log(unit, True)
    assert refused(unit, said) == [ERRORS]
    log(unit, True, b"logNonlinearSystems")
    assert refused(unit, said) == []
    log(unit, True, b"logNonlinearSystems", ERRORS.encode())
    assert refused(unit, said) == [ERRORS]
    with pytest.raises(FMICallException):
        log(unit, True, b"logEverything")
    assert said[-1] == ERRORS
    assert refused(unit, said) == [ERRORS], "a refused call changes nothing"
    unit.freeInstance()


def test_instantiated_without_logging(archive) -> None:
    """FMI 3.0: no message at all. FMI 2.0 switches those for debugging off, and errors are none of them."""
    unit, said = instance(archive, False)
    assert refused(unit, said) == ([ERRORS] if archive.interface.version == "2.0" else [])
    log(unit, False)
    assert refused(unit, said) == []
    unit.freeInstance()
