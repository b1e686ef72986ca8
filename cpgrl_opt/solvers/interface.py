"""What a direction solver is, and how to ask one that declares little."""

from collections.abc import Sequence
from typing import Any, Protocol, runtime_checkable

import numpy as np

from ..arrays import Multipliers, Vector
from ..certify import (
    excess_violation,
    farkas_residual,
    kkt_residuals,
    proof_tolerance,
    violation,
    violation_tolerance,
)
from ..direction import Direction, DirectionBatch, Status
from ..problem import DirectionProblem, ProblemBatch, euclidean
from ..scaling import lengths, unit_rows
from .asking import ask, ask_batch
from .facts import facts_of
from .infeasibility import infeasible_direction, misses_a_bound

# A problem counts as infeasible where what meets its constraints is proven to be this many times as long as d and g.
_FAR = 100.0


@runtime_checkable
class DirectionSolver(Protocol):
    """A frozen dataclass of settings with one method. Third parties need not import this.

    Optional attributes: `tolerance` (the worst KKT residual of an OPTIMAL answer, ≤ 1e-3; 1e-6 is assumed),
    `supports(problem) -> bool` (undeclared: equalities, cone and bounds), `solve_batch(problems)`,
    `guarantee` and `source` (one line each, for the table of solvers), `takes_geometry` (True: problems with a metric
    or a radius too; `WithGeometry(solver)` makes any solver take them), `declines_by_itself` (True: its `solve_batch`
    calls UNSUPPORTED what `supports` does not take, so that no loop over the problems need ask before),
    `finds_infeasible` (False: it cannot tell that no direction meets the constraints, and claims nothing there),
    `dtype` ("float32": it computes in float32, and the conformance kit gives it problems that float32 holds).
    """

    def solve(self, problem: DirectionProblem) -> Direction:
        """The projection of g onto {d : Jᵢd ≥ bᵢ, Jᵢd = bᵢ on E}, with multipliers and a status; see `Status`."""
        ...


def refereed(
    problems: ProblemBatch | Sequence[DirectionProblem], answers: DirectionBatch, tolerance: float
) -> DirectionBatch:
    """The answers with every claim of OPTIMAL or INFEASIBLE that the referee rejects turned into UNCERTIFIED.

    They are copied as contiguous float64 arrays. OPTIMAL stands where every residual is within the tolerance and no
    constraints contradict each other, which a long gradient may hide. INFEASIBLE stands where the multipliers prove it
    to √tolerance and the direction violates least to (1 + m) tolerance, in the ball where there is a radius; and no
    direction that meets the constraints is shorter than a hundred times the answer and the gradient (or than the
    radius): what the conformance kit asks for and more, but that it be the nearest of them to the gradient.
    """
    answers = answers.owned()
    status = answers.status
    if len(answers) != len(problems):
        raise ValueError(f"answers should be one for each of {len(problems)} problems; found {len(answers)}")
    for k, (problem, answer) in enumerate(zip(problems, answers, strict=True)):
        if answer.status == Status.OPTIMAL and not _is_optimal(problem, answer, tolerance):
            status[k] = Status.UNCERTIFIED
        if answer.status == Status.INFEASIBLE and not _is_infeasible(problem, answer, tolerance):
            status[k] = Status.UNCERTIFIED
    return answers


def _is_optimal(problem: DirectionProblem, answer: Direction, tolerance: float) -> bool:
    """Within the tolerance, and no rows that d misses contradict each other, however short they are beside g."""
    if not kkt_residuals(problem, answer).worst <= tolerance:
        return False
    if not misses_a_bound(problem, answer.value):
        return True
    alone = DirectionProblem.trusted(np.zeros(problem.n), problem.jacobian, problem.bound, problem.equality)
    return infeasible_direction(alone) is None


def _is_infeasible(problem: DirectionProblem, answer: Direction, tolerance: float) -> bool:
    if not farkas_residual(problem, answer.multipliers) <= proof_tolerance(tolerance):
        return False
    flat, d = _euclidean_direction(problem, answer)
    reach, size = _proven_distance(flat, answer.multipliers), float(lengths(d))
    if problem.radius is None:
        far = _FAR * max(size, float(lengths(flat.gradient)))
        return reach >= far and excess_violation(problem, answer.value) <= violation_tolerance(tolerance, problem.m)
    if not reach >= min(problem.radius, _FAR * size):
        return False
    return _excess_violation_in_ball(flat, d, problem.radius) <= violation_tolerance(tolerance, problem.m)


