"""The benchmarks beside TorchJD and Cooper run tiny, untimed, and what they compare is what they say."""

import csv
import importlib.util
import os
import sys
from dataclasses import fields
from typing import Any

import pytest

torch = pytest.importorskip("torch")

HAS_OTHERS = all(importlib.util.find_spec(each) for each in ("torchjd", "cooper"))


@pytest.mark.parametrize(
    ("name", "typed", "runs"),
    [
        ("in_a_training_loop", ["--seeds", "2", "--tuning-seeds", "1", "--updates", "2"], 2),
        ("network_updates", ["--parameters", "3000", "--constraints", "2", "--repetitions", "1"], 1),
    ],
)
def test_a_benchmark_runs_tiny_and_writes_its_page_and_its_rows(
    name: str, typed: list[str], runs: int, load_benchmark: Any, tmp_path: Any, monkeypatch: Any
) -> None:
    benchmark = load_benchmark(name)
    monkeypatch.syspath_prepend(os.path.dirname(benchmark.__file__))  # for the processes that it starts
    monkeypatch.setattr(sys, "argv", [f"{name}.py", *typed, "--out", str(tmp_path)])
    if name == "in_a_training_loop":
        monkeypatch.setattr(benchmark, "JUDGED", 20)
        for each, (glue, settings, package) in benchmark.CONTENDERS.items():
            monkeypatch.setitem(benchmark.CONTENDERS, each, (glue, settings[:1], package))
    benchmark.main()
    assert (tmp_path / f"{name}.md").read_text(encoding="utf-8").count("| ours: ") >= 2
    with (tmp_path / f"{name}.csv").open(newline="", encoding="utf-8") as file:
        rows = list(csv.DictReader(file))
    assert list(rows[0]) == [field.name for field in fields(benchmark.Row)]
    found = [row["contender"] for row in rows]
    wanted = [each for each in benchmark.CONTENDERS if HAS_OTHERS or each.startswith(("ours", "Adam", "loss"))]
    assert found == [each for each in wanted for _ in range(runs)]


def test_what_all_contenders_get_has_the_policys_gradients(load_benchmark: Any) -> None:
    """Spread σ, mean 0: ∇ E|a|² after log σ is 2σ² in each coordinate, where nothing is cut."""
    loop = load_benchmark("in_a_training_loop")
    torch.manual_seed(0)
    policy = loop.Policy()
    for each in policy.mean.parameters():
        torch.nn.init.zeros_(each)
    found = []
    for _ in range(30):
        _, costs = loop.estimate(policy)
        (gradient,) = torch.autograd.grad(costs[1], policy.log_spread)
        found.append(gradient)
    mean, error = torch.stack(found).mean(dim=0), torch.stack(found).std(dim=0) / 30**0.5
    assert ((mean - 2 * policy.log_spread.detach().mul(2).exp()).abs() < 5 * error).all()
    assert (error < 0.1).all()
