"""measurements.csv while it grows: a cell that is finished is in it, and a later run goes on from there."""

import csv
import io
import json
import os
from collections.abc import Collection, Iterable, Mapping, Sequence
from pathlib import Path
from typing import Any

from .measurement import AS_BYTES, Measurement, from_row, to_row, write_measurements
from .whole_file import whole_file

MEASUREMENTS, SETTINGS, KEYS = "measurements.csv", "settings.json", "keys.csv"

_TIME = "wall_seconds"  # beside the settings, and no setting

CellKey = tuple[str, str, str]  # solver, variant, family
_KEY_COLUMNS = ("solver", "variant", "family", "key")


class Checkpoint:
    """The folder of a comparison: settings.json, and measurements.csv, to which finished cells are added.

    keys.csv has a key for what each cell was measured on; a cell whose key has changed counts as unfinished. Cells
    that are not asked for this time stay in the file. After `finished` these are in `kept`, those whose key has changed
    in `stale`.
    """

    def __init__(
        self, folder: Path, settings: Mapping[str, Any], *, fixed: Collection[str] = (), anew: bool = False
    ) -> None:
        """Opens the folder, making it where it is missing. anew: forgets what is there.

        ValueError with advice where the folder holds measurements made with other settings. Of a setting that is a
        mapping only the names in `fixed` have to agree: what else changes shows in the cells' keys.
        """
        folder.mkdir(parents=True, exist_ok=True)
        self.path = folder / MEASUREMENTS
        self._settings, self._keys = folder / SETTINGS, folder / KEYS
        self.wall_seconds = 0.0
        self.kept: dict[CellKey, list[Measurement]] = {}
        self.stale: list[CellKey] = []
        self._facts = dict(settings)
        if anew or not self.path.exists():
            self.path.unlink(missing_ok=True)
            self._keys.unlink(missing_ok=True)
        else:
            self._agree_with_folder(fixed)
        self.add_time(0.0)

    def add_time(self, seconds: float) -> None:
        """Adds to `wall_seconds`, the time spent on the folder so far, over all runs."""
        self.wall_seconds += seconds
        text = json.dumps({**self._facts, _TIME: round(self.wall_seconds, 1)}, indent=2, ensure_ascii=False)
        with whole_file(self._settings) as beside:
            beside.write_text(text + "\n", encoding="utf-8", errors=AS_BYTES)

    def finished(
        self, problems: Mapping[CellKey, int], keys: Mapping[CellKey, str]
    ) -> dict[CellKey, list[Measurement]]:
        """The cells asked for that are complete and whose key has not changed; the rows of the others are removed.

        problems: how many each cell that is asked for should have. keys: what theirs are now.
        """
        found: dict[CellKey, list[Measurement]] = {}
        for each in self._readable():
            found.setdefault((each.solver, each.variant, each.family), []).append(each)
        written = self._written_keys()
        self.kept = {cell: rows for cell, rows in found.items() if cell not in problems}
        self.stale = [cell for cell in found if cell in problems and written.get(cell) != keys[cell]]
        whole = {
            cell: rows
            for cell, rows in found.items()
            if cell in problems
            and cell not in self.stale
            and [each.problem for each in rows] == [*range(problems[cell])]
        }
        self.rewrite([each for rows in whole.values() for each in rows])
        self._write_keys({cell: word for cell, word in written.items() if cell in whole or cell in self.kept})
        return whole

    def rewrite(self, measurements: Iterable[Measurement]) -> None:
        """The file anew: these rows, then those of the cells that are not asked for."""
        write_measurements(self.path, [*measurements, *(each for rows in self.kept.values() for each in rows)])

    def append(self, measurements: Sequence[Measurement], key: str) -> None:
        """The rows of a finished cell, in one write, on the disk when this returns. key: what it was measured on."""
        first = measurements[0]
        # The key first: without rows it does no harm.
        _append(self._keys, [(first.solver, first.variant, first.family, key)])
        _append(self.path, [[*to_row(each).values()] for each in measurements])

    def _agree_with_folder(self, fixed: Collection[str]) -> None:
        try:
            before = json.loads(self._settings.read_text(encoding="utf-8", errors=AS_BYTES))
        except (OSError, ValueError):
            before = {}
        self.wall_seconds = float(before.get(_TIME, 0.0))
        for name, now in self._facts.items():
            then = before.get(name)
            if not isinstance(now, Mapping):
                self._require_agreement(name, then, now)
                continue
            then = then or {}
            for key in (key for key in now if key in then and key in fixed):
                self._require_agreement(f"{name}: {key}", then[key], now[key])
            self._facts[name] = {**then, **now}

    def _require_agreement(self, name: str, then: object, now: object) -> None:
        if then != now:
            raise ValueError(
                f"{self.path.parent} holds measurements made with {name} = {_as_json(then)}, and {name} is now "
                f"{_as_json(now)}; take the same settings to continue, another --out, or --anew to start over"
            )

    def _written_keys(self) -> dict[CellKey, str]:
        if not self._keys.exists():
            return {}
        text = self._keys.read_text(encoding="utf-8", errors=AS_BYTES)
        rows = [row for row in csv.reader(io.StringIO(text)) if len(row) == len(_KEY_COLUMNS)]
        return {(solver, variant, family): word for solver, variant, family, word in rows[1:]}

    def _write_keys(self, keys: Mapping[CellKey, str]) -> None:
        with (
            whole_file(self._keys) as beside,
            beside.open("w", encoding="utf-8", errors=AS_BYTES, newline="") as file,
        ):
            writer = csv.writer(file, lineterminator="\n")
            writer.writerows([_KEY_COLUMNS, *((*key, word) for key, word in keys.items())])

    def _readable(self) -> list[Measurement]:
        """All rows but one that was cut short: a crash in the midst of writing loses that cell only."""
        if not self.path.exists():
            return []
        text = self.path.read_text(encoding="utf-8", errors=AS_BYTES)
        readable: list[Measurement] = []
        for row in csv.DictReader(io.StringIO(text)):
            try:
                readable.append(from_row(row))
            except ValueError:
                continue  # the cell counts as unfinished
        return readable


def _append(path: Path, rows: Iterable[Sequence[str]]) -> None:
    text = io.StringIO(newline="")
    csv.writer(text, lineterminator="\n").writerows(rows)
    with path.open("a", encoding="utf-8", errors=AS_BYTES, newline="") as file:
        file.write(text.getvalue())
        file.flush()
        os.fsync(file.fileno())


def _as_json(value: object) -> str:
    return "unknown" if value is None else json.dumps(value, ensure_ascii=False)