def _proven_distance(problem: DirectionProblem, y: Multipliers) -> float:
    """b̂ᵀŷ/‖Ĵᵀŷ‖, at the most: no d that is shorter meets all constraints. M = I."""
    residual = farkas_residual(problem, y)
    named = np.abs(unit_rows(problem.jacobian).per_length(problem.bound)[y != 0])
    return float(named.max(initial=0.0)) / residual if residual > 0 else float("inf")


def _euclidean_direction(problem: DirectionProblem, answer: Direction) -> tuple[DirectionProblem, Vector]:
    """The problem and d where M = I."""
    with np.errstate(over="ignore", invalid="ignore"):
        d = answer.value if problem.whitening is None else problem.whitening.direction(answer.value)
    return euclidean(problem), d


def _excess_violation_in_ball(problem: DirectionProblem, d: Vector, radius: float) -> float:
    """‖Π(d + Ĵᵀr) − d‖ / s, Π onto the ball: 0 where d is in it and no other point of it violates less; M = I.

    r = (b̂ − Ĵd)₊, signed on E; s = max(‖d‖, (b̂ᵢ)₊, |b̂ᵢ| on E), and no more than the radius. Ours; Π(d + Ĵᵀr) is a
    step of projected descent on ½‖r‖².
    """
    if not np.isfinite(d).all():
        return float("inf")
    lack = violation(problem, d)
    required = np.where(problem.equality, np.abs(lack.bound), lack.bound).max(initial=0.0)
    unit = min(max(float(lengths(d)), float(required)), radius)
    descended = d + lack.amount @ lack.jacobian
    length = float(lengths(descended))
    if not length < np.inf:
        return float("inf")
    return float(lengths(descended * min(1.0, radius / max(length, radius)) - d)) / unit if unit > 0 else 0.0


class MissingPackageError(ImportError):
    """A solver's package is not installed; the message is the command that installs it."""

    def __init__(self, solver: str, package: str, extra: str) -> None:
        super().__init__(
            f"solver {solver!r} needs the package {package}, which is not installed; "
            f"type: pip install 'cpgrl-opt[{extra}]'"
        )

    def __reduce__(self) -> tuple[Any, ...]:
        """As its message, and notes: a worker process raises it too, and pickle would call __init__ with that alone."""
        return _rebuilt, (type(self), str(self)), vars(self)


def _rebuilt(kind: type[MissingPackageError], message: str) -> MissingPackageError:
    error = kind.__new__(kind, message)
    ImportError.__init__(error, message)
    return error


class UnusablePackageError(MissingPackageError):
    """A solver's package is installed, yet cannot be imported, e.g. for want of a system library; says why."""

    def __init__(self, solver: str, package: str, reason: ImportError) -> None:
        ImportError.__init__(
            self, f"solver {solver!r} needs the package {package}, which is installed but cannot be imported: {reason}"
        )


def solve_batch(solver: DirectionSolver, problems: ProblemBatch | Sequence[DirectionProblem]) -> DirectionBatch:
    """B problems of one shape, by the solver's own `solve_batch` where it has one, else in a loop.

    A problem that the solver declares not to take is UNSUPPORTED, unasked. What it raises, it raises; ValueError
    where it writes to the problems or returns no directions. Of a batch of no problems it is not asked.
    """
    if len(problems) == 0:
        return no_answers(problems)
    problems = ProblemBatch.stack(problems)
    facts = facts_of(solver)
    if facts.declines_by_itself:
        return ask_batch(solver, problems)
    taken = np.array([facts.supports(problem) for problem in problems], dtype=np.bool_)
    if not facts.has_batch:
        pairs = zip(problems, taken, strict=True)
        return DirectionBatch.stack([ask(solver, each) if takes else unsupported(each) for each, takes in pairs])
    if taken.all():
        return ask_batch(solver, problems)
    answers = DirectionBatch.stack([unsupported(problem) for problem in problems])
    if not taken.any():
        return answers
    return answers.replaced(taken, ask_batch(solver, problems.chosen(taken)))


def no_answers(problems: ProblemBatch | Sequence[DirectionProblem]) -> DirectionBatch:
    """The answers to a batch of no problems; ValueError for a sequence of none, which has no shape."""
    none = ProblemBatch.stack(problems)
    zeros = np.zeros(0, np.int64)
    return DirectionBatch(np.zeros(none.gradient.shape), np.zeros(none.bound.shape), zeros, zeros.copy())


def unsupported(problem: DirectionProblem) -> Direction:
    """Zeros that claim nothing."""
    return Direction(np.zeros(problem.n), np.zeros(problem.m), Status.UNSUPPORTED)
