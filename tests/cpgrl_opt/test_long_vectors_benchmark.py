"""The benchmarks of long vectors run tiny."""

import csv
import sys
from collections.abc import Callable
from dataclasses import fields
from pathlib import Path
from types import ModuleType

import pytest

from cpgrl_opt.vectors import _numpy


def test_it_runs_tiny_and_writes_its_files(
    load_benchmark: Callable[[str], ModuleType],
    tmp_path: Path,
    monkeypatch: pytest.MonkeyPatch,
    capsys: pytest.CaptureFixture[str],
) -> None:
    benchmark = load_benchmark("long_vectors")
    monkeypatch.setattr(_numpy, "LEAST_PRODUCTS", 0)
    monkeypatch.setattr(benchmark, "REFERENCE", 2000)
    sizes = ["--parameters", "500,2000", "--constraints", "2,5", "--scale", "0.05"]
    monkeypatch.setattr(sys, "argv", ["long_vectors.py", *sizes, "--out", str(tmp_path)])
    benchmark.main()
    markdown = (tmp_path / "long_vectors.md").read_text(encoding="utf-8")
    assert markdown in capsys.readouterr().out
    assert "Failures: 0 of" in markdown
    assert "untouched, n = 2e+03, m = 5" in markdown
    with (tmp_path / "long_vectors.csv").open(newline="", encoding="utf-8") as file:
        reader = csv.DictReader(file)
        rows = [row for row in reader if row["work"] in benchmark.WORKS]
    assert reader.fieldnames == [field.name for field in fields(benchmark.Row)]
    assert {(row["n"], row["m"], row["work"]) for row in rows} == {
        (n, m, work) for n in ("500", "2000") for m in ("2", "5") for work in benchmark.WORKS
    }
    for row in rows:
        assert float(row["milliseconds"]) > 0
        assert float(row["error"]) < 1e-12
        if row["work"] == benchmark.OPPOSING:
            assert row["rung"] == "pairs"
        if row["work"] == benchmark.DIRECTION:
            assert row["rung"] == "gramian"


def test_the_one_of_memory_runs_tiny(
    load_benchmark: Callable[[str], ModuleType],
    tmp_path: Path,
    monkeypatch: pytest.MonkeyPatch,
    capsys: pytest.CaptureFixture[str],
) -> None:
    benchmark = load_benchmark("long_memory")
    monkeypatch.setattr(benchmark.importlib.util, "find_spec", lambda _: None)
    arguments = ["--parameters", "60000", "--constraints", "5", "--kinds", "float64,tree,tensor tree"]
    monkeypatch.setattr(sys, "argv", ["long_memory.py", *arguments, "--out", str(tmp_path)])
    benchmark.main()
    assert "SKIP torch: not installed" in capsys.readouterr().out
    with (tmp_path / "long_memory.csv").open(newline="", encoding="utf-8") as file:
        rows = list(csv.DictReader(file))
    assert [(row["kind"], row["m"], row["rung"]) for row in rows] == [
        (kind, "5", rung) for kind in ("float64", "tree") for rung in ("gramian", "pairs")
    ]
    assert "| tree | 6e+04 | 5 | pairs |" in (tmp_path / "long_memory.md").read_text(encoding="utf-8")


@pytest.mark.parametrize("kind", ["tensor float32", "tensor bfloat16", "tensor tree"])
def test_the_one_of_memory_takes_tensors(
    load_benchmark: Callable[[str], ModuleType], kind: str, monkeypatch: pytest.MonkeyPatch
) -> None:
    pytest.importorskip("torch")
    benchmark = load_benchmark("long_memory")
    monkeypatch.setattr(_numpy, "LEAST_PRODUCTS", 0)
    found = benchmark.memory_here(kind, 3000, 2, "gramian")
    assert (found.kind, found.rung, found.bar) == (kind, "gramian", 1 / 3 + benchmark.SLACK)
