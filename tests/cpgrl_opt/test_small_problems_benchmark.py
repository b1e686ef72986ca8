"""The benchmark of small problems runs tiny, and its formula is Rosen's."""

import csv
import sys
from collections.abc import Callable
from pathlib import Path
from types import ModuleType

import numpy as np
import pytest

from cpgrl_opt import project_onto_tangent
from cpgrl_opt.solvers import has_package


@pytest.mark.skipif(not has_package("quadprog"), reason="quadprog is not installed")
def test_it_runs_tiny_and_writes_its_files(
    load_benchmark: Callable[[str], ModuleType],
    tmp_path: Path,
    monkeypatch: pytest.MonkeyPatch,
    capsys: pytest.CaptureFixture[str],
) -> None:
    benchmark = load_benchmark("small_problems")
    monkeypatch.setattr(
        sys, "argv", ["small_problems.py", "--repetitions", "1", "--batch", "20", "--out", str(tmp_path)]
    )
    benchmark.main()
    markdown = (tmp_path / "small_problems.md").read_text(encoding="utf-8")
    assert markdown.strip() == capsys.readouterr().out.strip()
    assert "Failures: 0." in markdown
    with (tmp_path / "small_problems.csv").open(newline="", encoding="utf-8") as file:
        rows = list(csv.DictReader(file))
    assert [row["work"] for row in rows] == ["direction", "restoring", "equality", "batch of 20"]
    assert all(float(row["microseconds"]) > 0 and int(row["failed"]) == 0 for row in rows)


def test_the_formula_beside_a_batch_is_the_papers(load_benchmark: Callable[[str], ModuleType]) -> None:
    benchmark = load_benchmark("small_problems")
    rng = np.random.default_rng(0)
    g, J = rng.normal(size=(5, 9)), rng.normal(size=(5, 3, 9))
    for k, tangent in enumerate(benchmark.batched_rosen(g, J)):
        np.testing.assert_allclose(tangent, project_onto_tangent(J[k], g[k]), atol=1e-13)
