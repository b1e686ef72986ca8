"""Measurements: through CSV and back, and how they add up to cells."""

import math
from dataclasses import replace
from pathlib import Path

import pytest

from cpgrl_opt.comparison.measurement import (
    OUTCOMES,
    Measurement,
    cells_of,
    read_cells,
    read_measurements,
    write_cells,
    write_measurements,
)

SOLVED = Measurement(
    solver="active-set", variant="prepared", family="well-conditioned, 9×3", problem=0, n=9, m=3, status="OPTIMAL",
    outcome="success", worst=1e-16, distance=1 / 3, seconds=2e-3, ratio=2.0, limit=5.0, noise=False,
)  # fmt: skip
HUNG = replace(SOLVED, problem=1, status="", outcome="hang", worst=math.inf, distance=None, noise=True)


def test_both_files_come_back_bit_for_bit(tmp_path: Path) -> None:
    measurements = [SOLVED, HUNG, replace(SOLVED, variant="raw", outcome="unsupported")]
    write_measurements(tmp_path / "measurements.csv", measurements)
    assert read_measurements(tmp_path / "measurements.csv") == measurements
    write_cells(tmp_path / "solvers.csv", cells_of(measurements))
    assert read_cells(tmp_path / "solvers.csv") == cells_of(measurements)
    assert (tmp_path / "solvers.csv").read_text().startswith("solver,")


def test_a_file_with_other_columns_or_a_cut_row_is_refused(tmp_path: Path) -> None:
    path = tmp_path / "measurements.csv"
    path.write_text("solver,family\nosqp,zero\n")
    with pytest.raises(ValueError, match="should have the columns solver, variant"):
        read_measurements(path)
    write_measurements(path, [SOLVED])
    path.write_text(path.read_text()[:-30])
    with pytest.raises(ValueError, match="a row should have 14 cells"):
        read_measurements(path)


def test_a_cell_counts_every_outcome_once() -> None:
    (cell,) = cells_of([replace(SOLVED, outcome=outcome) for outcome in OUTCOMES])
    assert cell.problems == len(OUTCOMES)
    assert all(getattr(cell, outcome.replace("-", "_")) == 1 for outcome in OUTCOMES)


def test_a_failure_counts_at_the_limit_in_a_geometric_mean() -> None:
    # The default takes 1 ms, so that a limit of 5 s is 5000 times as slow.
    (cell,) = cells_of([SOLVED, HUNG])
    assert cell.time_ratio == pytest.approx(math.sqrt(2.0 * 5000.0))
    assert (cell.noise, cell.distance_median, cell.worst_median) == (1, 1 / 3, 1e-16)


def test_what_a_solver_does_not_take_has_no_time() -> None:
    (cell,) = cells_of([replace(SOLVED, outcome="unsupported", status="UNSUPPORTED", distance=None)])
    assert (cell.time_ratio, cell.worst_median, cell.distance_max) == (None, None, None)
