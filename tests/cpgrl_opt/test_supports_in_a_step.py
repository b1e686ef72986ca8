"""What a foreign solver declares not to take, a step does not ask it: the exact solver does it."""

from dataclasses import dataclass, field

import numpy as np
import pytest

from cpgrl_opt import SOLVERS, ConstrainedStep, Direction, DirectionProblem, Linearization, WithGeometry

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


@pytest.mark.parametrize("settings", [{}, {"metric": np.diag([1.0, 2.0, 3.0, 4.0, 5.0])}, {"radius": 0.1}])
def test_only_what_it_takes_is_asked_and_the_rest_falls_back(settings) -> None:
    for formulation, falls_back in (("cone", RUNS), ("equality", 2 * RUNS), ("restoring", RUNS)):
        solver = ConesOnly()
        foreign = WithGeometry(solver) if settings else solver
        chosen = {"formulation": formulation, "drop": "never", **settings}
        done = ConstrainedStep(solver=foreign, **chosen)(LINEARIZATION, [0.0, 0.0])
        exact = ConstrainedStep(solver="active-set", **chosen)(LINEARIZATION, [0.0, 0.0])
        np.testing.assert_allclose(done.change, exact.change, atol=1e-9)
        assert 0 < done.counts["fallback"].sum() <= falls_back
        assert not done.counts["skipped"].any()
        assert (formulation == "cone") == bool(solver.asked)


def test_what_it_raises_goes_on() -> None:
    class Raising:
        def solve(self, problem: DirectionProblem) -> Direction:
            raise RuntimeError(f"no licence for {problem.n} parameters")

    with pytest.raises(RuntimeError, match="no licence"):
        ConstrainedStep(solver=Raising())(LINEARIZATION, [0.0, 0.0])
