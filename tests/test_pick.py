"""Names by patterns: the same as an independent matcher finds, in no time whatever the pattern."""

from __future__ import annotations

import random
import subprocess
import sys
from fnmatch import fnmatchcase

import pytest

from phfmu.pick import pick

NAMES = ["gen.I[1]", "gen.I[2]", "gen.port.torque_step", "load.v", "a", "ab", "aab", "abab", "b.a[10]", "x^2 (mean)"]


def globbed(pattern: str) -> list[str]:
    own = pattern.replace("[", "[[]")  # brackets stand for themselves
    return [n for n in NAMES if fnmatchcase(n, own) or fnmatchcase(n.partition("[")[0], own)]


def test_random_patterns_mean_what_they_mean_elsewhere() -> None:
    random.seed(3)
    hits = 0
    for _ in range(5000):
        name = random.choice(NAMES)
        pattern = "".join(random.choice(["*", "?", c, c, c, ""]) for c in name)
        expected = globbed(pattern)
        hits += bool(expected)
        if expected:
            assert pick([pattern], NAMES, "the run") == expected, pattern
        else:
            with pytest.raises(ValueError, match="the run has no signal"):
                pick([pattern], NAMES, "the run")
    assert hits > 500


@pytest.mark.parametrize("pattern", ["'*' * 3000 + 'z'", "'*a' * 3000", "'?*' * 3000"])
def test_thousands_of_stars_take_no_time(pattern: str) -> None:
    code = f"from phfmu.pick import pick; pick([{pattern}], ['a' * 500] * 50, 'the run')"
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, timeout=60)
    assert "the run has no signal" in done.stderr and len(done.stderr.splitlines()[-1]) < 800
