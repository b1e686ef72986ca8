"""Vectors in parts: the answers of whole ones, the same bits everywhere, and an error on one is an error on all."""

import importlib.util
import pickle
import subprocess
import sys
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from cpgrl_opt import ConstrainedStep, Direction, DirectionProblem, Linearization, Status, kkt_residuals, solve
from cpgrl_opt.vectors import Sharded

from .kinds import Ranks, draw
from .ranks_of_torch import WRONG, call

RANKS = pytest.mark.parametrize("count", [1, 2, 4])


def as_arrays(V: np.ndarray) -> tuple[Any, Any]:
    return V[0], V[1:]


def as_trees(V: np.ndarray) -> tuple[Any, Any]:
    def tree(v: np.ndarray) -> Any:
        return {"w": v[:3].astype(np.float32), "b": v[3:]}

    return tree(V[0]), [tree(row) for row in V[1:]]


def whole(parts: list[Any]) -> np.ndarray:
    return np.concatenate([np.concatenate([*map(np.ravel, p.values())]) if isinstance(p, dict) else p for p in parts])


@RANKS
@pytest.mark.parametrize("split", [as_arrays, as_trees])
@pytest.mark.parametrize("seed", range(4))
def test_directions_are_those_of_whole_vectors(count: int, split: Any, seed: int) -> None:
    V, parts = draw(seed), np.array_split(draw(seed), count, axis=1)
    expected = solve(DirectionProblem(V[0], V[1:], 0.25, radius=1.5))

    def work(rank: int, gather: Any) -> Any:
        problem = DirectionProblem(Sharded(*split(parts[rank]), gather=gather), bound=0.25, radius=1.5)
        answer = solve(problem)
        return answer, kkt_residuals(problem, answer)

    found, error = Ranks(count).run(work), 1e-12 if split is as_arrays else 1e-6
    for answer, residuals in found:
        assert answer.status == expected.status
        np.testing.assert_array_equal(answer.multipliers, found[0][0].multipliers)
        assert (answer.rung, answer.residuals, residuals) == (found[0][0].rung, found[0][0].residuals, found[0][1])
        assert residuals.worst <= error or answer.status != Status.OPTIMAL
    np.testing.assert_allclose(whole([answer.value for answer, _ in found]), expected.value, atol=error)


@RANKS
@pytest.mark.parametrize("formulation", ["equality", "cone", "restoring", "linearized"])
def test_steps_are_those_of_whole_vectors(count: int, formulation: str) -> None:
    V, values, step = draw(0), np.array([0.0, -0.5, 0.25, -1.0]), ConstrainedStep(formulation=formulation)
    parts, expected = np.array_split(V, count, axis=1), step(Linearization(values, V), np.zeros(3))

    def work(rank: int, gather: Any) -> Any:
        return step(Linearization(values, Sharded(*as_arrays(parts[rank]), gather=gather)), np.zeros(3))

    found = Ranks(count).run(work)
    np.testing.assert_allclose(whole([each.change for each in found]), expected.change, atol=1e-12)
    for result in found:
        np.testing.assert_array_equal(result.active, expected.active)
        np.testing.assert_array_equal(result.predicted_slack, found[0].predicted_slack)


def test_what_is_sent_grows_with_the_rows_alone() -> None:
    sent = []
    for n in (16, 16_000):
        parts, ranks = np.array_split(draw(0, n), 2, axis=1), Ranks(2)
        ranks.run(lambda rank, gather: solve(DirectionProblem(Sharded(*as_arrays(parts[rank]), gather=gather))))  # noqa: B023
        sent.append(ranks.sent)
    channels = 4
    each = 8 * (2 + 3 * channels + 2 * channels**2)
    assert sent[0] == sent[1] == [[32, each, each, each]] * 2  # the parts' shapes, the bounds, K, and the sums of d


def test_a_rank_may_have_no_parameters() -> None:
    V = draw(0)
    parts = [V, V[:, :0]]

    def work(rank: int, gather: Any) -> Any:
        g, *J = ({"a": v[:40], "b": v[40:]} for v in parts[rank])
        return solve(DirectionProblem(Sharded(g, J, gather=gather)))

    found = Ranks(2).run(work)
    np.testing.assert_allclose(found[0].value["a"], solve(DirectionProblem(V[0], V[1:])).value, atol=1e-12)
    assert found[1].value["a"].shape == (0,)
    for error in Ranks(2).run(lambda _, gather: Sharded(V[0, :0], V[1:, :0], gather=gather)):
        assert "gradient should have at least one component; found none on any rank" in str(error)


