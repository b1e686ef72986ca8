"""The benchmark of tensors runs tiny, with and without the packages that it compares."""

import csv
import importlib.util
import sys
from collections.abc import Callable
from pathlib import Path
from types import ModuleType

import pytest

from cpgrl_opt.vectors import _numpy


def run(benchmark: ModuleType, folder: Path, monkeypatch: pytest.MonkeyPatch) -> list[dict[str, str]]:
    monkeypatch.setattr(_numpy, "LEAST_PRODUCTS", 20_000)
    sizes = ["--parameters", "150,1000", "--reference", "1000", "--scale", "0.04"]
    monkeypatch.setattr(sys, "argv", ["tensors.py", *sizes, "--out", str(folder)])
    benchmark.main()
    with (folder / "tensors.csv").open(newline="", encoding="utf-8") as file:
        return list(csv.DictReader(file))


def test_it_runs_tiny_and_compares_what_is_installed(
    load_benchmark: Callable[[str], ModuleType],
    tmp_path: Path,
    monkeypatch: pytest.MonkeyPatch,
    capsys: pytest.CaptureFixture[str],
) -> None:
    rows = run(load_benchmark("tensors"), tmp_path, monkeypatch)
    said = capsys.readouterr().out
    for name, lines in (("torch", 7), ("jax", 1), ("torchjd", 18)):
        kinds = [row for row in rows if (row["beside"] == "arrays") != (name == "torchjd")]
        if name != "torchjd":
            kinds = [row for row in kinds if {"torch": "tensor", "jax": "JAX"}[name] in row["kind"]]
        has_it = all(map(importlib.util.find_spec, {name, "torch"} if name == "torchjd" else {name}))
        assert len(kinds) == (lines if has_it else 0)
        assert has_it or f"SKIP {name}" in said or name == "torchjd"
    assert "Failures: 0 of" in (tmp_path / "tensors.md").read_text(encoding="utf-8")
    for row in rows:
        assert row["rung"] == ("rows" if row["n"] == "150" else "gramian")
        assert float(row["error"]) < (0.02 if "bfloat16" in row["kind"] else 1e-6)
        if row["beside"] == "DualProj" and "bfloat16" not in row["kind"]:
            assert float(row["apart"]) < 1e-3


def test_what_is_missing_is_said(
    load_benchmark: Callable[[str], ModuleType],
    tmp_path: Path,
    monkeypatch: pytest.MonkeyPatch,
    capsys: pytest.CaptureFixture[str],
) -> None:
    for name in ("torch", "torchjd.aggregation", "jax"):
        monkeypatch.setitem(sys.modules, name, None)
    rows = run(load_benchmark("tensors"), tmp_path, monkeypatch)
    assert {row["beside"] for row in rows} == {"arrays"}
    assert len(rows) == 6
    said = capsys.readouterr().out
    for name in ("torch", "torchjd.aggregation", "jax"):
        assert f"SKIP {name}: not installed" in said
