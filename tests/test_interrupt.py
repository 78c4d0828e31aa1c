"""SIGTERM ends what is going on, also where other people's code clears the error that the signal raised in it."""

from __future__ import annotations

import os
import signal
import time

import casadi as ca
import pytest

from phfmu.interrupt import AGAIN, Interrupted, raising


class Clears:
    """What CasADi asks for its form while it converts arguments; it clears errors that this raises."""

    def __init__(self, number: int) -> None:
        self.number, self.asked = number, 0

    def __SX__(self) -> ca.SX:
        self.asked += 1
        os.kill(os.getpid(), self.number)
        for _ in range(100):
            time.sleep(0.001)
        return ca.SX(1.0)


@pytest.mark.parametrize("number", [signal.SIGTERM, signal.SIGINT, signal.SIGHUP])
def test_an_error_that_was_cleared_is_raised_again(number: int) -> None:
    before, seen = signal.getsignal(signal.SIGALRM), Clears(number)
    kept = signal.signal(
        number, signal.SIG_DFL if number != signal.SIGINT else signal.default_int_handler
    )  # if ignored
    begun = time.monotonic()
    with pytest.raises(Interrupted) as stop, raising():
        with pytest.raises((NotImplementedError, TypeError)):
            ca.sin(seen)
        assert seen.asked  # the signal came, and nobody heard of it
        time.sleep(10.0)
    assert stop.value.number == number and time.monotonic() - begun < 4 * AGAIN
    assert signal.getsignal(signal.SIGALRM) is before and signal.getitimer(signal.ITIMER_REAL)[0] == 0.0
    signal.signal(number, kept)


def test_what_ends_by_it_is_left_alone() -> None:
    """Clean-up that takes longer than the time after which the signal is raised again."""
    done = []
    with pytest.raises(Interrupted), raising():
        try:
            os.kill(os.getpid(), signal.SIGTERM)
            time.sleep(10.0)
        finally:
            try:
                raise ValueError
            except ValueError:
                time.sleep(3 * AGAIN)
            done.append("whole")
    assert done == ["whole"]
