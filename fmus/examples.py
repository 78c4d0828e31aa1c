"""Units with reference solutions, for tests of other tools: `python fmus/examples.py -o DIR`.

Each unit of examples.toml gets a folder for each FMI version with the files that the FMI project asks exporting tools for:
NAME.fmu, NAME_ref.csv (reference solution), NAME_in.csv (inputs, where it has some), NAME_ref.opt (times, tolerance), README.txt.
Source: github.com/modelica/fmi-standard.org, CONTRIBUTING.md, "Compatibility information".

The reference comes from the native engine, not from the unit.  Before anything is kept, FMPy validates each unit and runs it
with the files beside it; what differs by more than the tolerance told in NAME_ref.opt is an error.  DIR/README.md lists both.
"""

from __future__ import annotations

import argparse
import csv
import sys
import tomllib
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import fmpy
import numpy as np
from fmpy.validation import validate_fmu

from phfmu import Event, Model, Monolithic, NativeInstance, Options, Scene, __version__, build_model, export, run
from phfmu.components.library import build
from phfmu.fmu.export.export import PLATFORMS
from phfmu.schemes.named import named_scheme

HERE = Path(__file__).parent
VERSIONS = {"2.0": "fmi2", "3.0": "fmi3"}
LARGEST = 1_000_000  # bytes of a CSV file, by the rules


@dataclass(frozen=True)
class Example:
    """One unit with its run: the model, its row of examples.toml, times of communication points, inputs there."""

    name: str
    row: dict[str, Any]
    model: Model
    time: np.ndarray
    inputs: dict[str, list[list[float]]]  # name -> points [s, value]

    @property
    def step(self) -> float:
        return self.row["step"]

    def input_at(self, name: str) -> np.ndarray:
        """Values at the communication points, on straight lines between the points of the file."""
        t, value = np.array(self.inputs[name]).T
        return np.interp(self.time, t, value)


def examples(names: Sequence[str] = ()) -> list[Example]:
    rows = tomllib.loads((HERE / "examples.toml").read_text(encoding="utf-8"))
    if unknown := set(names) - set(rows):
        raise SystemExit(f"examples.toml has no {sorted(unknown)[0]}; it has: {', '.join(rows)}")
    return [example(name, rows[name]) for name in names or rows]


def example(name: str, row: dict[str, Any]) -> Example:
    found = build(row["target"])
    declaration = found.declaration() if isinstance(found, Scene) else found
    model = build_model(declaration, named_scheme(declaration, "auto", row.get("order", 2)))
    inputs = dict(row.get("inputs", {}))
    for port, points in row.get("factors", {}).items():
        inputs[port] = [[t, factor * start_of(declaration, port)] for t, factor in points]
    steps = round(row["stop"] / row["step"])
    return Example(name, row, model, np.arange(steps + 1) * row["step"], inputs)


def start_of(declaration: Any, name: str) -> float:
    """Start value of a scalar port input."""
    port = declaration.port(name.rpartition(".")[0])
    return float(np.ravel(port.start)[0])


def reference(e: Example) -> np.ndarray:
    """Columns time and the example's signals, at the spacing of the output."""
    changes = [
        Event(float(t), name, float(u)) for name in e.inputs for t, u in zip(e.time, e.input_at(name), strict=True)
    ]
    stop, before = float(e.row["stop"]), [c for c in changes if c.t < e.row["stop"]]
    result = run(Monolithic(e.model, NativeInstance(e.model)), Options(stop=stop, step=e.step, events=before))
    every = round(e.row["output"] / e.step)
    assert len(result.time) == len(e.time), (len(result.time), len(e.time))
    columns = [result.time, *(result.column(s) for s in e.row["signals"])]
    return np.column_stack(columns)[::every]


def write_csv(path: Path, head: Sequence[str], rows: Any) -> None:
    """The rules' form: names quoted, numbers not, commas between."""
    with path.open("w", newline="", encoding="utf-8") as file:
        writer = csv.writer(file, quoting=csv.QUOTE_NONNUMERIC, lineterminator="\n")
        writer.writerow(head)
        writer.writerows([float(x) for x in row] for row in rows)
    if path.stat().st_size > LARGEST:
        raise SystemExit(
            f"{path}: {path.stat().st_size} bytes, the rules allow {LARGEST}; raise `output` or lower `stop`"
        )


def write_options(path: Path, e: Example) -> None:
    lines = {
        "StartTime": 0.0,
        "StopTime": e.row["stop"],
        "StepSize": e.step,
        "RelTol": e.row["tolerance"],
        "SolverType": "FixedStep",
        "OutputIntervalLength": e.row["output"],
    }
    path.write_text("".join(f"{name}, {value}\n" for name, value in lines.items()), encoding="utf-8")


