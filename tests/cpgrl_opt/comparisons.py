"""Measurements that nobody made, and a folder as a comparison of them leaves it."""

from pathlib import Path
from typing import Any

from cpgrl_opt.comparison.bench import Bench
from cpgrl_opt.comparison.cell_keys import cell_keys
from cpgrl_opt.comparison.measurement import Measurement
from cpgrl_opt.comparison.runner import ComparisonSettings, open_checkpoint


def measurement(**changes: Any) -> Measurement:
    """A success, but for the changes."""
    usual = {
        "solver": "active-set", "variant": "prepared", "family": "zero-rows", "problem": 0, "n": 9, "m": 4,
        "status": "OPTIMAL", "outcome": "success", "worst": 0.0, "distance": None, "seconds": 1e-5, "ratio": 1.0,
        "limit": 5.0, "noise": False,
    }  # fmt: skip
    return Measurement(**usual | changes)


def finish(settings: ComparisonSettings, folder: Path, versions: dict[str, str]) -> list[Measurement]:
    """All measurements of the settings, each a success, written into the folder."""
    checkpoint, cells = open_checkpoint(settings, folder, versions), settings.cells()
    keys = cell_keys(cells)
    checkpoint.finished({}, {})
    finished: list[Measurement] = []
    for cell, count in cells.items():
        names = dict(zip(("solver", "variant", "family"), cell, strict=True))
        rows = [measurement(problem=number, **names) for number in range(count)]
        checkpoint.append(rows, keys[cell])
        finished += rows
    return finished


class BenchHere:
    """In place of `isolated_bench`: measures in the test's process, which need not be started."""

    def __init__(self) -> None:
        self.bench = Bench()

    def apply(self, method: str, *arguments: Any, **_: float) -> Any:
        return getattr(self.bench, method.removeprefix("."))(*arguments)

    def close(self) -> None:
        pass
