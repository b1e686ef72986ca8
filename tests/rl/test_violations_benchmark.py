"""The benchmark of violations: its files, its intervals, and what no noise can hide."""

import csv
import sys
from pathlib import Path

import numpy as np
import pytest

ROOT = Path(__file__).parents[2]
METHODS = ["restoring", "linearized, κ = 1", "linearized, κ = ½"]


@pytest.fixture
def benchmark(monkeypatch):
    monkeypatch.syspath_prepend(str(ROOT / "benchmarks"))
    import violations_on_the_way

    return violations_on_the_way


def test_every_run_of_every_task_and_method_is_in_the_files(benchmark, tmp_path, monkeypatch, capsys):
    monkeypatch.setattr(sys, "argv", ["", "--seeds", "2", "--scale", "0.01", "--out", str(tmp_path)])
    benchmark.main()
    printed = capsys.readouterr().out
    with (tmp_path / "violations_on_the_way.csv").open(encoding="utf-8") as file:
        rows = list(csv.DictReader(file))
    expected = [(task, method, seed) for task in ("exact", "estimated", "arm") for method in METHODS for seed in "01"]
    assert [(row["task"], row["method"], row["seed"]) for row in rows] == expected
    for row in rows:
        assert 0 <= float(row["noticed"]) <= float(row["violated"]) <= 1
        assert 0 <= float(row["mean"]) <= float(row["largest"])
    assert (tmp_path / "violations_on_the_way.md").read_text(encoding="utf-8").strip() == printed.strip()
    assert (tmp_path / "violations_on_the_way.png").read_bytes().startswith(b"\x89PNG")


def test_with_exact_gradients_linearized_stays_where_restoring_steps_over(benchmark):
    task = benchmark.tasks(0.25)["exact"]
    restoring, linearized = (benchmark.learn(task, method, 2) for method in METHODS[:2])
    feasible = (restoring.slack[:, 0] >= 0) & (linearized.slack[:, 0] >= 0)
    assert feasible.any()
    over, within = -restoring.slack[feasible].min(axis=1), -linearized.slack[feasible].min(axis=1)
    assert (over > 10 * within).all()
    assert (over > 0.1).all()


def test_block_means_are_rewards_over_steps(benchmark):
    episodes = 3 * benchmark.BLOCKS
    sums = np.ones((episodes, 2, 3))
    sums[:, 1, :2] = [6.0, -3.0]
    sums[::3, :, 2] = 4.0  # steps 4, 1, 1
    means = benchmark.block_means(sums)
    assert means.shape == (2, benchmark.BLOCKS, 2)
    np.testing.assert_allclose(means, [[[0.5, 0.5]] * benchmark.BLOCKS, [[3.0, -1.5]] * benchmark.BLOCKS])


@pytest.mark.parametrize(("runs", "first"), [(20, 6), (10, 2), (5, 1), (1, 1)])
def test_the_interval_is_that_of_the_binomial_distribution(benchmark, runs, first):
    from violations_page import median_interval

    values = np.random.default_rng(0).permutation(np.arange(1.0, runs + 1))
    assert median_interval(values) == ((runs + 1) / 2, first, runs + 1 - first)
