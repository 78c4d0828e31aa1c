"""What tests of several files ask for."""

from __future__ import annotations

import pytest

from phfmu.engine.compile import CompilerMissing, require_compiler


@pytest.fixture
def compiler() -> None:
    """A C compiler for this machine; without one the test is skipped with the reason."""
    try:
        require_compiler()
    except CompilerMissing as error:
        pytest.skip(str(error))
