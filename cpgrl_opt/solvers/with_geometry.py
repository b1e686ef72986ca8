"""Somebody's cone solver made to take metrics and radii: a solver that declares nothing is never asked for them."""

from collections.abc import Sequence
from dataclasses import dataclass, replace

from ..direction import Direction, DirectionBatch
from ..problem import DirectionProblem, ProblemBatch, without_geometry
from .base import Solver
from .facts import supports, tolerance_of
from .geometry import solve_in_geometry
from .interface import DirectionSolver, ask, solve_stacked, unsupported
from .small_problem import SmallAnswer, SmallProblem, as_problem, as_small
from .span import solve_in_span


@dataclass(frozen=True)
class WithGeometry(Solver):
    """Metric and radius around a solver of somebody's own.

    solver: an object with `solve`, for Euclidean problems without a ball.
    """

    solver: DirectionSolver

    def __post_init__(self) -> None:
        if isinstance(self.solver, type) or not callable(getattr(self.solver, "solve", None)):
            raise ValueError(f"solver should have a method solve(problem); found {self.solver!r}")
        _ = self.tolerance  # checked

    @property
    def tolerance(self) -> float:  # type: ignore[override]
        """The solver's own: the worst KKT residual of an OPTIMAL answer."""
        return tolerance_of(self.solver)

    def supports(self, problem: DirectionProblem) -> bool:
        """Whether the solver takes the constraints, in whatever geometry."""
        return supports(self.solver, without_geometry(problem))

    def solve(self, problem: DirectionProblem) -> Direction:
        """The direction of the problem where M = I, judged on the problem itself; see `Status`."""
        if problem.is_tree and not problem.vectors.has_rows:
            return solve_in_span(self.solve, problem, self.tolerance, is_exact=False)
        if problem.metric is not None or problem.radius is not None:
            return solve_in_geometry(self, problem)
        return self.solve_rows(problem) if self.supports(problem) else unsupported(problem)

    def solve_batch(self, problems: ProblemBatch | Sequence[DirectionProblem]) -> DirectionBatch:
        """B problems of one shape."""
        stacked = ProblemBatch.stack(problems)
        if not all(map(self.supports, stacked)):
            return DirectionBatch.stack([self.solve(problem) for problem in stacked])
        return super().solve_batch(stacked)

    def solve_rows(self, problem: DirectionProblem) -> Direction:
        """The solver's own answer."""
        answer = ask(self.solver, problem)
        return replace(answer, value=problem.as_given(answer.value), residuals=None)  # which nobody reads of others

    def solve_rows_batch(self, problems: ProblemBatch) -> DirectionBatch:
        """The solver's own answers."""
        return replace(solve_stacked(self.solver, problems), residuals=None)

    def solve_small(self, small: SmallProblem) -> SmallAnswer:
        """The solver's own answer to a small problem, as the ball's search asks."""
        return as_small(ask(self.solver, as_problem(small)))
