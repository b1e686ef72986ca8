"""Laws of many problems at once: a batch is a loop, and a warm start is a cold start that is found sooner."""

from collections.abc import Sequence
from typing import Any, cast

from ..direction import Status
from ..problem import DirectionProblem
from ..solvers.facts import facts_of
from ..solvers.interface import DirectionSolver
from .law import (
    LawError,
    answer_of,
    ask,
    law,
    read_answer,
    require,
    same_bits,
    skip_unless,
    takes,
)
from .sensitivity import require_same_optimum

_ADVICE = "What was solved before, or beside it, should not change an answer."


@law
def check_batch_is_loop(solver: DirectionSolver, problems: Sequence[DirectionProblem]) -> None:
    """solve_batch(problems)[k] has the status and, where OPTIMAL, the direction of solve(problems[k]).

    ‖Δd‖ ≤ 2 · `distance_bound`(ε). Problems of one shape; skipped for a solver without solve_batch.
    Source: runs are independent.
    """
    skip_unless(facts_of(solver).has_batch and all(takes(solver, problem) for problem in problems))
    together = _solve_batch(solver, problems)
    if len(together) != len(problems):
        raise LawError(f"solve_batch should return {len(problems)} directions; found {len(together)}")
    for k, problem in enumerate(problems):
        alone, member = answer_of(solver, problem), read_answer(problem, together[k])
        message = (
            f"solve_batch(problems)[{k}] should have the status {alone.status.name} that solve(problems[{k}]) has; "
            f"found {member.status.name}"
        )
        require(alone.status == member.status, message, problem, alone, member)
        what = f"‖solve_batch(problems)[{k}] − solve(problems[{k}])‖"
        require_same_optimum(solver, problem, (alone, member), what, _ADVICE)


@law
def check_neighbours_change_nothing(
    solver: DirectionSolver,
    problem: DirectionProblem,
    beside: Sequence[DirectionProblem],
    others: Sequence[DirectionProblem],
) -> None:
    """solve_batch([*beside, problem])[−1] is solve_batch([*others, problem])[−1], bit for bit.

    beside, others: as many problems of its shape, rows and gradients of 1e±150 among them. Skipped for a solver without
    solve_batch, or where it does not take all of them.
    Source: runs are independent, so that run k is repeated exactly beside other runs.
    """
    batches = [[*beside, problem], [*others, problem]]
    skip_unless(facts_of(solver).has_batch and all(takes(solver, each) for batch in batches for each in batch))
    first, second = (read_answer(problem, _solve_batch(solver, batch)[len(batch) - 1]) for batch in batches)
    message = (
        "an answer in a batch should not change with its neighbours, not in its last bit; found that it does. "
        "Scale and stop each problem by its own numbers, not by those of the batch"
    )
    is_same = same_bits(first, second) and first.radius_multiplier == second.radius_multiplier
    require(is_same, message, problem, first, second)


@law
def check_warm_start_is_cold_start(solver: DirectionSolver, problems: Sequence[DirectionProblem]) -> None:
    """session(n, m, warm_start=True).solve finds, one problem after the other, the directions that solve finds.

    ‖Δd‖ ≤ 2 · `distance_bound`(ε) where both are OPTIMAL; and OPTIMAL is not called INFEASIBLE, nor the reverse.
    Problems of one shape; skipped for a solver without such a session.
    Source: the optimum is one wherever one starts.
    """
    skip_unless(facts_of(solver).has_warm_start and all(takes(solver, problem) for problem in problems))
    session: Any = cast(Any, solver).session(problems[0].n, problems[0].m, warm_start=True)
    for k, problem in enumerate(problems):
        cold, warm = answer_of(solver, problem), answer_of(session, problem)
        statuses = f"{warm.status.name} from a warm start and {cold.status.name} from a cold one"
        contradicts = {cold.status, warm.status} == {Status.OPTIMAL, Status.INFEASIBLE}
        require(not contradicts, f"problem {k} should have one status; found {statuses}", problem, cold, warm)
        what = f"‖d − d'‖ of problem {k} from a cold and a warm start"
        require_same_optimum(solver, problem, (cold, warm), what, _ADVICE)


def _solve_batch(solver: DirectionSolver, problems: Sequence[DirectionProblem]) -> Any:
    what = f"solve_batch should answer {len(problems)} valid problems"
    return ask(cast(Any, solver).solve_batch, problems, problems[0], what)
