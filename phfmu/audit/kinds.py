"""Kinds of what the audit writes and says: each is a string in files and tables, and a typed value in the code."""

from __future__ import annotations

from enum import StrEnum


class ColumnType(StrEnum):
    """Types of the values of a column."""

    I64 = "i64"
    I32 = "i32"
    F64 = "f64"
    NAME = "name"  # dictionary-encoded string
    TEXT = "text"


class RowKind(StrEnum):
    """Subjects of the rows of the table, which decide the columns that a row fills."""

    COMPONENT = "component"
    PORT = "port"
    JUNCTION = "junction"
    PART = "part"  # of a junction's energy
    NETWORK = "network"
    TERM = "term"  # of H or R of a component
    EVENT = "event"
    HASH = "hash"  # of where a component, or another part of the run, is at the end of a step


class Quality(StrEnum):
    """Quality of a known energy, of a component, port or junction."""

    EXACT = "exact"
    ESTIMATED = "estimated"  # a quadrature, not the step's own
    SILENT = "none"  # a unit that tells nothing
    LOOSE = "loose"  # junctions of members coupled once a step, or whose iteration was given up: told, not judged


class LedgerVerdict(StrEnum):
    """Verdicts on a component, junction or network; one that is not judged is named by its quality."""

    CLOSED = "closed"
    VIOLATED = "VIOLATED"
    ESTIMATED = Quality.ESTIMATED
    SILENT = Quality.SILENT
    LOOSE = Quality.LOOSE


class CellKind(StrEnum):
    """Kinds of values of a printed table, by which they are written and added up."""

    ENERGY = "energy"  # J, in the unit of the table
    RATIO = "ratio"
    TIME = "time"
    WORD = "word"
    NAME = "name"  # of the row
