"""What tests of several files ask for."""

from __future__ import annotations

import os

import pytest

from phfmu.engine.compile import CompilerMissing, require_compiler


def pytest_configure(config: pytest.Config) -> None:
    """By default equations are compiled without optimisation, which takes a fifth; the slow tests compile as users do."""
    if config.option.markexpr == "not slow":
        os.environ.setdefault("PHFMU_MODEL_FLAGS", "-O0")


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
