"""Benchmarks of directions run tiny: they write their pages, and what they compare is right."""

import csv
import importlib.util
import shlex
import sys
from dataclasses import fields

import numpy as np
import pytest

from cpgrl_opt import project_onto_tangent
from cpgrl_opt.solvers import has_package

from .long import least_products


@pytest.fixture
def run_tiny(load_benchmark, tmp_path, monkeypatch, capsys):
    """run_tiny(name, arguments, **constants): the benchmark as a module, its rows, its page and what it printed."""

    def run(name, arguments, **constants):
        benchmark = load_benchmark(name)
        vars(benchmark).update(constants)
        monkeypatch.setattr(sys, "argv", [f"{name}.py", *shlex.split(arguments), "--out", str(tmp_path)])
        benchmark.main()
        with (tmp_path / f"{name}.csv").open(newline="", encoding="utf-8") as file:
            rows = list(csv.DictReader(file))
        return benchmark, rows, (tmp_path / f"{name}.md").read_text(encoding="utf-8"), capsys.readouterr().out

    return run


def test_long_vectors(run_tiny):
    arguments = "--parameters 500,2000 --constraints 2,5 --scale 0.05"
    with least_products(0):
        benchmark, rows, page, said = run_tiny("long_vectors", arguments, REFERENCE=2000)
    assert page in said
    assert "Failures: 0 of" in page
    assert "untouched, n = 2e+03, m = 5" in page
    assert list(rows[0]) == [field.name for field in fields(benchmark.Row)]
    rows = [row for row in rows if row["work"] in benchmark.WORKS]
    sizes = {(n, m, work) for n in ("500", "2000") for m in ("2", "5") for work in benchmark.WORKS}
    assert {(row["n"], row["m"], row["work"]) for row in rows} == sizes
    rungs = {benchmark.OPPOSING: "pairs", benchmark.DIRECTION: "gramian"}
    for row in rows:
        assert float(row["milliseconds"]) > 0
        assert float(row["error"]) < 1e-12
        assert row["rung"] == rungs.get(row["work"], row["rung"])


def test_memory_of_long_vectors(run_tiny, monkeypatch):
    monkeypatch.setattr(importlib.util, "find_spec", lambda _: None)
    arguments = "--parameters 60000 --constraints 5 --kinds 'tree,tensor tree'"
    _, rows, page, said = run_tiny("long_memory", arguments)
    assert "SKIP torch: not installed" in said
    found = [(row["kind"], row["m"], row["rung"]) for row in rows]
    assert found == [("tree", "5", rung) for rung in ("gramian", "pairs")]
    assert "| tree | 6e+04 | 5 | pairs |" in page


@pytest.mark.parametrize("kind", ["tensor float32", "tensor bfloat16", "tensor tree"])
def test_memory_of_tensors(load_benchmark, kind):
    pytest.importorskip("torch")
    benchmark = load_benchmark("long_memory")
    with least_products(0):
        found = benchmark.memory_here(kind, 3000, 2, "gramian")
    assert (found.kind, found.rung, found.bar) == (kind, "gramian", 1 / 3 + benchmark.SLACK)


def test_rungs(run_tiny):
    families = ("well-conditioned", "opposing-1e-6", "opposing-1e-12", "infeasible", "sum-to-zero-equality")
    _, rows, page, said = run_tiny("rungs", f"--problems 3 --families {' '.join(families)}")
    assert [row["family"] for row in rows] == list(families)
    assert [row["gramian"] for row in rows] == ["3", "0", "0", "0", "0"]
    assert [row["pairs"] for row in rows] == ["0", "3", "0", "3", "3"]
    assert rows[2]["rows"] == "3"
    for row in rows:
        assert int(row["other_status"]) == 0
        assert float(row["apart"]) <= 1e-12
    assert "| well-conditioned | 3 | 3 | 0 | 0 | 0 |" in page
    assert page.strip() == said.strip()


@pytest.mark.skipif(not has_package("quadprog"), reason="quadprog is not installed")
def test_small_problems(run_tiny):
    benchmark, rows, page, said = run_tiny("small_problems", "--repetitions 1 --batch 20")
    assert page.strip() == said.strip()
    assert "Failures: 0." in page
    assert [row["work"] for row in rows] == ["direction", "restoring", "equality", "batch of 20"]
    assert all(float(row["microseconds"]) > 0 and int(row["failed"]) == 0 for row in rows)
    rng = np.random.default_rng(0)
    g, J = rng.normal(size=(5, 9)), rng.normal(size=(5, 3, 9))
    for k, tangent in enumerate(benchmark.batched_rosen(g, J)):  # the formula beside a batch is the paper's
        np.testing.assert_allclose(tangent, project_onto_tangent(J[k], g[k]), atol=1e-13)


@pytest.mark.parametrize("missing", [(), ("torch", "torchjd.aggregation", "jax")], ids=["installed", "missing"])
def test_tensors(run_tiny, monkeypatch, missing):
    for name in missing:
        monkeypatch.setitem(sys.modules, name, None)
    with least_products(20_000):
        _, rows, page, said = run_tiny("tensors", "--parameters 150,1000 --reference 1000 --scale 0.04")
    assert "Failures: 0 of" in page
    assert {f"SKIP {name}: not installed" in said for name in missing} <= {True}
    if missing:
        assert {row["beside"] for row in rows} == {"arrays"}
        assert len(rows) == 6
        return
    for name, lines in (("torch", 7), ("jax", 1), ("torchjd", 18)):
        kinds = [row for row in rows if (row["beside"] == "arrays") != (name == "torchjd")]
        if name != "torchjd":
            kinds = [row for row in kinds if {"torch": "tensor", "jax": "JAX"}[name] in row["kind"]]
        has_it = all(map(importlib.util.find_spec, {name, "torch"} if name == "torchjd" else {name}))
        assert len(kinds) == (lines if has_it else 0)
    for row in rows:
        assert row["rung"] == ("rows" if row["n"] == "150" else "gramian")
        assert float(row["error"]) < (0.02 if "bfloat16" in row["kind"] else 1e-6)
        if row["beside"] == "DualProj" and "bfloat16" not in row["kind"]:
            assert float(row["apart"]) < 1e-3
