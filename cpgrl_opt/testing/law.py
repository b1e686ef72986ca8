"""What a law is: a plain function of a solver and a problem that returns an `Outcome` or raises `LawError`."""

from collections.abc import Callable
from dataclasses import dataclass
from enum import StrEnum
from functools import wraps
from typing import Any

import numpy as np

from ..answers import status_of
from ..arrays import Multipliers, Vector
from ..direction import Status
from ..problem import DirectionProblem
from ..problems.assembly import vary as vary
from ..scaling import lengths
from ..solvers import SOLVERS
from ..solvers.facts import facts_of, is_single, tolerance_of
from ..solvers.interface import DirectionSolver

# Below it float32 loses digits, and a processor in its fast mode takes the number for 0.
_LEAST_NORMAL_IN_SINGLE = float(np.finfo(np.float32).tiny)


class Outcome(StrEnum):
    """What became of one problem; a broken law is an exception, `LawError`."""

    HELD = "held"
    DECLINED = "declined"  # the solver claimed nothing about a problem that it takes
    SKIPPED = "skipped"  # the solver does not take the problem, or the law says nothing about it
    UNSUPPORTED = "unsupported"  # the solver says only in its answer that it does not take the problem


class LawError(AssertionError):
    """A solver's answer contradicts a theorem; the message holds the numbers and what to look at.

    It ends with those of the problem and the answers that follow the message.
    """

    def __init__(self, message: str, *shown: Any) -> None:
        super().__init__(message + (describe(*shown) if shown else ""))


class NothingClaimed(Exception):  # noqa: N818 - control flow inside a check, not an error
    """Ends a check early with an outcome; `law` turns it into a return value."""

    def __init__(self, outcome: Outcome) -> None:
        super().__init__(outcome)
        self.outcome = outcome


@dataclass(frozen=True, eq=False)
class Answer:
    """A solver's answer with arrays and a `Status` in it, whatever types the solver returned."""

    value: Vector
    multipliers: Multipliers
    status: Status
    radius_multiplier: float = 0.0


def law(check: Callable[..., None]) -> Callable[..., Outcome]:
    """A check as its users call it: HELD when it returns, the outcome of `NothingClaimed` when it stops early."""

    @wraps(check)
    def counted(*args: Any, **kwargs: Any) -> Outcome:
        try:
            check(*args, **kwargs)
        except NothingClaimed as end:
            return end.outcome
        return Outcome.HELD

    counted.__annotations__ = {**check.__annotations__, "return": Outcome}
    return counted


def skip_unless(applies: bool) -> None:
    """Ends a check early where the law says nothing about what it is put to."""
    if not applies:
        raise NothingClaimed(Outcome.SKIPPED)


def takes(solver: DirectionSolver, problem: DirectionProblem) -> bool:
    """Whether the solver supports the problem, asked twice; LawError where its `supports` raises or wavers.

    A solver that says that it computes in float32 takes what float32 holds.
    """
    facts = facts_of(solver)
    try:
        said = [facts.supports(problem) for _ in range(2)]
    except Exception as error:
        raise LawError(
            f"supports should say True or False of a valid problem; it raised {type(error).__name__}: {error}", problem
        ) from error
    message = f"supports should say the same of one problem each time; found {said[0]}, then {said[1]}"
    require(said[0] == said[1], message, problem)
    return said[0] and (not facts.is_single or is_held_in_single(problem))


def answer_of(solver: DirectionSolver, problem: DirectionProblem) -> Answer:
    """The solver's answer, of whatever status. LawError when it raises or is malformed; skips what is unsupported.

    An answer in float32 to a problem with numbers that float32 does not hold is an answer to another problem: skipped.
    """
    skip_unless(takes(solver, problem))
    direction = ask(solver.solve, problem, problem)
    skip_unless(not is_single(getattr(getattr(direction, "value", None), "dtype", None)) or is_held_in_single(problem))
    return read_answer(problem, direction)


def ask(
    solve: Callable[[Any], Any],
    argument: Any,
    problem: DirectionProblem,
    what: str = "solve should answer a valid problem with a Direction and a Status",
) -> Any:
    """solve(argument); LawError, which shows the problem, where it raises."""
    try:
        return solve(argument)
    except Exception as error:
        notes = [f" ({note})" for note in getattr(error, "__notes__", ())]
        if not is_held_in_single(problem):
            notes.append(" (A solver that computes in float32 should say so: dtype = 'float32')")
        message = f"{what}; it raised {type(error).__name__}: {error}{''.join(notes)}"
        raise LawError(message, problem) from error


