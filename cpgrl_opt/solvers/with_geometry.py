"""Somebody's cone solver made to take metrics and radii: a solver that declares nothing is never asked for them."""

from dataclasses import dataclass
from functools import partial

from ..certify import certify
from ..direction import Direction, DirectionBatch
from ..problem import DirectionProblem, ProblemBatch, convert_answer, require_problem, without_geometry
from .base import Solver
from .facts import supports, tolerance_of
from .geometry import solve_in_geometry
from .infeasibility import infeasible_direction
from .interface import DirectionSolver, ask, referee, solve_stacked, unsupported
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
        require_problem(problem)
        if problem.metric is not None or problem.radius is not None:
            return solve_in_geometry(self, problem)
        return self.solve_rows(problem)

    def solve_rows(self, problem: DirectionProblem) -> Direction:
        """The solver's own answer, judged."""
        return ask_and_certify(self.solver, problem)

    def solve_rows_batch(self, problems: ProblemBatch) -> DirectionBatch:
        """The solver's own answers, judged."""
        return referee(problems, solve_stacked(self.solver, problems), self.tolerance)

    def solve_small(self, small: SmallProblem) -> SmallAnswer:
        """The solver's own answer to a small problem, as the ball's search asks."""
        return as_small(ask(self.solver, as_problem(small)))


def ask_and_certify(solver: DirectionSolver, problem: DirectionProblem) -> Direction:
    """What somebody's solver says of a problem, with the status that the referee leaves it; UNSUPPORTED, unasked."""
    if problem.is_tree and not problem.vectors.has_rows:
        whole, tolerance = partial(ask_and_certify, solver), tolerance_of(solver)
        return problem.vectors.attempt(solve_in_span, whole, problem, tolerance)  # type: ignore[no-any-return]
    if not supports(solver, problem):
        return unsupported(problem)
    answer = certify(problem, ask(solver, problem), tolerance_of(solver), infeasible_direction)
    return convert_answer(problem, answer) if problem.is_tree else answer
