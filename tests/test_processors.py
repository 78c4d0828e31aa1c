"""Processors are counted in one place, those of this process where the system tells."""

from __future__ import annotations

import os

import pytest

from phfmu.processors import processors
from phfmu.sweeps import runs
from tests.test_rooms import walked


def test_those_that_the_process_may_use_count(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(os, "cpu_count", lambda: 64)
    monkeypatch.setattr(os, "sched_getaffinity", lambda _: {3}, raising=False)
    assert processors() == 1 == runs.processors()
    monkeypatch.delattr(os, "sched_getaffinity")
    assert processors() == 64


def test_nothing_else_asks_the_system() -> None:
    asking = {p.name for p in walked() if any(w in p.read_text() for w in ("cpu_count", "sched_getaffinity"))}
    assert asking == {"processors.py"}