def read_answer(problem: DirectionProblem, direction: Any) -> Answer:
    """The parts of a direction; LawError where one is missing, not numbers, or of a wrong shape."""
    try:
        value = np.array(direction.value, dtype=np.float64)
        multipliers = np.array(direction.multipliers, dtype=np.float64)
        status = status_of(direction.status)
        radius_multiplier = float(getattr(direction, "radius_multiplier", 0.0))
    except (AttributeError, TypeError, ValueError, KeyError) as error:
        raise LawError(
            "solve should return an object with value (n,), multipliers (m,) and status, a cpgrl_opt.Status or its "
            f"number or name; found {direction!r} ({type(error).__name__}: {error})",
            problem,
        ) from error
    shapes, found = f"({problem.n},) and ({problem.m},)", f"{value.shape} and {multipliers.shape}"
    message = f"value and multipliers should have shapes {shapes}; found {found}"
    require(value.shape == (problem.n,) and multipliers.shape == (problem.m,), message, problem)
    if status <= Status.INFEASIBLE and not (np.isfinite(value).all() and np.isfinite(multipliers).all()):
        raise LawError(
            f"value and multipliers of an answer called {status.name} should be finite; "
            f"found {value.tolist()} and {multipliers.tolist()}",
            problem,
        )
    return Answer(value, multipliers, status, radius_multiplier)


def optimum_of(solver: DirectionSolver, problem: DirectionProblem) -> Answer:
    """The answer where the solver calls it OPTIMAL; anything else it declined."""
    answer = answer_of(solver, problem)
    if answer.status != Status.OPTIMAL:
        raise nothing_claimed(answer)
    return answer


def nothing_claimed(answer: Answer) -> NothingClaimed:
    """What to raise where the status claims nothing that the law is about."""
    return NothingClaimed(Outcome.UNSUPPORTED if answer.status == Status.UNSUPPORTED else Outcome.DECLINED)


def reference_optimum(problem: DirectionProblem) -> tuple[Answer, float]:
    """The direction by enumeration and its tolerance; where it claims nothing, the law is skipped."""
    oracle = SOLVERS["enumeration"]
    answer = answer_of(oracle, problem)
    skip_unless(answer.status == Status.OPTIMAL)
    return answer, tolerance_of(oracle)


def same_bits(first: Answer, second: Answer) -> bool:
    """Whether status, direction and multipliers are the same, bit for bit."""
    return (
        first.status == second.status
        and first.value.tobytes() == second.value.tobytes()
        and first.multipliers.tobytes() == second.multipliers.tobytes()
    )


def require(holds: bool, message: str, problem: DirectionProblem, *answers: Answer) -> None:
    """LawError with the message, the problem and the answers unless it holds."""
    if not holds:
        raise LawError(message, problem, *answers)


def require_at_most(
    found: float, limit: float, what: str, advice: str, problem: DirectionProblem, *answers: Answer
) -> None:
    """LawError unless found ≤ limit; NaN is not."""
    message = f"{what} should be at most {limit:.3g}; found {found:.6g}. {advice}"
    require(found <= limit, message, problem, *answers)


def require_near(
    problem: DirectionProblem, answers: tuple[Answer, Answer], limit: float, what: str, advice: str
) -> None:
    """LawError unless the two directions are at most so far apart, in the metric where there is one."""
    first, second = answers
    require_at_most(length(whitened(problem, first.value - second.value)), limit, what, advice, problem, *answers)


def is_held_in_single(problem: DirectionProblem) -> bool:
    """Whether all numbers of the problem are normal float32 numbers, or 0 or −∞."""
    for part in (problem.gradient, problem.jacobian, problem.bound, problem.metric, problem.radius):
        numbers = np.asarray(0.0 if part is None else part)
        if not (np.abs(numbers[(numbers != 0) & (numbers > -np.inf)]) >= _LEAST_NORMAL_IN_SINGLE).all():
            return False
        with np.errstate(over="ignore"):
            if not (numbers.astype(np.float32) == numbers).all():
                return False
    return True


def length(vector: np.ndarray) -> float:
    """‖v‖₂; infinite where v is not finite, so that no comparison with NaN slips through."""
    return float(lengths(vector)) if np.isfinite(vector).all() else float("inf")


def whitened(problem: DirectionProblem, direction: np.ndarray) -> np.ndarray:
    """Lᵀd, whose length is √(dᵀMd): d itself where there is no metric."""
    return direction if problem.whitening is None else problem.whitening.direction(direction)


def describe(problem: DirectionProblem, *answers: Answer) -> str:
    """The numbers below a message: the problem, then each answer."""
    lines = [
        f"    gradient    {_numbers(problem.gradient)}",
        f"    jacobian    {_numbers(problem.jacobian)}",
        f"    bound       {_numbers(problem.bound)}",
        f"    equality    {problem.equality.tolist()}",
    ]
    if problem.metric is not None:
        lines.append(f"    metric      {_numbers(problem.metric)}")
    if problem.radius is not None:
        lines.append(f"    radius      {problem.radius!r}")
    for answer in answers:
        lines.append(f"    value       {_numbers(answer.value)}  {answer.status.name}")
        lines.append(f"    multipliers {_numbers(answer.multipliers)}")
        if problem.radius is not None:
            lines.append(f"    κ           {answer.radius_multiplier!r}")
    return "\n" + "\n".join(lines)


def _numbers(array: np.ndarray) -> str:
    return np.array2string(array, precision=9, separator=", ", threshold=100).replace("\n", "\n                ")
