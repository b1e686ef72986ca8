"""Every benchmark runs tiny, untimed: it writes its page and rows, and what it compares is right."""

import csv
import os
import shlex
import shutil
import sys
from dataclasses import fields

import numpy as np
import pytest

from cpgrl_opt import project_onto_tangent
from cpgrl_opt.solvers import has_package

from .cpgrl_opt.long import least_products

HAS_COMPILER = shutil.which(os.environ.get("CC", "cc")) is not None
FAMILIES = ("well-conditioned", "opposing-1e-6", "opposing-1e-12", "infeasible", "sum-to-zero-equality")
METHODS = ("restoring", "linearized, κ = 1", "linearized, κ = ½")
# What is typed, constants of the module, and a column of the CSV file.
TINY = {
    "arm_speed": ("--scale 0.001", {"REPETITIONS": 1}, ("runs", ["20"] * 6 + ["1"])),
    "batches": (
        "--problems 6 --parameters 4 --constraints 2 --repeats 1",
        {},
        ("method", ["NumPy batch"] * 3),
    ),
    "long_memory": ("--parameters 60000 --constraints 5 --kinds tree", {"RUNGS": ("pairs",)}, ("rung", ["pairs"])),
    "long_vectors": (
        "--parameters 500,2000 --constraints 2 --scale 0.05",
        {"REFERENCE": 2000},
        ("rung", ["gramian", "", "", "", "gramian", "gramian", "pairs"] * 2),
    ),
    "nightly_laws": (
        "--max-examples 2 --solvers active-set,nnls --laws check_stationarity",
        {"sources": lambda: "12345678"},
        ("solver", ["active-set", "nnls"]),
    ),
    "rungs": (f"--problems 3 --families {','.join(FAMILIES)}", {}, ("pairs", ["0", "3", "0", "3", "3"])),
    "small_problems": (
        "--repetitions 1 --batch 20",
        {"CALLS": 1},
        ("work", ["direction", "restoring", "equality", "batch of 20"]),
    ),
    "startup": (
        "--repeats 1 --without-commands",
        {"COLD": 1, "FLOOR": "pass", "PROGRAMS": {"first direction, active-set": ("pass", 10.0, None)}},
        ("goal", ["", "", "10.0", ""]),
    ),
    "tensors": (
        "--parameters 150 --reference 1000 --scale 0.04",
        {"LEAVES": 3},
        ("beside", ["arrays"] * 6),
    ),
    "training_in_c": (
        "--episodes 2 --repetitions 1",
        {},
        ("method", ["rl.train", "C, -O2", "C, -O3 -march=native"]),
    ),
    "training_speed": ("--scale 0.01", {"REPETITIONS": 1}, ("runs", ["2", "20", "20", "20"])),
    "trust_regions": (
        "--count 1 --solvers active-set,daqp --families 'in a ball,touching'",
        {},
        ("agreed", ["1"] * 4),
    ),
    "violations_on_the_way": (
        "--seeds 2 --scale 0.01",
        {"BLOCKS": 4},
        ("method", [method for _ in range(3) for method in METHODS for _ in range(2)]),
    ),
}


def test_every_benchmark_is_tried(load_benchmark):
    folder = load_benchmark("tables").RESULTS.parent
    found = {path.stem for path in folder.glob("*.py") if "__main__" in path.read_text(encoding="utf-8")}
    elsewhere = {"mutations", "in_a_training_loop", "network_updates", "jax_directions"}  # in tests/torch, tests/jax
    assert found == {*TINY, *elsewhere}


@pytest.mark.parametrize("name", TINY)
def test_a_benchmark_runs_tiny_and_writes_its_page_and_its_rows(name, load_benchmark, tmp_path, monkeypatch, capsys):
    if (name == "small_problems" and not has_package("quadprog")) or (name == "training_in_c" and not HAS_COMPILER):
        pytest.skip("quadprog or a C compiler is not installed")
    for package in ("torch", "torchjd.aggregation", "jax"):
        monkeypatch.setitem(sys.modules, package, None)
    benchmark = load_benchmark(name)
    typed, constants, (column, values) = TINY[name]
    for constant, value in constants.items():
        monkeypatch.setattr(benchmark, constant, value)
    monkeypatch.syspath_prepend(os.path.dirname(benchmark.__file__))  # for the processes that it starts
    monkeypatch.setattr(sys, "argv", [f"{name}.py", *shlex.split(typed), "--out", str(tmp_path)])
    with least_products(0):
        benchmark.main()
    page = (tmp_path / f"{name}.md").read_text(encoding="utf-8")
    assert page in capsys.readouterr().out
    assert f"`python benchmarks/{name}.py {typed} --out benchmarks/results`" in page
    with (tmp_path / f"{name}.csv").open(newline="", encoding="utf-8") as file:
        rows = list(csv.DictReader(file))
    assert list(rows[0]) == [field.name for field in fields(benchmark.Row)]
    assert [row[column] for row in rows] == values
    for row in rows:
        assert float(row.get("error", 0)) < 1e-6
        assert row.get("failed", "0") in ("0", "False")
        assert float(row.get("apart", 0)) <= 1e-12 or row["apart"] == "nan"


