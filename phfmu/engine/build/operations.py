"""Functions as tables of operations, by which a function is named by its content and interpreted by the runtime.

The tables are read from CasADi's functions of scalars.  Their slots are [constants | arguments | results of the operations], each
slot is written once.  A program has its operations in segments of equal ones that do not depend on each other; which operations
the runtime has, and in which order it numbers them, says `runtime/interpret/interpret.h`.
"""

from __future__ import annotations

import hashlib
import re
from dataclasses import dataclass, replace
from functools import cache, cached_property
from typing import Any

import casadi as ca
import numpy as np
from numpy.typing import NDArray

from phfmu.engine.build.runtime_sources import RUNTIME

Ints = NDArray[np.int32]
Floats = NDArray[np.float64]


class NotInterpreted(RuntimeError):
    """A function has an operation that only compiled code has; the message names it."""


@cache
def names() -> dict[int, str]:
    """CasADi's name of each of its operations, without OP_."""
    return {getattr(ca, n): n.removeprefix("OP_") for n in dir(ca) if n.startswith("OP_")}


@cache
def interpreted() -> dict[int, tuple[int, int]]:
    """CasADi's number of an operation -> number in the runtime, operands."""
    text = (RUNTIME / "interpret" / "interpret.h").read_text()
    unary, binary = (re.findall(r"^    X\((\w+),", part, re.M) for part in text.split("#define PH_")[2:4])
    found = [(name, 1) for name in unary] + [(name, 2) for name in binary]
    return {getattr(ca, f"OP_{name.upper()}"): (i, n) for i, (name, n) in enumerate(found)}


@dataclass(frozen=True, eq=False)
class Operations:
    """A function: lengths of its `arguments` and `results`, constants, rows of `code` (operation of CasADi, slots of its two
    operands), and the slots of the results, one after the other.
    """

    arguments: tuple[int, ...]
    results: tuple[int, ...]
    constants: Floats
    code: Ints
    out: Ints

    @property
    def first(self) -> int:
        """The slot of the first operation's result."""
        return len(self.constants) + sum(self.arguments)

    @cached_property
    def digest(self) -> bytes:
        """Hash of the content: equal functions have the same, however CasADi shares work between their operations."""
        content = [np.array(part, np.int64) for part in (self.arguments, self.results)]
        parts = [*content, self.constants, self.code, self.out]
        return hashlib.sha256(b"".join(len(p).to_bytes(8, "little") + p.tobytes() for p in parts)).digest()

    def only(self, n: int) -> Operations:
        """The function with its first n results, and the operations that these need."""
        out = self.out[: sum(self.results[:n])]
        first, code = self.first, self.code.tolist()
        needed = np.zeros(first + len(code), bool)
        needed[out] = True
        for i in range(len(code) - 1, -1, -1):
            if needed[first + i]:
                needed[code[i][1]] = needed[code[i][2]] = True
        needed[:first] = True
        place = (np.cumsum(needed) - 1).astype(np.int32)
        kept = self.code[needed[first:]].copy()
        kept[:, 1:] = place[kept[:, 1:]]
        return replace(self, results=self.results[:n], code=kept, out=place[out])

    def unknown(self) -> list[str]:
        """Names of operations that are not interpreted."""
        return sorted({names()[op] for op in set(self.code[:, 0].tolist()) - interpreted().keys()})

    def program(self) -> Program:
        """The program in segments, by a list scheduler: of the operations that are ready, the kind with the most comes next."""
        if unknown := self.unknown():
            raise NotInterpreted(
                f'{", ".join(unknown)}: an operation that only compiled code has; kernels="auto" (--kernels auto) compiles it'
            )
        first, rows = self.first, self.code.tolist()
        waits, users = [0] * len(rows), [[] for _ in rows]
        ready: dict[int, list[int]] = {}
        for i, (op, a, b) in enumerate(rows):
            for s in {a, b}:
                if s >= first:
                    waits[i] += 1
                    users[s - first].append(i)
            if not waits[i]:
                ready.setdefault(op, []).append(i)
        segments, order, operands = list[int](), list[int](), list[int]()
        place = list(range(first + len(rows)))
        while ready:
            op = max(ready, key=lambda kind: len(ready[kind]))
            found = ready.pop(op)
            number, arity = interpreted()[op]
            segments += [number, len(found)]
            for i in found:
                place[first + i] = first + len(order)
                order.append(i)
                operands += [place[s] for s in rows[i][1 : 1 + arity]]
            for i in found:
                for j in users[i]:
                    waits[j] -= 1
                    if not waits[j]:
                        ready.setdefault(rows[j][0], []).append(j)
        out = np.array(place, np.int32)[self.out]
        return Program(self, np.array(segments, np.int32), np.array(operands, np.int32), out)


@dataclass(frozen=True, eq=False)
class Program:
    """The members of ph_program that are arrays."""

    of: Operations
    segment: Ints
    operand: Ints
    out: Ints

    @property
    def derived(self) -> dict[str, Any]:
        """The other members of ph_program."""
        of = self.of
        return {
            "nargument": len(of.arguments),
            "nresult": len(of.results),
            "nconstant": len(of.constants),
            "nsegment": len(self.segment) // 2,
            "nslot": of.first + len(of.code),
            "argument": of.arguments,
            "result": of.results,
            "constant": of.constants,
        }


def operations(f: ca.Function) -> Operations:
    """The table of a function."""
    arguments = tuple(f.nnz_in(i) for i in range(f.n_in()))
    results = tuple(f.nnz_out(i) for i in range(f.n_out()))
    begin, end = np.cumsum([0, *arguments]).tolist(), np.cumsum([0, *results]).tolist()
    steps = [(f.instruction_id(i), i) for i in range(f.n_instructions())]
    values = dict.fromkeys(np.float64(f.instruction_constant(i)).tobytes() for op, i in steps if op == ca.OP_CONST)
    slot = {value: j for j, value in enumerate(values)}
    first = len(slot) + begin[-1]
    held: dict[int, int] = {}  # work place -> slot
    code, out = list[tuple[int, int, int]](), [0] * end[-1]
    for op, i in steps:
        if op == ca.OP_CONST:
            held[f.instruction_output(i)[0]] = slot[np.float64(f.instruction_constant(i)).tobytes()]
            continue
        inputs, outputs = f.instruction_input(i), f.instruction_output(i)
        if op == ca.OP_INPUT:
            held[outputs[0]] = len(slot) + begin[inputs[0]] + inputs[1]
        elif op == ca.OP_OUTPUT:
            out[end[outputs[0]] + outputs[1]] = held[inputs[0]]
        else:
            a, b = held[inputs[0]], held[inputs[-1]]
            held[outputs[0]] = first + len(code)
            code.append((op, a, b))
    constants = np.frombuffer(b"".join(values), np.float64)
    return Operations(arguments, results, constants, np.array(code, np.int32).reshape(-1, 3), np.array(out, np.int32))
