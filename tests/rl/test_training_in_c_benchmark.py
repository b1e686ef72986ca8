"""Training in C reaches the θ of `rl.train`, the benchmark notices where it does not, and it runs tiny."""

import csv
import os
import shutil
import sys
from collections.abc import Callable
from pathlib import Path
from types import ModuleType

import numpy as np
import pytest

needs_compiler = pytest.mark.skipif(
    shutil.which(os.environ.get("CC", "cc")) is None, reason="there is no C compiler: install gcc or clang"
)


@pytest.fixture
def benchmark(load_benchmark: Callable[[str], ModuleType]) -> ModuleType:
    return load_benchmark("training_in_c")


@needs_compiler
def test_c_reaches_the_same_parameters_where_restorations_contradict_each_other_too(
    benchmark: ModuleType, tmp_path: Path
) -> None:
    theta = benchmark.in_c("-O2", tmp_path)(
        1200
    )  # run 8 is the first: two opposing rows, both violated, in episode 1183
    assert np.abs(theta - benchmark.ours(1200)).max() <= 1e-13


@needs_compiler
def test_other_work_is_noticed(benchmark: ModuleType, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    other = tmp_path / "other.c"
    other.write_text(benchmark.SOURCE.read_text(encoding="utf-8").replace("BETA = 0.99", "BETA = 0.98"), "utf-8")
    monkeypatch.setattr(benchmark, "SOURCE", other)
    with pytest.raises(ValueError, match=r"C, -O2 and of rl.train should agree to 1e-12"):
        benchmark.measure(episodes=3, repetitions=1)


def test_without_a_compiler_it_says_what_to_install(
    benchmark: ModuleType, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setenv("PATH", str(tmp_path))
    monkeypatch.delenv("CC", raising=False)
    with pytest.raises(SystemExit, match=r"cc should be a C compiler; found none\. Install gcc or clang"):
        benchmark.in_c("-O2", tmp_path)


@needs_compiler
def test_it_runs_tiny_and_writes_both_files(
    benchmark: ModuleType, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    arguments = ["training_in_c.py", "--episodes", "2", "--repetitions", "1", "--out", str(tmp_path)]
    monkeypatch.setattr(sys, "argv", arguments)
    benchmark.main()
    assert (tmp_path / "training_in_c.md").read_text(encoding="utf-8") in capsys.readouterr().out
    with (tmp_path / "training_in_c.csv").open(newline="", encoding="utf-8") as file:
        rows = list(csv.DictReader(file))
    assert [row["method"] for row in rows] == ["rl.train", "C, -O2", "C, -O3 -march=native"]
    assert all(float(row["our_rate_as_a_share"]) > 0 for row in rows)