def test_batches_of_tensors_are_right_at_every_scale(load_benchmark):
    pytest.importorskip("torch")
    batches = load_benchmark("batches")
    rows = [row for scale in batches.SCALES for row in batches.measure(batches.draw(5, 9, 3, scale), scale, 1)]
    ours = [row for row in rows if row.method.startswith(("NumPy", "tensors"))]
    assert len(ours) >= 15
    assert {row.right for row in ours} == {1.0}


@pytest.mark.parametrize("package", ["torch", "jax"])
def test_tensors_are_timed_and_measured(load_benchmark, package):
    pytest.importorskip(package)
    tensors = load_benchmark("tensors")
    kinds = [
        kind for kind, *_ in tensors.kinds(tensors.draw(1000)) if {"torch": "tensor", "jax": "JAX"}[package] in kind
    ]
    assert len(kinds) == {"torch": 7, "jax": 1}[package]
    if package == "torch":
        memory = load_benchmark("long_memory")
        for kind in memory.TENSORS:
            with least_products(0):
                found = memory.measure_here(kind, 3000, 2, "gramian")
            assert (found.kind, found.rung, found.bar) == (kind, "gramian", 1 / 3 + memory.SLACK)


def test_torchjd_projects_onto_the_same_cone(load_benchmark):
    pytest.importorskip("torchjd")
    rows = list(load_benchmark("tensors").beside_torchjd([1000], 0.04))
    assert len(rows) == 9
    for row in rows:
        if row.beside == "DualProj" and "bfloat16" not in row.kind:
            assert row.apart < 1e-3


def test_the_formula_beside_a_batch_is_the_papers(load_benchmark):
    rng = np.random.default_rng(0)
    g, J = rng.normal(size=(5, 9)), rng.normal(size=(5, 3, 9))
    for k, tangent in enumerate(load_benchmark("small_problems").batched_rosen(g, J)):
        np.testing.assert_allclose(tangent, project_onto_tangent(J[k], g[k]), atol=1e-13)


@pytest.mark.skipif(not HAS_COMPILER, reason="there is no C compiler: install gcc or clang")
def test_c_does_the_same_work_and_other_work_is_noticed(load_benchmark, tmp_path, monkeypatch):
    benchmark = load_benchmark("training_in_c")
    theta = benchmark.in_c("-O2", tmp_path)(1200)  # in episode 1183 two opposing rows, both violated, in run 8
    assert np.abs(theta - benchmark.ours(1200)).max() <= 1e-13
    other = tmp_path / "other.c"
    other.write_text(benchmark.SOURCE.read_text(encoding="utf-8").replace("BETA = 0.99", "BETA = 0.98"), "utf-8")
    monkeypatch.setattr(benchmark, "SOURCE", other)
    with pytest.raises(ValueError, match=r"C, -O2 and of rl.train should agree to 1e-12"):
        benchmark.measure(episodes=3, repetitions=1)
    monkeypatch.setenv("PATH", str(tmp_path))
    monkeypatch.delenv("CC", raising=False)
    with pytest.raises(SystemExit, match="cc should be a C compiler"):
        benchmark.compiler()


def test_trainings_in_numpy_reach_what_ours_reaches_within_six_standard_errors(load_benchmark):
    benchmark = load_benchmark("training_speed")
    contenders = [
        (benchmark.academic, 3),
        (benchmark.vectorised, 30),
        (benchmark.CONTENDERS["rl.train, rosen"][0], 400),
    ]
    policy = benchmark.SoftmaxTable(3, 3)
    *others, ours = [benchmark.MDP.average_rewards(policy.probabilities(run(runs, 25))) for run, runs in contenders]
    for g in others:
        error = ours.std(axis=0) * np.sqrt(1 / len(g) + 1 / len(ours))
        assert (np.abs(g.mean(axis=0) - ours.mean(axis=0)) < 6 * error).all()


def test_with_exact_gradients_linearized_stays_where_restoring_steps_over(load_benchmark):
    benchmark = load_benchmark("violations_on_the_way")
    task = benchmark.tasks(0.25)["exact"]
    restoring, linearized = (benchmark.learn(task, method, 2) for method in METHODS[:2])
    feasible = (restoring.slack[:, 0] >= 0) & (linearized.slack[:, 0] >= 0)
    assert feasible.any()
    over, within = -restoring.slack[feasible].min(axis=1), -linearized.slack[feasible].min(axis=1)
    assert (over > 10 * within).all()
    assert (over > 0.1).all()


@pytest.mark.parametrize(("runs", "first"), [(20, 6), (10, 2), (5, 1), (1, 1)])
def test_the_interval_is_that_of_the_binomial_distribution(load_benchmark, runs, first):
    values = np.random.default_rng(0).permutation(np.arange(1.0, runs + 1))
    found = load_benchmark("violations_on_the_way").median_interval(values)
    assert found == ((runs + 1) / 2, first, runs + 1 - first)
