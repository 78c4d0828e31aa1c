"""Exit codes of all verbs, and the kinds of targets."""

from __future__ import annotations

#: 0 fine, 1 problems found, 2 bad usage or input, 3 no convergence, 4 ledger violated
FINE, PROBLEMS, USAGE, NO_CONVERGENCE, LEDGER = range(5)

TARGET = "name in the library | file.py:function | X.ssp | X.ssd | X.fmu | X.raw | X.m; functions with arguments: 'chain(n=20)'"
