"""What a foreign solver declares not to take, a step does not ask it: the exact solver does it."""

from dataclasses import dataclass, field

import numpy as np
import pytest

from cpgrl_opt import (
    SOLVERS,
    ConstrainedStep,
    Direction,
    DirectionProblem,
    Linearization,
    Status,
    WithGeometry,
    solve_batch,
)
from cpgrl_opt.direction import DirectionBatch
from cpgrl_opt.problem import ProblemBatch
from cpgrl_opt.solvers import is_usable

RUNS = 6
LINEARIZATION = Linearization(
    np.random.default_rng(5).standard_normal((RUNS, 3)) - 1.0, np.random.default_rng(6).standard_normal((RUNS, 3, 5))
)


@dataclass(frozen=True)
class ConesOnly:
    """Takes Jd ≥ 0, and is sure to be wrong elsewhere: it would call g optimal of anything with a bound."""

    asked: list[DirectionProblem] = field(default_factory=list)

    def supports(self, problem: DirectionProblem) -> bool:
        return bool(((problem.bound == 0.0) | (problem.bound == -np.inf)).all()) and not problem.equality.any()

    def solve(self, problem: DirectionProblem) -> Direction:
        assert self.supports(problem), "asked for what it does not take"
        self.asked.append(problem)
        return SOLVERS["active-set"].solve(problem)


class ConesTogether(ConesOnly):
    """The same with a `solve_batch` of its own."""

    def solve_batch(self, problems) -> DirectionBatch:
        return DirectionBatch.stack([self.solve(problem) for problem in problems])


@pytest.mark.parametrize("kind", [ConesOnly, ConesTogether])
@pytest.mark.parametrize("settings", [{}, {"metric": np.diag([1.0, 2.0, 3.0, 4.0, 5.0])}, {"radius": 0.1}])
def test_only_what_it_takes_is_asked_and_the_rest_falls_back(settings, kind) -> None:
    for formulation, falls_back in (("cone", RUNS), ("equality", 2 * RUNS), ("restoring", RUNS)):
        solver = kind()
        foreign = WithGeometry(solver) if settings else solver
        chosen = {"formulation": formulation, "drop": "never", **settings}
        done = ConstrainedStep(solver=foreign, **chosen)(LINEARIZATION, [0.0, 0.0])
        exact = ConstrainedStep(solver="active-set", **chosen)(LINEARIZATION, [0.0, 0.0])
        np.testing.assert_allclose(done.change, exact.change, atol=1e-9)
        assert 0 < done.counts["fallback"].sum() <= falls_back
        assert not done.counts["skipped"].any()
        assert (formulation == "cone") == bool(solver.asked)


@pytest.mark.parametrize("stacked", [False, True])
@pytest.mark.parametrize("bounds", [[0.0, 1.0, 0.0, -1.0], [0.0, 0.0], [1.0, -1.0]])
def test_a_batch_of_its_own_is_handed_what_it_takes_and_the_answers_stay_in_order(bounds, stacked) -> None:
    solver = ConesTogether()
    problems = [DirectionProblem([1.0, k], [[-1.0, 0.5]], bound) for k, bound in enumerate(bounds)]
    answers = solve_batch(solver, ProblemBatch.stack(problems) if stacked else problems)
    for answer, problem in zip(answers, problems, strict=True):
        takes = solver.supports(problem)
        assert answer.status == (Status.OPTIMAL if takes else Status.UNSUPPORTED)
        expected = SOLVERS["active-set"].solve(problem).value if takes else np.zeros(2)
        np.testing.assert_array_equal(answer.value, expected)
    assert len(solver.asked) == bounds.count(0.0)


def test_a_batch_of_its_own_is_not_handed_a_geometry_that_it_does_not_declare() -> None:
    solver = ConesTogether()
    problems = [DirectionProblem([1.0, k], [[-1.0, 0.5]], radius=1.0) for k in range(3)]
    assert [answer.status for answer in solve_batch(solver, problems)] == [Status.UNSUPPORTED] * 3
    assert not solver.asked


def test_our_own_batches_decline_what_they_do_not_take_by_themselves() -> None:
    """So that no loop over the problems stands before a compiled call."""
    mixed = DirectionProblem([1.0, 2.0], [[1.0, 0.0]]), DirectionProblem([1.0, 2.0], [[1.0, 0.0]], equality=True)
    bounded = DirectionProblem([1.0, 2.0], [[1.0, 0.0]], 2.0)
    assert SOLVERS["active-set"].declines_by_itself
    assert SOLVERS["rosen"].declines_by_itself
    usable = filter(is_usable, SOLVERS.values())
    by_themselves = [solver for solver in usable if getattr(solver, "declines_by_itself", False)]
    for solver in (*by_themselves, WithGeometry(ConesTogether())):
        for answer, problem in zip(solve_batch(solver, [*mixed, bounded]), [*mixed, bounded], strict=True):
            assert (answer.status == Status.UNSUPPORTED) == (not solver.supports(problem)), solver


def test_what_it_raises_goes_on() -> None:
    class Raising:
        def solve(self, problem: DirectionProblem) -> Direction:
            raise RuntimeError(f"no licence for {problem.n} parameters")

    with pytest.raises(RuntimeError, match="no licence"):
        ConstrainedStep(solver=Raising())(LINEARIZATION, [0.0, 0.0])
