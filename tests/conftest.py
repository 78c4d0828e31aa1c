"""What tests of several files ask for."""

from __future__ import annotations

import os
from collections import Counter
from collections.abc import Generator
from typing import Any

import pytest

from phfmu.engine.build.compile import CompilerMissing, require_compiler


def pytest_configure(config: pytest.Config) -> None:
    """By default equations are compiled without optimisation, which takes a fifth; the slow tests compile as users do."""
    if config.option.markexpr.startswith("not slow"):
        os.environ.setdefault("PHFMU_MODEL_FLAGS", "-O0")


def pytest_addoption(parser: pytest.Parser) -> None:
    parser.addoption("--cpu", action="store_true", help="files by CPU time, with that of processes they start")


@pytest.hookimpl(optionalhook=True)
def pytest_xdist_make_scheduler(config: pytest.Config, log: Any) -> Any:
    """Workers begin with a half of the files each: what tests of a file share is made once, not once by each worker."""
    if config.option.dist != "load":
        return None
    from xdist.scheduler import WorkStealingScheduling

    return WorkStealingScheduling(config, log)


def spent() -> float:
    """CPU time so far of this process and of those that it has waited for."""
    return sum(os.times()[:4])


@pytest.hookimpl(wrapper=True)
def pytest_runtest_protocol() -> Generator[None, Any, Any]:
    SINCE[:] = [spent()]
    return (yield)


@pytest.hookimpl(wrapper=True)
def pytest_runtest_makereport() -> Generator[None, Any, Any]:
    """Set-up, call and end have the time since the one before; reports of workers carry it."""
    report = yield
    SINCE.append(spent())
    report.cpu = SINCE[-1] - SINCE[-2]
    return report


SINCE: list[float] = []


def pytest_terminal_summary(terminalreporter: Any, config: pytest.Config) -> None:
    if not config.option.cpu:
        return
    files: Counter[str] = Counter()
    for report in (r for reports in terminalreporter.stats.values() for r in reports if hasattr(r, "cpu")):
        files[report.nodeid.partition("::")[0]] += report.cpu
    terminalreporter.section(f"{files.total():.0f} s of CPU time in tests")
    for name, seconds in files.most_common(30):
        terminalreporter.write_line(f"{seconds:7.1f}  {name}")


@pytest.fixture
def optimised(monkeypatch: pytest.MonkeyPatch) -> None:
    """Models are compiled as users compile them."""
    monkeypatch.delenv("PHFMU_MODEL_FLAGS", raising=False)


@pytest.fixture
def compiler() -> None:
    """A C compiler for this machine; without one the test is skipped with the reason."""
    try:
        require_compiler()
    except CompilerMissing as error:
        pytest.skip(str(error))
