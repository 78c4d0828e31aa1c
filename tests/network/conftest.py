"""What tests of several files of members apart ask for."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from pathlib import Path

import pytest

from phfmu import Coupled
from tests.network.unit_members import unit_members


@pytest.fixture
def made(tmp_path: Path) -> Iterator[Callable[..., Coupled]]:
    """Makes members stepped apart of which some are units, written into the test's folder."""
    with unit_members(tmp_path) as make:
        yield make
