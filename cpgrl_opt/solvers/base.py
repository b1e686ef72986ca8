"""What our solvers share: a core each, and one pipeline around it."""

from collections.abc import Callable, Sequence
from typing import ClassVar

from ..direction import Direction, DirectionBatch
from ..problem import DirectionProblem, ProblemBatch, require_problem
from ..settings import CheckedSettings
from .exact_core import project, project_batch
from .geometry import solve_batch_in_geometry, solve_in_geometry
from .interface import no_answers, unsupported
from .packages import require_packages
from .pipeline import solve_by
from .small_problem import Core, SmallAnswer, SmallProblem, as_problem, as_small
from .span import solve_in_span

_EXACT = 1e-12  # worst residual of a small answer: the search judges what comes of it, and asks no more


class Solver(CheckedSettings):
    """Base of a frozen dataclass of settings; its `solve_rows` answers problems with M = I, no ball, short vectors.

    `solve` and `solve_batch` bring all others there: long vectors are taken to the coordinates of their own span (see
    `span`), a metric is a change of coordinates and a ball a search (see `geometry`).
    """

    takes_geometry: ClassVar[bool] = True
    declines_by_itself: ClassVar[bool] = True
    tangent: ClassVar[bool | None] = None  # of the exact core, where that is the solver's: takes equalities only

    tolerance: float  # the worst residual of an OPTIMAL answer
    solve_rows: Callable[[DirectionProblem], Direction]  # with a status that the referee granted
    solve_small: Core  # x and μ of a small problem, as far as the method gets

    def supports(self, problem: DirectionProblem) -> bool:  # noqa: ARG002 - all of them
        """Equalities, cones and bounds."""
        return True

    def solve_rows_batch(self, problems: ProblemBatch) -> DirectionBatch:
        """B problems with M = I, no ball, of short vectors."""
        return DirectionBatch.stack([self.solve_rows(problem) for problem in problems])

    def solve(self, problem: DirectionProblem) -> Direction:
        """The certified direction; see `Status`. Raises MissingPackageError, UnusablePackageError."""
        if type(problem) is not DirectionProblem:
            require_problem(problem)
        try:
            if problem.metric is not None or problem.radius is not None:
                return solve_in_geometry(self, problem)
            if problem.is_long:
                given = self.solve_rows, problem, self.tolerance, self.tangent is False
                if problem.is_tree:  # maybe of several processes
                    return problem.vectors.attempt(solve_in_span, *given)  # type: ignore[no-any-return]
                return solve_in_span(*given)
            return self.solve_rows(problem)
        except Exception:
            require_packages(self)  # whose import may be what raised
            raise

    def solve_batch(self, problems: ProblemBatch | Sequence[DirectionProblem]) -> DirectionBatch:
        """B problems of one shape, each exactly as `solve` solves it."""
        stacked = ProblemBatch.stack(problems)
        if len(stacked) == 0:
            return no_answers(stacked)
        if stacked[0].is_long:
            return DirectionBatch.stack([self.solve(problem) for problem in stacked])
        try:
            if stacked.metric is not None or stacked.radius is not None:
                return solve_batch_in_geometry(self, stacked)
            return self.solve_rows_batch(stacked)
        except Exception:
            require_packages(self)
            raise


class ExactSolver(Solver):
    """Base of a solver whose core is the exact one, compiled; `tangent` says of which problems."""

    tangent: ClassVar[bool] = False

    def solve_rows(self, problem: DirectionProblem) -> Direction:
        """The certified direction, in one compiled call; in more where rows nearly depend."""
        return project(problem, self.tolerance, tangent=self.tangent)

    def solve_rows_batch(self, problems: ProblemBatch) -> DirectionBatch:
        """B problems in one compiled call, each exactly as `solve_rows` answers it."""
        return project_batch(problems, self.tolerance, tangent=self.tangent)

    def solve_small(self, small: SmallProblem) -> SmallAnswer:
        """The exact core, as the ball's search asks it."""
        return as_small(project(as_problem(small), _EXACT, tangent=self.tangent))


class SmallSolver(Solver):
    """Base of a solver with a core, `solve_small`; the pipeline around it scales, reduces, polishes and certifies."""

    polish: bool = True

    def solve_rows(self, problem: DirectionProblem) -> Direction:
        """The direction that the core finds; UNSUPPORTED where it takes no such constraints."""
        if not self.supports(problem):
            return unsupported(problem)
        return solve_by(self.solve_small, problem, tolerance=self.tolerance, polished=self.polish)
