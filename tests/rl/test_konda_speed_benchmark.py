"""The benchmark of the arm's speed runs tiny."""

import csv
import sys
from collections.abc import Callable
from pathlib import Path
from types import ModuleType

import pytest


def test_it_runs_tiny_and_writes_both_files(
    load_benchmark: Callable[[str], ModuleType],
    tmp_path: Path,
    monkeypatch: pytest.MonkeyPatch,
    capsys: pytest.CaptureFixture[str],
) -> None:
    benchmark = load_benchmark("arm_speed")
    monkeypatch.setattr(sys, "argv", ["arm_speed.py", "--scale", "0.001", "--out", str(tmp_path)])
    benchmark.main()
    markdown = (tmp_path / "arm_speed.md").read_text(encoding="utf-8")
    assert markdown in capsys.readouterr().out
    with (tmp_path / "arm_speed.csv").open(newline="", encoding="utf-8") as file:
        rows = list(csv.DictReader(file))
    assert [row["method"] for row in rows] == list(benchmark.CONTENDERS)
    for row in rows:
        assert float(row["microseconds_per_step"]) > 0
        assert 1 <= float(row["steps_per_episode"]) <= 1000
