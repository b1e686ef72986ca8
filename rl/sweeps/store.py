"""The folder of a sweep: outcomes of cells, a line each, appended as they end, and the table made of them."""

import csv
import io
import json
from collections.abc import Iterator, Mapping, Sequence
from contextlib import contextmanager
from dataclasses import asdict
from pathlib import Path
from typing import Any

from cpgrl_opt.comparison.whole_file import whole_file

from .cell import Cell, Outcome

OUTCOMES, TABLE = "outcomes.jsonl", "sweep.csv"


@contextmanager
def store(folder: Path | None, *, anew: bool = False) -> Iterator["Store"]:
    """The outcomes in a folder, made if it is not there and locked meanwhile; None: in memory alone. anew: none.

    Raises UnusableDirectoryError where there can be no such folder, FolderInUseError where another process has it.
    """
    if folder is None:
        yield Store(None)
        return
    from ..experiments.results_directory import reserve

    with reserve(folder):
        if anew:
            (folder / OUTCOMES).unlink(missing_ok=True)
        yield Store(folder)


class Store:
    """Outcomes by key; what ended with an error is not kept, so that it is tried again."""

    def __init__(self, folder: Path | None) -> None:
        self.folder = folder
        self.found: dict[str, Outcome] = {}
        if folder is not None and (folder / OUTCOMES).exists():
            self._read(folder / OUTCOMES)

    def _read(self, path: Path) -> None:
        """Looks at whole lines alone; one that a killed process left torn is cut off."""
        content = path.read_bytes()
        whole = content[: content.rfind(b"\n") + 1]
        if len(whole) < len(content):
            with path.open("r+b") as file:
                file.truncate(len(whole))
        for line in whole.splitlines():
            try:
                outcome = Outcome(**json.loads(line)).check()
            except (ValueError, TypeError):  # not ours, or damaged: that cell is trained again
                continue
            self.found[outcome.key] = outcome

    def add(self, outcome: Outcome) -> None:
        """Writes it to the file: it outlives a killed process, though not a power cut."""
        if outcome.error:
            return
        self.found[outcome.key] = outcome
        if self.folder is not None:
            with (self.folder / OUTCOMES).open("ab") as file:
                file.write(json.dumps(asdict(outcome)).encode() + b"\n")

    def write(self, columns: Sequence[str], rows: Sequence[Mapping[str, Any]], name: str = TABLE) -> None:
        """A table as CSV, in one go."""
        if self.folder is not None:
            write_csv(self.folder / name, columns, rows)


def write_csv(path: Path, columns: Sequence[str], rows: Sequence[Mapping[str, Any]]) -> None:
    """Rows as CSV, whole or not at all; numbers in as many digits as they need to be the same when read."""
    text = io.StringIO(newline="")
    table = csv.DictWriter(text, columns, lineterminator="\n")
    table.writeheader()
    table.writerows(rows)
    with whole_file(path) as beside:
        beside.write_text(text.getvalue(), encoding="utf-8", newline="")


def rows_of(cell: Cell, outcome: Outcome, names: Sequence[str]) -> Iterator[dict[str, Any]]:
    """A row for each run, recorded episode and channel; one row for what ended with an error."""
    known = {**{name: plain(value) for name, value in cell.settings.items()}, "seed": cell.seed}
    empty = dict.fromkeys(("run", "episode", "channel", *names, "error"), "")
    if outcome.error:
        yield {**known, **empty, "episode": outcome.reached, "error": outcome.error}
        return
    first = next(iter(outcome.values.values()))
    for run in range(len(first[0])):
        for position, episode in enumerate(outcome.episodes):
            for channel in range(len(first[0][run])):
                values = {name: outcome.values[name][position][run][channel] for name in outcome.values}
                yield {**known, **empty, "run": run, "episode": episode, "channel": channel, **values}


def plain(value: Any) -> Any:
    """A setting as a table holds it: numbers and texts as they are, what is made of parts as JSON."""
    from ..description import describe

    found = describe(value)
    return found if found is None or isinstance(found, (bool, int, float, str)) else json.dumps(found)
