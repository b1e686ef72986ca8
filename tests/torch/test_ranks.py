"""A model in parts, on shares of the data, and in shards, on 1, 2, 4 ranks of gloo: the same training to rounding."""

import os
import pickle
import subprocess
import sys
from pathlib import Path
from typing import Any

import numpy as np
import pytest

pytest.importorskip("torch")

from .ranks import COUNT, KINDS, STEP, WAYS

if not hasattr(os, "fork"):
    pytest.skip("there is no fork: ranks would take minutes to start", allow_module_level=True)


@pytest.fixture(scope="module")
def found(tmp_path_factory: pytest.TempPathFactory) -> list[Any]:
    """What each rank came to, of one launch of all."""
    folder = tmp_path_factory.mktemp("ranks")
    one_thread = {**os.environ, "OMP_NUM_THREADS": "1"}  # a fork has none of its parent's threads, and waits for them
    command = [sys.executable, Path(__file__).parent / "ranks.py", folder]
    subprocess.run(command, check=True, timeout=400, env=one_thread)
    return [pickle.loads((folder / f"{rank}.pickle").read_bytes()) for rank in range(COUNT)]


@pytest.mark.parametrize("way", WAYS)
@pytest.mark.parametrize("kind", KINDS)
def test_a_training_is_the_same_on_every_number_of_ranks(kind: str, way: str, found: list[Any]) -> None:
    """And to the same bits on all ranks."""
    whole, told = found[0][kind, way, 1]
    assert any(each[:2].any() for each in told)
    for few in (2, 4):
        parts = [found[rank][kind, way, few] for rank in range(few)]
        if kind == "parts":
            np.testing.assert_allclose(np.concatenate([part for part, _ in parts]), whole, atol=1e-11)
        for part, its in parts:
            np.testing.assert_array_equal(its, parts[0][1])
            np.testing.assert_allclose(its, told, atol=1e-11)
            if kind != "parts":
                np.testing.assert_array_equal(part, parts[0][0])
                np.testing.assert_allclose(part, whole, atol=1e-11)


def test_shards_and_shares_are_one_training(found: list[Any]) -> None:
    for way in WAYS:
        np.testing.assert_allclose(found[0]["sharded", way, 2][0], found[0]["averaged", way, 2][0], atol=1e-11)


def test_a_head_that_one_rank_uses_moves_on_all_and_one_that_none_uses_on_none(found: list[Any]) -> None:
    for each in found:
        assert each["heads"] == [[2.5, 2.5], [1.0, 1.0], None]  # the means of 1, 2, 3, 4 and of 0, 0, 0, 4


def test_a_gradient_that_is_not_finite_on_one_rank_is_an_error_on_all(found: list[Any]) -> None:
    for each in found:
        averaged, in_parts = each["errors"]
        assert "constraints[0] should have a finite gradient" in averaged
        assert "gradients of constraints should be finite" in in_parts


def test_what_does_not_go_together_is_refused() -> None:
    import torch

    from cpgrl_opt.torch import average_over_ranks, constrained_backward
    from cpgrl_opt.vectors import gather_by_torch

    w = torch.nn.Parameter(torch.ones(2))
    for settings, said in (
        ({"average": 3}, "average should be a function"),
        ({"average": average_over_ranks, "gather": gather_by_torch}, "average should be None with gather"),
        ({"average": average_over_ranks, "chunks": 2}, "chunks should be None with"),
        ({"average": average_over_ranks}, "torch.distributed should be initialised"),
    ):
        with pytest.raises(ValueError, match=said):
            constrained_backward(w.sum(), [w.sum()], thresholds=[1.0], parameters=[w], step=STEP, **settings)
    assert w.grad is None
