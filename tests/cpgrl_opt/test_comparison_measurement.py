"""Measurements: through CSV and back, and how they add up to cells."""

import math
from pathlib import Path

import pandas as pd
import pytest

from cpgrl_opt.comparison.measurement import OUTCOMES, read_measurements, write_measurements
from cpgrl_opt.comparison.table import as_table, count_cells

from .comparisons import measurement

SOLVED = {"family": "well-conditioned, 9×3", "worst": 1e-16, "distance": 1 / 3, "seconds": 2e-3, "ratio": 2.0}
HUNG = SOLVED | {"problem": 1, "status": "", "outcome": "hang", "worst": math.inf, "distance": None, "noise": True}
UNTAKEN = {"outcome": "unsupported", "status": "UNSUPPORTED", "distance": None, "ratio": 0.0, "seconds": 0.0}


def counted(*changes: dict) -> pd.Series:
    """The only row of solvers.csv."""
    (row,) = [row for _, row in count_cells(as_table([measurement(**each) for each in changes])).iterrows()]
    return row


def test_a_file_comes_back_bit_for_bit(tmp_path: Path) -> None:
    measurements = [measurement(**each) for each in (SOLVED, HUNG, UNTAKEN)]
    write_measurements(tmp_path / "measurements.csv", measurements)
    assert read_measurements(tmp_path / "measurements.csv") == measurements


def test_a_file_with_other_columns_or_a_cut_row_is_refused(tmp_path: Path) -> None:
    path = tmp_path / "measurements.csv"
    path.write_text("solver,family\nosqp,zero\n")
    with pytest.raises(ValueError, match="should have the columns solver, variant"):
        read_measurements(path)
    write_measurements(path, [measurement()])
    path.write_text(path.read_text()[:-30])
    with pytest.raises(ValueError, match="a row should have 14 cells"):
        read_measurements(path)


def test_a_cell_counts_every_outcome_once() -> None:
    row = counted(*({"outcome": outcome} for outcome in OUTCOMES))
    assert list(row.index) == [
        "solver", "variant", "family", "problems", *(name.replace("-", "_") for name in OUTCOMES), "noise",
        "distance_median", "distance_max", "time_ratio", "worst_median",
    ]  # fmt: skip
    assert row["problems"] == len(OUTCOMES)
    assert (row.iloc[4:13] == 1).all()


def test_a_failure_counts_at_the_limit_in_a_geometric_mean_and_what_is_not_taken_nowhere() -> None:
    # The default takes 1 ms, so that a limit of 5 s is 5000 times as slow.
    row = counted(SOLVED, HUNG)
    assert row["time_ratio"] == pytest.approx(math.sqrt(2.0 * 5000.0))
    assert (row["noise"], row["distance_median"], row["worst_median"]) == (1, 1 / 3, 1e-16)
    assert counted(UNTAKEN)[["time_ratio", "worst_median", "distance_max"]].isna().all()