def damaged(what: str) -> Callable[[int, Any], Any]:
    V = draw(0)

    def work(rank: int, gather: Any) -> Any:
        part, bound, equality = V.copy(), np.array([0.5, 0.25, -0.5]), False
        if rank == 1:
            if what == "nan":
                part[2, 3] = np.nan
            if what == "fewer rows":
                part = part[:3]
            if what == "no such part":
                return DirectionProblem(Sharded(part[0, 1:], part[1:], gather=gather))
            if what == "another bound":
                bound = -bound
            if what == "another set":
                equality = True
        vectors = Sharded(part[0], part[1:], gather=gather)
        if what == "fails later" and rank == 1:
            vars(vectors)["part"] = None
        return solve(DirectionProblem(vectors, bound=bound[: len(part) - 1], equality=equality))

    return work


@pytest.mark.parametrize(
    ("what", "message"),
    [
        ("nan", r"all ranks should bring what is asked of them; found on rank 1: jacobian should be finite; found nan"),
        ("fewer rows", r"all ranks should have one number of rows; found \[3, 2"),
        ("no such part", r"all ranks should bring what is asked of them; found on rank 1: gradient should have shape"),
        ("another bound", "all ranks should solve the same problem; found bounds or calls that differ"),
        ("another set", "all ranks should solve the same problem; found bounds or calls that differ"),
        ("fails later", r"all ranks should bring what is asked of them; found on rank 1: 'NoneType' object has"),
    ],
)
def test_an_error_on_one_rank_is_an_error_on_all(what: str, message: str) -> None:
    for count in (2, 4):
        found = Ranks(count).run(damaged(what))
        assert all(isinstance(each, Exception) for each in found)
        for rank in (0, *range(2, count)):
            with pytest.raises(ValueError, match=message):
                raise found[rank]
        if what == "no such part":
            assert "gradient should have shape (40,); found (39,)" in str(found[1])


def require_told(what: str, errors: list[str]) -> None:
    kind = "MemoryError" if what.endswith("breaks") else "ValueError"
    assert errors[1].startswith(f"{kind}: {WRONG[what]}"), errors[1]
    asked = f"ValueError: all ranks should bring what is asked of them; found on rank 1: {WRONG[what]}"
    assert errors[0].startswith(asked), errors[0]


@pytest.mark.parametrize("what", WRONG)
def test_a_wrong_argument_on_one_rank_is_an_error_on_all(what: str) -> None:
    parts = np.array_split(draw(0), 2, axis=1)
    ranks = Ranks(2)
    found = ranks.run(lambda rank, gather: call(what, rank == 1, *as_arrays(parts[rank]), gather))
    require_told(what, [f"{type(error).__name__}: {error}" for error in found])
    assert [len(sent) for sent in ranks.sent] == [len(ranks.sent[0])] * 2  # nobody is one message ahead
    found = ranks.run(lambda rank, gather: call(what, False, *as_arrays(parts[rank]), gather))
    assert not any(isinstance(each, Exception) for each in found)


def test_without_a_way_to_the_others_it_is_refused() -> None:
    with pytest.raises(ValueError, match=r"torch\.distributed should be initialised, or `gather` be given"):
        Sharded(*as_arrays(draw(0)))


def test_a_part_that_leaves_its_dtype_is_no_answer_anywhere() -> None:
    g, J = np.array([3e38, 3e38], np.float32), np.array([[-1.0, 1.0]], np.float32)
    parts = [(g, J), (np.ones(2), np.zeros((1, 2)))]
    for answer in Ranks(2).run(
        lambda rank, gather: solve(DirectionProblem(Sharded(*parts[rank], gather=gather), bound=1e39))
    ):
        assert answer.status == Status.UNCERTIFIED


@pytest.mark.skipif(importlib.util.find_spec("torch") is None, reason="PyTorch is not installed")
def test_processes_of_torch_agree_and_learn_of_one_that_dies(tmp_path: Path) -> None:
    script = Path(__file__).with_name("ranks_of_torch.py")
    workers = [
        subprocess.Popen(
            [sys.executable, str(script), str(rank), "4", str(tmp_path)],
            cwd=Path(__file__).parents[2],
            stderr=subprocess.PIPE,
            text=True,
        )
        for rank in range(4)
    ]
    try:
        errors = [worker.communicate(timeout=120)[1] for worker in workers]
    finally:
        for worker in workers:
            worker.kill()
    assert [worker.returncode for worker in workers] == [0] * 4, "\n".join(errors)
    found = [pickle.loads((tmp_path / f"{rank}.pickle").read_bytes()) for rank in range(4)]
    for count in (1, 2, 4):
        V = draw(0)
        expected = solve(DirectionProblem(V[0], V[1:], 0.25))
        answers: list[Direction] = [each["answers"][count] for each in found[:count]]
        for answer in answers:
            assert answer.status == Status.OPTIMAL
            np.testing.assert_array_equal(answer.multipliers, answers[0].multipliers)
            assert answer.residuals == answers[0].residuals
        np.testing.assert_allclose(whole([each.value.numpy() for each in answers]), expected.value, atol=1e-12)
    for what in WRONG:
        require_told(what, [each["wrong"][what] for each in found[:2]])
    for each in found:
        assert "jacobian should be finite; found nan" in each["nan"]
    for each in found[:3]:
        assert each["died"] == "RuntimeError"
