"""A tidy CSV that is on disk row by row while training runs, and in order at the end."""

from collections.abc import Sequence
from pathlib import Path
from types import TracebackType
from typing import Self, TextIO

from cpgrl_opt.comparison.whole_file import whole_file

# (label, run, episode), then measurements
Row = Sequence[str | int | float]


class TidyCsv:
    """Rows (label, run, episode, measurements …); use it as a context.

    `append` writes at once, so that a crash loses nothing that was finished. Leaving the context, also by an
    exception, sorts the file: labels in the given order, then run, then episode; the same rows, the same bytes.
    """

    def __init__(self, path: Path, columns: Sequence[str], labels: Sequence[str]) -> None:
        self.path = path
        self.header = ",".join(columns) + "\n"
        self.order = {label: position for position, label in enumerate(labels)}
        self.rows: list[tuple[int, int, int, str]] = []
        self._file: TextIO | None = None

    def append(self, rows: Sequence[Row]) -> None:
        """Rows as they come, flushed to the file."""
        if self._file is None:
            raise ValueError("rows should be appended inside the context; found the file closed")
        lines = []
        for label, run, episode, *measurements in rows:
            line = f"{label},{run},{episode}," + ",".join(f"{value:.9g}" for value in measurements) + "\n"
            self.rows.append((self.order[str(label)], int(run), int(episode), line))
            lines.append(line)
        self._file.writelines(lines)
        self._file.flush()

    def __enter__(self) -> Self:
        self._file = self.path.open("w", encoding="utf-8", newline="")
        self._file.write(self.header)
        self._file.flush()  # killed before the first row, it is a table of none
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        if self._file is not None:
            self._file.close()
            self._file = None
        with whole_file(self.path) as ordered:
            lines = [self.header, *(line for *_, line in sorted(self.rows))]
            ordered.write_text("".join(lines), encoding="utf-8", newline="")
