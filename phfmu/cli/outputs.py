"""Outputs of a run: the result table, the audit and the picture; begun with it, fed by it, kept however it ends."""

from __future__ import annotations

import argparse
import sys
from collections.abc import Iterable, Mapping, Sequence
from pathlib import Path
from time import perf_counter
from typing import TYPE_CHECKING, Any

import numpy as np

from phfmu.cli.options import audit_file
from phfmu.cli.progress import ahead
from phfmu.fmu.isolation import exit_guard
from phfmu.runs.carried import carried, carry

if TYPE_CHECKING:
    from phfmu.audit import AuditWriter
    from phfmu.cli.checkpoints import CheckpointFile
    from phfmu.declare.shape import Shape
    from phfmu.network.scene import Event
    from phfmu.report.live_recording import LiveRecording
    from phfmu.report.view.recorded import LiveMotion
    from phfmu.results.writer import TableWriter
    from phfmu.runs.options import Options


class Outputs:
    """The files of -o, --audit, --plot and --view.

    Made before the model is: what would fail after the run fails here (ValueError, OSError), and the paths are those
    of the present folder, wherever a unit goes later. As a context manager it ends the files; on an exception they keep
    what was accepted, and a note of the exception says what that is. Without a row nothing is left.
    """

    def __init__(self, args: argparse.Namespace, checkpoints: CheckpointFile):
        self._checkpoints = checkpoints
        audit = audit_file(args)
        self._shown = {"-o": args.output, "--audit": audit, "--plot": args.plot, "--view": args.view}
        self._table_path = self._audit_path = None
        self.table: TableWriter | None = None
        self.sink: AuditWriter | None = None
        self._units_row, self._quiet, self._title, self._target = args.units_row, args.quiet, "", args.target
        self._picture: Path | None = None
        self._drawn: LiveRecording | None = None
        self._view: Path | None = None
        self._moved: LiveMotion | None = None
        self._shapes: tuple[Shape, ...] = ()
        #: signals of the picture that the scene names: patterns; those that the run has; patterns of which it has none
        self._patterns: Sequence[str] = ()
        self._chosen: list[str] = []
        self._absent: list[str] = []
        #: metadata of the audit: options, files, software and machine, as they are before the run
        self._origin: Mapping[str, object] = {}
        #: wall time spent on the result table
        self.seconds = 0.0
        #: what the picture does not show
        self.notes: tuple[str, ...] = ()
        if args.output:
            from phfmu.results.writer import check_table

            check_table(args.output)
            self._table_path = Path(args.output).absolute()
        if audit:
            from phfmu.audit.log.archive import require_free
            from phfmu.cli.origin import KEY, origin

            if checkpoints.found is None:
                require_free(audit, f"--audit {audit}")
            self._audit_path = Path(audit).absolute()
            self._origin = {KEY: origin(args)}
        if args.plot:
            from phfmu.report.picture.draw import check_picture

            check_picture(args.plot, "--plot")
            self._picture = Path(args.plot).absolute()
        if args.view:
            from phfmu.report.view.recorded import check_view

            check_view(args.view, "--view")
            self._view = Path(args.view).absolute()
        if self._table_path and self._audit_path:
            here = self._table_path.resolve()
            if here in (self._audit_path.resolve(), self._audit_path.with_suffix(".parquet").resolve()):
                raise ValueError(f"-o and --audit both name {args.output}; give the audit a file of its own")

    def begin(self, about: dict[str, str], shapes: tuple[Shape, ...] = (), shown: Sequence[str] = ()) -> None:
        """Open the audit of a run with these shapes; pictures are called by what `about` tells, `shown`: their signals."""
        self._title = f"{about['target']}: {about['run']}{about['kernels']}"
        self._target, self._shapes, self._patterns = about["target"], shapes, shown
        if self._audit_path:
            from phfmu.audit import AuditWriter

            going_on = self._checkpoints.outputs.get("audit")
            self.sink = AuditWriter(self._audit_path, {**about, **self._origin}, self._table_path, going_on)

    def columns(
        self, options: Options, events: Iterable[Event], names: Sequence[str], units: Sequence[str], kinds: Sequence[str],
        labels: Sequence[str],
    ) -> None:  # fmt: skip
        """Open table and picture of the rows of a run with these options and events, and say what is coming if that is much."""
        for line in () if self._quiet else ahead(options, len(names), self._table_path):
            print(f"phfmu: {line}", file=sys.stderr)
        if self._picture:
            from phfmu.pick import matching
            from phfmu.report.live_recording import LiveRecording
            from phfmu.report.recording import Mark

            marks = [Mark(e.t, f"{e.name} = {e.value:.6g}") for e in events]
            told = (dict(zip(names, texts, strict=True)) for texts in (units, kinds, labels))
            found = {pattern: matching(pattern, names) for pattern in self._patterns}
            self._chosen = list(dict.fromkeys(n for some in found.values() for n in some))
            self._absent = [pattern for pattern, some in found.items() if not some]
            self._drawn = LiveRecording(self._title, names, marks, *told, chosen=self._chosen)
            self._go_on(self._drawn, "picture")
        if self._view:
            from phfmu.report.view.recorded import LiveMotion

            self._moved = LiveMotion(self._target, self._shapes, names, options.t0, options.stop)
            self._go_on(self._moved, "motion")
        if self._table_path:
            from phfmu.results.writer import TableWriter

            marked = options.dense is not None
            going_on, marks = self._checkpoints.outputs.get("table"), self._checkpoints.asked
            self.table = TableWriter(
                self._table_path, names, units, marked, self._units_row, kinds, labels, going_on, marks
            )

    def _go_on(self, kept: LiveRecording | LiveMotion, name: str) -> None:
        """With the rows that a run that was ended had kept for a picture or a motion."""
        if (found := self._checkpoints.outputs.get(name)) is not None:
            carry(kept, found)

    def marks(self) -> dict[str, Any]:
        """Tells where the files are, once all rows so far are on the disk, and the rows that are kept for pictures."""
        return {
            "audit": None if self.sink is None else self.sink.mark(),
            "table": None if self.table is None else self.table.mark(),
            "picture": None if self._drawn is None else carried(self._drawn),
            "motion": None if self._moved is None else carried(self._moved),
        }

    def keep(self, time: np.ndarray, values: np.ndarray, inside: np.ndarray) -> None:
        """Rows as the run makes them."""
        if self.table is not None:
            before = perf_counter()
            self.table.add(time, values, inside)
            self.seconds += perf_counter() - before
        if self._drawn is not None:
            self._drawn.add(time, values)
        if self._moved is not None:
            self._moved.add(time, values)

    def happened(self, time: float, message: str) -> None:
        """A state event."""
        if self._drawn is not None:
            self._drawn.mark(time, message)

    def __enter__(self) -> Outputs:
        exit_guard.left = (
            *(["rows are in the .partial file of -o"] if self._table_path else []),
            *(["`phfmu audit recover` reads the audit"] if self._audit_path else []),
        )
        return self

    def __exit__(self, kind: type[BaseException] | None, error: BaseException | None, trace: object) -> None:
        exit_guard.left = ()
        if error is None:
            self._end()
            self._drop_streams()
            return
        if isinstance(error, KeyboardInterrupt) and (option := self._checkpoints.left):
            for file in (self.sink, self.table):
                if file is not None:
                    file.leave()
            error.add_note(f"the run goes on from its checkpoint with {option}")
            return
        try:
            said = self._end()
            self._drop_streams()
        except Exception as second:
            error.add_note(str(second))
            return
        if said:
            error.add_note(f"kept: {'; '.join(said)}")

    def _end(self) -> list[str]:
        """Finish the files; what they hold, in words."""
        said = []
        try:
            if self.table is not None and self._table_path is not None and self.table.rows:
                from phfmu.results.shapes_file import write_shapes

                self.table.close()
                write_shapes(self._table_path, self._shapes)
                said.append(f"{self._shown['-o']}, {self.table.rows} rows to t = {self.table.last:.9g} s")
        finally:
            if self.sink is not None and self.sink.rows:
                self.sink.close(self._checkpoints.asked)
                said.append(f"the audit {self._shown['--audit']}")
            elif self.sink is not None:
                self.sink.discard()
        return said + self._draw() + self._show()

    def _drop_streams(self) -> None:
        """Remove the checkpoint of a run whose files are in their places, and then what it would go on from."""
        if not self._checkpoints.asked:
            return
        self._checkpoints.ended()
        if self.table is not None:
            self.table.drop()
        if self.sink is not None:
            self.sink.drop()

    def _show(self) -> list[str]:
        """The motion of the rows, if it was asked for and there are any."""
        if self._view is None or self._moved is None or not self._moved.rows:
            return []
        from phfmu.report.view.recorded import write

        write(self._moved.motion(), self._view)
        return [f"the motion {self._shown['--view']}"]

    def _draw(self) -> list[str]:
        """The picture of the rows, if it was asked for and there are any."""
        if self._picture is None or self._drawn is None or not self._drawn.rows:
            return []
        from phfmu.report.picture.draw import draw
        from phfmu.report.picture.picture import picture

        drawn = picture(self._drawn, self._chosen)
        draw(drawn, self._picture)
        own = ["signals that the scene names for its picture; others: --signals NAME, or '*'"] if self._chosen else []
        if self._absent:
            own.append(f"the run has no signal {', '.join(self._absent)}, which the scene names for its picture")
        self.notes = (*own, *drawn.notes)
        return [f"the picture {self._shown['--plot']}"]
