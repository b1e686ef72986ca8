"""A batch of directions holds what each of them holds: residuals and rungs too, through slices and replacements."""

import numpy as np
import pytest

from cpgrl_opt import (
    SOLVERS,
    Direction,
    DirectionBatch,
    DirectionProblem,
    ProblemBatch,
    Status,
    kkt_residuals,
    solve,
    solve_batch,
)

from .steps import Claiming


def batch_of(rng: np.random.Generator, count: int = 4, m: int = 3, n: int = 9) -> ProblemBatch:
    return ProblemBatch(rng.normal(size=(count, n)), rng.normal(size=(count, m, n)))


@pytest.mark.parametrize("name", ["active-set", "nnls", "rosen-drop"])
@pytest.mark.parametrize("theta", [1.0, 1e-6], ids=["generic", "nearly opposing"])
def test_residuals_are_those_of_the_referee(name: str, theta: float) -> None:
    generic = batch_of(np.random.default_rng(2))
    J = generic.jacobian.copy()
    J[:, 2] = -J[:, 1] + theta * J[:, 2]
    problems = ProblemBatch(generic.gradient, J)
    batch = SOLVERS[name].solve_batch(problems)  # type: ignore[attr-defined]
    for direction, problem in zip(batch[1:], problems[1:], strict=True):
        assert direction.residuals is not None
        assert SOLVERS[name].solve(problem).residuals == direction.residuals
        np.testing.assert_allclose(direction.residuals, kkt_residuals(problem, direction), rtol=0, atol=1e-14)


def test_long_batches_say_which_rung_answered() -> None:
    batch = SOLVERS["active-set"].solve_batch(batch_of(np.random.default_rng(3), 2, 2, 60_000))  # type: ignore[attr-defined]
    assert [each.rung for each in batch] == ["gramian", "gramian"]
    assert all(each.residuals is not None for each in batch)
    assert [each.rung for each in batch.protect()] == ["gramian", "gramian"]


def test_replaced_directions_bring_their_own() -> None:
    problems = batch_of(np.random.default_rng(4))
    batch = SOLVERS["nnls"].solve_batch(problems)  # type: ignore[attr-defined]
    other = Direction(np.zeros(9), np.zeros(3), Status.UNCERTIFIED, 7, rung="pairs")
    mask = np.array([False, True, False, False])
    replaced = batch.replace_where(mask, DirectionBatch.stack([other]))
    assert (replaced[1].rung, replaced[1].residuals, replaced[1].iterations) == ("pairs", None, 7)
    assert replaced[0].residuals == batch[0].residuals
    np.testing.assert_array_equal(replaced[2].value, batch[2].value)
    joined = DirectionBatch.join([batch, DirectionBatch.stack([other])])
    assert [each.residuals for each in joined] == [*(each.residuals for each in batch), None]


def test_the_function_form_believes_no_claim() -> None:
    idle = Claiming(None, Status.OPTIMAL)
    assert solve(DirectionProblem([1.0, 1.0], [[-1.0, 0.0]]), idle).status == Status.UNCERTIFIED
    assert solve(DirectionProblem([-1.0, 1.0], [[-1.0, 0.0]]), idle).status == Status.OPTIMAL


@pytest.mark.parametrize("name", ["active-set", "rosen-drop"])
@pytest.mark.parametrize("threads", [2, 3, 9])
def test_parts_solved_side_by_side_have_the_bits_of_the_whole(name: str, threads: int) -> None:
    problems = batch_of(np.random.default_rng(5), 7)
    whole, parts = (solve_batch(SOLVERS[name], problems, threads=count) for count in (1, threads))
    for field in ("value", "multipliers", "status", "iterations", "residuals"):
        np.testing.assert_array_equal(getattr(parts, field), getattr(whole, field))
    assert [each.rung for each in parts] == [each.rung for each in whole]


@pytest.mark.parametrize("threads", [0, -1, 1.5, True])
def test_threads_are_a_number_of_them(threads: object) -> None:
    with pytest.raises(ValueError, match="threads should be an integer ≥ 1"):
        solve_batch(SOLVERS["active-set"], batch_of(np.random.default_rng(7)), threads=threads)  # type: ignore[arg-type]
