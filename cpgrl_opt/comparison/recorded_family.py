"""Recorded problems as a family of the comparison, with what is known of each of them."""

import numpy as np

from ..problem import DirectionProblem
from ..solvers import SOLVERS
from ..solvers.infeasibility import infeasible_direction
from .contestants import DEFAULT_SOLVER
from .families import ProblemFamily
from .recording import Recording

_WELL_POSED = 1e-7  # smallest singular value of the active unit rows: below it float64 does not tell the direction
_CONSISTENT = 1e-9


def make_recorded_family(recording: Recording, name: str) -> ProblemFamily:
    """The recording's problems, drawn evenly, as a family of the comparison.

    A single problem is infeasible where a violation above 1e-9 is proven, see `infeasible_direction`, or the shortest
    direction is longer than the radius.

    Parameters
    ----------
    recording
        At least one problem.
    name
        Of the family, as the user typed it.

    Returns
    -------
    ProblemFamily
        feasible: whether every problem's active rows can be met with equality, in its ball, which suffices;
        well_posed: whether these rows are independent, σ_min ≥ 1e-7 on unit rows.

    Raises
    ------
    ValueError
        For a recording without problems.
    """
    if not len(recording):
        raise ValueError("a family should have a problem; found a recording of none")
    facts = [_facts(problem) for problem in recording.problems]

    def draw(rng: np.random.Generator) -> DirectionProblem:
        return recording.problems[rng.integers(len(recording))]

    return ProblemFamily(
        name, f"problems met in training ({', '.join(recording.trainings)})", draw,
        feasible=all(feasible for feasible, _ in facts), well_posed=all(well_posed for _, well_posed in facts),
        is_large=recording.gradient.shape[1] > 100,
        feasibility=_is_feasible,
    )  # fmt: skip


def _is_feasible(problem: DirectionProblem) -> bool:
    if infeasible_direction(problem) is not None:
        return False
    if problem.radius is None:
        return True
    still = DirectionProblem(np.zeros(problem.n), problem.jacobian, problem.bound, problem.equality)
    return bool(np.linalg.norm(SOLVERS[DEFAULT_SOLVER].solve(still).value) <= (1 + _CONSISTENT) * problem.radius)


def _facts(problem: DirectionProblem) -> tuple[bool, bool]:
    active = problem.bound > -np.inf
    J, b = problem.jacobian[active], problem.bound[active]
    norms = np.linalg.norm(J, axis=1)
    if not norms.all():
        return bool((b[norms == 0] == 0).all()), False
    J, b = J / norms[:, None], b / norms
    least: np.ndarray = np.linalg.lstsq(J, b, rcond=_WELL_POSED)[0]
    size = np.abs(b).max(initial=0.0)
    independent = bool(np.linalg.svd(J, compute_uv=False).min(initial=1.0) >= _WELL_POSED) and len(J) <= problem.n
    reaches = problem.radius is None or bool(np.linalg.norm(least) <= problem.radius)
    return reaches and bool(np.abs(J @ least - b).max(initial=0.0) <= _CONSISTENT * size), independent
