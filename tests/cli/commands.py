"""Commands in a folder with models, and the tables they write."""

from __future__ import annotations

import csv
from collections.abc import Callable

import numpy as np
import pyarrow.parquet as pq

Cli = Callable[..., tuple[int, str, str]]


MODELS = '''
"""Models of a user."""
from phfmu import Event, Network, Scene
from phfmu.components.mechanical.translational import mass, spring

def pushed():
    """A free mass, pushed by 2 N on [0.31, 0.52)."""
    events = (Event(0.31, "flange.force", 2.0), Event(0.52, "flange.force", 0.0))
    return Scene("pushed", mass(2.0), 1.0, 0.1, events)

def joined():
    net = Network("joined", description="mass and spring")
    net.add("m", mass(1.0, q=0.5))
    net.add("s", spring(3.0, elongation=0.2))
    net.connect("m.flange", "s.b", name="joint")
    return net

ready = mass(3.0)
'''


def table(path: str) -> tuple[list[str], np.ndarray]:
    """Names and rows of a CSV or Parquet result."""
    if path.endswith(".parquet"):
        t = pq.read_table(path)
        return t.column_names, np.column_stack([t[n].to_numpy() for n in t.column_names])
    with open(path, newline="") as file:
        rows = list(csv.reader(file))
    return rows[0], np.array(rows[1:], float)


def column(path: str, name: str) -> np.ndarray:
    names, rows = table(path)
    return rows[:, names.index(name)]


def balances(text: str) -> list[str]:
    """The lines of the energy tables without the head of a run, in no order."""
    return sorted(text[text.index("Energy in joule") :].splitlines())