def readme(e: Example, version: str) -> str:
    inputs = (
        f"Inputs are in {e.name}_in.csv: straight lines between its rows. The unit holds an input from one communication point\n"
        f"to the next; the reference has its value at the start of each communication step of {e.step:g} s."
        if e.inputs
        else "The unit has no inputs that the reference changes."
    )
    return f"""{e.name}: {e.row["about"]}

An FMU for Co-Simulation, FMI {version}, made by phfmu {__version__}. It tests: {e.row["tests"]}.

{inputs}
The reference was computed by phfmu's native engine with the same steps; {e.name}_ref.opt gives times and the tolerance.
The signals energy.* are its ledger: energy.residual, the balance of all steps, has to stay at rounding level.
"""


def check(folder: Path, e: Example, wanted: np.ndarray) -> float:
    """FMPy validates the unit and runs it with the folder's files; the largest difference, relative to each signal's maximum."""
    unit = folder / f"{e.name}.fmu"
    if problems := validate_fmu(str(unit)):
        raise SystemExit(f"{unit}: {problems[0]}")
    signals = e.row["signals"]
    given = fmpy.util.read_csv(str(folder / f"{e.name}_in.csv")) if e.inputs else None
    got = fmpy.simulate_fmu(
        str(unit), stop_time=e.row["stop"], step_size=e.step, output_interval=e.step, input=given, output=signals
    )
    every = round(e.row["output"] / e.step)
    values = np.column_stack([got[s] for s in signals])[::every]
    scale = np.abs(wanted[:, 1:]).max(axis=0)
    worst = float((np.abs(values - wanted[:, 1:]).max(axis=0) / scale).max())
    if not worst <= e.row["tolerance"]:
        raise SystemExit(f"{unit}: FMPy differs from the reference by {worst:.1e}, told is {e.row['tolerance']:g}")
    return worst


def write(folder: Path, e: Example, version: str, wanted: np.ndarray, platforms: Sequence[str] | None = None) -> float:
    """All files of one unit; what FMPy's run of them differs."""
    folder.mkdir(parents=True, exist_ok=True)
    (made,) = export(e.model, folder, versions=(version,), step=e.step, stop=e.row["stop"], platforms=platforms)
    made.rename(folder / f"{e.name}.fmu")
    write_csv(folder / f"{e.name}_ref.csv", ["time", *e.row["signals"]], wanted)
    if e.inputs:
        times = sorted({t for points in e.inputs.values() for t, _ in points})
        columns = [np.interp(times, *np.array(points).T) for points in e.inputs.values()]
        write_csv(folder / f"{e.name}_in.csv", ["time", *e.inputs], np.column_stack([times, *columns]))
    write_options(folder / f"{e.name}_ref.opt", e)
    (folder / "README.txt").write_text(readme(e, version), encoding="utf-8")
    return check(folder, e, wanted)


def main(arguments: Sequence[str] | None = None) -> int:
    parser = argparse.ArgumentParser(description=(__doc__ or "").splitlines()[0])
    parser.add_argument("names", nargs="*", metavar="NAME", help="of examples.toml; all if none is given")
    parser.add_argument("-o", "--output", type=Path, required=True, metavar="DIR", help="where the folders go")
    parser.add_argument(
        "--all-platforms", action="store_true", help="units for Linux, Windows and macOS in one file each"
    )
    args = parser.parse_args(arguments)
    platforms = list(PLATFORMS) if args.all_platforms else None
    lines = [f"# Units made by phfmu {__version__}, with reference solutions\n"]
    lines += ["| unit | FMI | importing tool | largest difference | told |", "| --- | --- | --- | --- | --- |"]
    for e in examples(args.names):
        wanted = reference(e)
        for version, short in VERSIONS.items():
            worst = write(args.output / short / e.name, e, version, wanted, platforms)
            lines.append(f"| {e.name} | {version} | FMPy {fmpy.__version__} | {worst:.1e} | {e.row['tolerance']:g} |")
            print(args.output / short / e.name, f"FMPy differs by {worst:.1e}", sep=": ")
    lines += [
        "",
        "Differences are relative to the largest value of each signal. Each unit passed FMPy's validation without a remark.",
    ]
    (args.output / "README.md").write_text("\n".join(lines) + "\n", encoding="utf-8")
    return 0


if __name__ == "__main__":
    sys.exit(main())
