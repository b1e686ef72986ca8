"""The benchmark of the arm's speed runs tiny."""

import csv
import importlib.util
import sys
from pathlib import Path

import pytest


def test_it_runs_tiny_and_writes_both_files(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    path = Path(__file__).parents[2] / "benchmarks" / "arm_speed.py"
    spec = importlib.util.spec_from_file_location("arm_speed", path)
    assert spec is not None
    assert spec.loader is not None
    benchmark = importlib.util.module_from_spec(spec)
    monkeypatch.setitem(sys.modules, "arm_speed", benchmark)  # where dataclasses look for their annotations
    spec.loader.exec_module(benchmark)
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
