"""measurements.csv while it grows: a cell that is finished is on the disk, and a later run goes on from there."""

import csv
import io
import json
import os
from collections.abc import Collection, Mapping, Sequence
from pathlib import Path
from typing import Any

from .measurement import Measurement, columns, from_row, to_row, write_measurements

MEASUREMENTS, SETTINGS = "measurements.csv", "settings.json"

_TIME = "wall_seconds"  # beside the settings, and no setting

CellKey = tuple[str, str, str]  # solver, variant, family


class Checkpoint:
    """The folder of a comparison: settings.json, and measurements.csv, to which finished cells are added."""

    def __init__(self, folder: Path, settings: Mapping[str, Any], *, anew: bool = False) -> None:
        """Opens the folder, making it where it is missing. anew: forgets what is there.

        ValueError with advice where the folder holds measurements made with other settings.
        """
        folder.mkdir(parents=True, exist_ok=True)
        self.path = folder / MEASUREMENTS
        self._settings = folder / SETTINGS
        self.wall_seconds = 0.0
        if anew or not self.path.exists():
            self.path.unlink(missing_ok=True)
        else:
            self._require_agreement(folder, settings)
        self._facts = dict(settings)
        self.add_time(0.0)

    def add_time(self, seconds: float) -> None:
        """Adds to `wall_seconds`, the time spent on the folder so far, over all runs."""
        self.wall_seconds += seconds
        text = json.dumps({**self._facts, _TIME: round(self.wall_seconds, 1)}, indent=2, ensure_ascii=False)
        self._settings.write_text(text + "\n", encoding="utf-8")

    def finished(self, problems: Mapping[CellKey, int]) -> dict[CellKey, list[Measurement]]:
        """The cells that are there whole (problems: how many each should have); the rest leaves the file."""
        found: dict[CellKey, list[Measurement]] = {}
        for each in self._readable():
            found.setdefault((each.solver, each.variant, each.family), []).append(each)
        whole = {key: rows for key, rows in found.items() if _numbers(rows) == list(range(problems.get(key, -1)))}
        write_measurements(self.path, [each for rows in whole.values() for each in rows])
        return whole

    def append(self, measurements: Sequence[Measurement]) -> None:
        """The rows of a finished cell, in one write, on the disk when this returns."""
        text = io.StringIO(newline="")
        csv.DictWriter(text, columns(Measurement), lineterminator="\n").writerows(map(to_row, measurements))
        with self.path.open("a", encoding="utf-8", newline="") as file:
            file.write(text.getvalue())
            file.flush()
            os.fsync(file.fileno())

    def _require_agreement(self, folder: Path, settings: Mapping[str, Any]) -> None:
        try:
            before = json.loads(self._settings.read_text(encoding="utf-8"))
        except (OSError, ValueError):
            before = {}
        self.wall_seconds = float(before.get(_TIME, 0.0))
        differing = {name: before.get(name) for name in settings if before.get(name) != settings[name]}
        if differing:
            name, value = next(iter(differing.items()))
            raise ValueError(
                f"{folder} holds measurements made with {name} = {_told(value)}, and {name} is now "
                f"{_told(settings[name])}; take the same settings to continue, another --out, or --anew to start over"
            )

    def _readable(self) -> list[Measurement]:
        """All rows but one that was cut short: a crash in the midst of writing loses that cell only."""
        if not self.path.exists():
            return []
        text = self.path.read_text(encoding="utf-8")
        readable: list[Measurement] = []
        for row in csv.DictReader(io.StringIO(text)):
            try:
                readable.append(from_row(Measurement, row))
            except ValueError:
                continue  # the cell counts as unfinished
        return readable


def _numbers(rows: Collection[Measurement]) -> list[int]:
    return [each.problem for each in rows]


def _told(value: object) -> str:
    return "unknown" if value is None else json.dumps(value, ensure_ascii=False)
