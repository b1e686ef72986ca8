"""The benchmark's contenders compute the same thing, and it runs tiny."""

import csv
import sys
from collections.abc import Callable
from pathlib import Path
from types import ModuleType

import numpy as np
import pytest

from envs import ThreeStateMDP
from rl import SoftmaxTable


@pytest.fixture(scope="module")
def benchmark(load_benchmark: Callable[[str], ModuleType]) -> ModuleType:
    return load_benchmark("training_speed")


def test_after_equally_many_episodes_the_contenders_agree_within_six_standard_errors(benchmark: ModuleType) -> None:
    def values(theta: np.ndarray) -> np.ndarray:
        return ThreeStateMDP().average_rewards(SoftmaxTable(3, 3).probabilities(theta))

    reached = [
        values(run(runs, 25))
        for run, runs in [
            (benchmark.academic, 3),
            (benchmark.vectorised, 30),
            (benchmark.compiled("rosen"), 400),
            (benchmark.compiled("active-set"), 400),
        ]
    ]
    reference = reached[-1]
    for g in reached[:-1]:
        error = reference.std(axis=0) * np.sqrt(1 / len(g) + 1 / len(reference))
        assert (np.abs(g.mean(axis=0) - reference.mean(axis=0)) < 6 * error).all()


def test_it_runs_tiny_and_writes_both_files(
    benchmark: ModuleType, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.setattr(sys, "argv", ["training_speed.py", "--scale", "0.01", "--out", str(tmp_path)])
    benchmark.main()
    markdown = (tmp_path / "training_speed.md").read_text(encoding="utf-8")
    assert markdown in capsys.readouterr().out
    with (tmp_path / "training_speed.csv").open(newline="", encoding="utf-8") as file:
        rows = list(csv.DictReader(file))
    assert [row["method"] for row in rows] == list(benchmark.CONTENDERS)
    assert all(float(row["microseconds_per_step"]) > 0 for row in rows)
