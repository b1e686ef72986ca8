"""The folder of a sweep: outcomes of cells, a line each, appended as they end, and the table made of them."""

import csv
import json
from collections.abc import Iterator, Mapping, Sequence
from contextlib import contextmanager
from dataclasses import asdict
from pathlib import Path
from typing import Any

import numpy as np

from cpgrl_opt.comparison.whole_file import whole_file

from ..description import words_of
from .cell import Cell, Outcome

OUTCOMES, TABLE = "outcomes.jsonl", "sweep.csv"


@contextmanager
def store(folder: Path | None, *, anew: bool = False) -> Iterator["Store"]:
    """The outcomes in a folder, made if it is not there and locked meanwhile; None: in memory alone. anew: none.

    Raises UnusableDirectoryError where there can be no such folder, FolderInUseError where another process has it.

    Parameters
    ----------
    folder
        Made if it is not there, and locked meanwhile; None: in memory alone.
    anew
        Forgets what it holds.

    Raises
    ------
    UnusableDirectoryError
        Where there can be no such folder.
    FolderInUseError
        Where another process has it.
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
                outcome = Outcome(**json.loads(line))
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
        """A table as CSV, whole or not at all; numbers in as many digits as they need to be the same when read."""
        if self.folder is None:
            return
        with whole_file(self.folder / name) as beside, beside.open("w", encoding="utf-8", newline="") as file:
            table = csv.DictWriter(file, columns, lineterminator="\n")
            table.writeheader()
            table.writerows(rows)


def rows_of(cell: Cell, outcome: Outcome, names: Sequence[str]) -> Iterator[dict[str, Any]]:
    """A row for each run, recorded episode and channel; one row for what ended with an error.

    names: of what was measured, in the order of the columns.

    Parameters
    ----------
    cell
        Settings and seed.
    outcome
        What was recorded of it.
    names
        Of what was measured, in the order of the columns.

    Yields
    ------
    dict
        A row, with every column.
    """
    known = {**{name: plain(value) for name, value in cell.settings.items()}, "seed": cell.seed}
    row = {**known, **dict.fromkeys(("run", "episode", "channel", *names, "error"), "")}
    if outcome.error:
        yield {**row, "episode": outcome.reached, "error": outcome.error}
        return
    values = {name: np.array(own) for name, own in outcome.values.items()}
    shape = next(iter(values.values())).shape
    for run, place, channel in np.ndindex(shape[1], shape[0], shape[2]):
        found = {name: own[place, run, channel].item() for name, own in values.items()}
        yield {**row, "run": run, "episode": outcome.episodes[place], "channel": channel, **found}


def plain(value: Any) -> Any:
    """A setting as a table holds it: numbers and texts as they are, what is made of parts as JSON.

    Parameters
    ----------
    value
        Of a setting.

    Returns
    -------
    None, bool, int, float or str
        For a cell of the table.
    """
    if isinstance(value, np.generic):
        value = value.item()
    if value is None or isinstance(value, bool | int | float | str):
        return value
    words = {} if isinstance(value, list | tuple | dict) else words_of("", value)
    return words[""] if len(words) == 1 else json.dumps(words or value, default=plain)
