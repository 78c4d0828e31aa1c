"""What long work tells a terminal: one bar for runs and sweeps, one line for measurements, and nothing in a pipe."""

from __future__ import annotations

import io
import sys

import pytest

from phfmu.cli import main
from phfmu.cli.progress import ProgressBar, StatusLine


class Terminal(io.StringIO):
    def isatty(self) -> bool:
        return True


def terminal(monkeypatch: pytest.MonkeyPatch) -> Terminal:
    """In place of stderr, from within a test: pytest sets it anew after its fixtures."""
    made = Terminal()
    monkeypatch.setattr(sys, "stderr", made)
    monkeypatch.setenv("TERM", "xterm")
    return made


@pytest.mark.parametrize(
    ("line", "what"),
    [
        ("run mass --engine python --stop 0.01", "simulating"),
        ("sweep mass --vary m=1,2 --measure max(v) --engine python --stop 0.01", "runs"),
    ],
)
def test_verbs_show_a_bar_on_a_terminal(line: str, what: str, monkeypatch: pytest.MonkeyPatch) -> None:
    shown = terminal(monkeypatch)
    assert main(line.split()) == 0 and what in shown.getvalue()
    told = len(shown.getvalue())
    assert main([*line.split(), "--quiet"]) == 0 and len(shown.getvalue()) == told


def test_a_bar_goes_on_to_its_end(monkeypatch: pytest.MonkeyPatch) -> None:
    shown = terminal(monkeypatch)
    with ProgressBar("work", 4) as bar:
        for done in range(5):
            bar(done)
    assert "work" in shown.getvalue() and "100%" in shown.getvalue()


def test_a_line_is_taken_away(monkeypatch: pytest.MonkeyPatch) -> None:
    shown = terminal(monkeypatch)
    with StatusLine() as line:
        line("case 1")
    assert shown.getvalue().endswith("\r\x1b[K") and "case 1" in shown.getvalue()


def test_a_pipe_gets_nothing(monkeypatch: pytest.MonkeyPatch) -> None:
    pipe = io.StringIO()
    monkeypatch.setattr(sys, "stderr", pipe)
    with ProgressBar("work", 4) as bar, StatusLine() as line:
        bar(2)
        line("case 1")
    assert pipe.getvalue() == ""
